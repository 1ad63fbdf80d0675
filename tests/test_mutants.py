"""The mutation tool itself, on a toy project with known survivors."""

import json
import os
import subprocess
import sys
from pathlib import Path

import mutants
import pytest
from mutation_changes import Change, changes_of, is_a_change

AREA = '''"""Areas."""

import math

UNIT = 1.0


def area(width: float, height: float = 2.0) -> float:
    """Width 3 times height 4."""
    if width < 0:
        raise ValueError("width is 5 at least" + "six")
    return width * height


def countdown(n: int) -> int:
    while n > 0:
        n -= 1
    return n


def never_called(x: int) -> int:
    return x + 7


def scaled(x: float) -> float:
    return x * UNIT
'''
TESTS = """from toy.area import area, countdown, scaled


def test_area_of_a_square() -> None:
    assert area(1.0, 1.0) == 1.0


def test_countdown_ends() -> None:
    assert countdown(3) == 0


def test_scaled_keeps_what_is_one() -> None:
    assert scaled(1.0) == 1.0
"""


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    for name, text in {
        "toy/__init__.py": "",
        "toy/area.py": AREA,
        "tests/test_area.py": TESTS,
        "tests/conftest.py": "import toy.area\n",
        "pyproject.toml": "",
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    subprocess.run(["git", "init", "-q"], cwd=tmp_path, check=True)
    return tmp_path


def test_what_means_nothing_is_not_changed(toy: Path) -> None:
    changed = "".join(f"{change.before} {change.after}" for change in changes_of(toy, "toy/area.py"))
    assert "Areas" not in changed
    assert "five" not in changed
    assert "six" not in changed
    assert "3" not in changed
    assert "float" not in changed


def test_every_change_compiles_and_differs(toy: Path) -> None:
    changes = changes_of(toy, "toy/area.py")
    assert {change.after for change in changes} >= {"width / height", "x - 7", "8", "2.0", "4.0", ">= 0"}
    assert all(is_a_change(AREA, change.source()) for change in changes)


def test_a_value_made_at_import_knows_who_uses_it(toy: Path) -> None:
    unit = _change(toy, line=5)
    default = _change(toy, line=8)
    assert unit.at_import
    assert unit.names == ("UNIT",)
    assert default.at_import
    assert default.body == (9, 12)


def test_rooms_share_the_count_by_their_lines(toy: Path) -> None:
    for room, lines in (("small", 10), ("large", 90)):
        (toy / "toy" / room).mkdir()
        (toy / "toy" / room / "sums.py").write_text(
            "".join(f"x{n} = {n} + 1\n" for n in range(lines)), encoding="utf-8"
        )
    drawn = [trial.room for trial in mutants.draw(toy, "toy", ["small", "large"], 20, seed=0)]
    assert (drawn.count("small"), drawn.count("large")) == (2, 18)


def test_the_same_seed_draws_the_same_changes(toy: Path) -> None:
    def drawn(seed: int) -> list[tuple[int, str]]:
        return [(t.change.line, t.change.after) for t in mutants.draw(toy, "toy", [], 5, seed)]

    assert drawn(3) == drawn(3)
    assert drawn(3) != drawn(4)


def test_survivors_are_those_that_no_test_can_notice(toy: Path) -> None:
    results = _survey(toy)
    survivors = {row["line"]: row for row in results["survivors"]}
    assert set(survivors) >= {12, 22, 26}
    assert not {5, 17} & set(survivors)
    assert survivors[12]["after"] == "width / height"
    assert "tests/test_area.py::test_area_of_a_square" in survivors[12]["ran"]
    assert survivors[22]["tests"] == 0
    assert {row["line"] for row in results["changes"]} == {5, 8, 10, 12, 16, 17, 22, 26}
    assert results["of"] == results["noticed"] + len(survivors) == 8
    assert results["rooms"] == {"area": {"noticed": results["noticed"], "of": 8}}
    assert (toy / "toy" / "area.py").read_text(encoding="utf-8") == AREA


def _survey(toy: Path) -> dict:
    command = [
        sys.executable,
        mutants.__file__,
        "--root",
        str(toy),
        "--package",
        "toy",
        "--warm",
        "",
        "--jobs",
        "2",
        "--limit",
        "5",
    ]
    environment = os.environ | {"XDG_CACHE_HOME": str(toy / "cache")}
    out = toy / "results.json"
    command += ["--json", str(out), "--count", "50"]
    subprocess.run(command, cwd=toy, env=environment, check=True, capture_output=True)
    return json.loads(out.read_text(encoding="utf-8"))


def _change(toy: Path, line: int) -> Change:
    return next(change for change in changes_of(toy, "toy/area.py") if change.line == line)
