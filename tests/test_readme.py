"""The code of README and docs runs, their commands exist with their options, and their links lead somewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
TEXT = {page.name: page.read_text(encoding="utf-8") for page in PAGES}
COMMANDS = sorted({line for text in TEXT.values() for line in re.findall(r"^gfp-grasp .*$", text, re.MULTILINE)})


def _blocks(text: str, language: str) -> list[str]:
    """Code blocks of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("page", [name for name, text in TEXT.items() if _blocks(text, "python")])
def test_python_of_a_page_runs_as_one_program(page: str, tmp_path: Path) -> None:
    program = tmp_path / "page.py"
    program.write_text("\n".join(_blocks(TEXT[page], "python")), encoding="utf-8")
    done = subprocess.run([sys.executable, program.name], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    if page == "README.md":
        assert (tmp_path / "mug.glb").is_file()


@pytest.mark.slow
def test_commands_of_the_pages_exist_with_their_options() -> None:
    assert len(COMMANDS) > 10
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


def test_commands_within_the_text_exist_with_their_options() -> None:
    sections = {part.partition("\n")[0]: part for part in TEXT["command_line.md"].split("### gfp-grasp ")}
    found = {
        (command, option)
        for text in TEXT.values()
        for command, rest in re.findall(r"`(?:gfp-grasp )?((?:train|bench|gps) [a-z]+)([^`]*)`", text)
        for option in (None, *re.findall(r"--[a-z-]+", rest))
    }
    assert {("train pcrnet", "--data"), ("bench peers", "--data"), ("train peer", None)} <= found
    for command, option in found:
        assert command in sections, command
        assert option is None or f"| `{option}` |" in sections[command], f"{command} {option}"


def test_files_of_primitives_that_the_pages_name_are_there() -> None:
    named = {suffix for text in TEXT.values() for suffix in re.findall(r"gps/<(?:class|name)>(\.\w+)", text)}
    assert ".ply" in named
    for suffix in named:
        assert (ROOT / "gps" / f"cup{suffix}").is_file(), suffix


def test_links_lead_to_files_that_are_there() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)\)", TEXT[page.name]):
            if not target.startswith("http"):
                assert (page.parent / target).resolve().is_file(), f"{page.name}: {target}"


def test_files_of_results_that_the_pages_name_are_there() -> None:
    named = {name for text in TEXT.values() for name in re.findall(r"results/[\w.]+\.(?:json|svg)", text)}
    assert len(named) > 15
    for name in named:
        assert (ROOT / name).is_file(), name


def test_readme_is_short_and_says_where_to_read_on() -> None:
    readme = TEXT["README.md"]
    assert len(readme.splitlines()) <= 150
    for page in ("how_it_works", "recordings", "new_class", "own_parts", "environment", "results", "house"):
        assert f"docs/{page}.md" in readme


def test_make_targets_of_the_pages_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for text in TEXT.values():
        for target in re.findall(r"^make ([\w-]+)", text, re.MULTILINE):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def _wide() -> dict[str, str]:
    """Environment in which help is not wrapped inside of an option's name."""
    return {**os.environ, "COLUMNS": "200", "TERMINAL_WIDTH": "200"}
