"""The page of the command line is what the program says: names, values, defaults and help of every option."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def test_page_of_the_command_line_is_what_the_program_says() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "command_line.py"], capture_output=True, text=True, check=True
    )
    page = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    assert done.stdout == page, "run `make commands`"


def test_program_and_groups_without_words_show_their_commands() -> None:
    code = (
        "from gfp_grasp.cli import main\n"
        "for words in ([], ['gps'], ['train'], ['bench']):\n"
        "    try:\n        main(words)\n    except SystemExit as stop:\n        print('code', stop.code)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    told = [line.strip() for line in done.stdout.splitlines()]
    assert [line for line in told if line.startswith("Usage:")] == [
        "Usage: gfp-grasp [OPTIONS] COMMAND [ARGS]...",
        *(f"Usage: gfp-grasp {group} [OPTIONS] COMMAND [ARGS]..." for group in ("gps", "train", "bench")),
    ]
    assert told.count("code 2") == 4
    assert not done.stderr
