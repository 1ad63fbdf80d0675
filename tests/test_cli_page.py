"""The page of the command line is what the program says: names, values, defaults and help of every option."""

import subprocess
import sys
from pathlib import Path

import pytest
from recorded_calls import run

ROOT = Path(__file__).resolve().parents[1]


def test_page_of_the_command_line_is_what_the_program_says() -> None:
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "command_line.py"], capture_output=True, text=True, check=True
    )
    page = (ROOT / "docs" / "command_line.md").read_text(encoding="utf-8")
    assert done.stdout == page, "run `make commands`"


@pytest.mark.parametrize("words", ["gps", "train", "bench"])
def test_a_group_without_words_shows_its_commands(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(words) == 2
    shown = capsys.readouterr().out
    assert f"Usage: gfp-grasp {words}" in shown
    assert "--help" in shown
