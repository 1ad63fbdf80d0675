"""The README's code runs, its commands exist with their options, and its links lead somewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = sorted(set(re.findall(r"^gfp-grasp .*$", README, re.MULTILINE)))


def blocks(language: str) -> list[str]:
    """Code blocks of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


@pytest.mark.slow
def test_python_of_the_readme_runs_as_one_program(tmp_path: Path) -> None:
    program = tmp_path / "readme.py"
    program.write_text("\n".join(blocks("python")), encoding="utf-8")
    done = subprocess.run([sys.executable, program.name], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "mug.glb").is_file()
    assert (tmp_path / "mug.xml").is_file()


@pytest.mark.slow
def test_commands_of_the_readme_exist_with_their_options() -> None:
    assert COMMANDS
    help_of: dict[tuple[str, ...], str] = {}
    for command in COMMANDS:
        words = command.split()[1:]
        groups = 2 if words[0] in ("gps", "train", "bench") else 1
        key = tuple(words[:groups])
        if key not in help_of:
            arguments = [sys.executable, "-m", "gfp_grasp.cli", *key, "--help"]
            done = subprocess.run(arguments, capture_output=True, text=True, check=True, env=_wide())
            help_of[key] = done.stdout
        for option in (word for word in words if word.startswith("-")):
            assert option in help_of[key], f"{command}: {option}"


def test_links_of_the_readme_lead_to_files_that_are_there() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        if not target.startswith("http"):
            assert (ROOT / target).is_file(), target


def test_make_targets_of_the_readme_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in re.findall(r"^make ([\w-]+)", README, re.MULTILINE):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def _wide() -> dict[str, str]:
    """Environment in which help is not wrapped inside of an option's name."""
    return {**os.environ, "COLUMNS": "200", "TERMINAL_WIDTH": "200"}
