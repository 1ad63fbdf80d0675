"""Figures of the bench of readiness from rows made by hand, and the tables that pages show."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from gfp_grasp.bench import ReadyConfig, check_pages, ready_cells, ready_headings, write_pages
from gfp_grasp.bench.ready import by_group
from gfp_grasp.bench.ready_rows import SceneRow, ViewRow, summarise
from gfp_grasp.bench.ready_table import with_tables
from gfp_grasp.errors import InvalidOption

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "results" / "ready.json"
PAGES = (ROOT / "README.md", ROOT / "docs" / "results.md")


def view(hidden: float = 0.0, **fields: Any) -> ViewRow:
    common = {"group": "procedural", "object": "a", "category": "", "view": 0, "completer": "own"}
    return ViewRow(hidden=hidden, **{**common, **fields})


def rested(tilt_deg: float, travel_m: float, *, stands: bool) -> dict[str, Any]:
    return {"tilt_deg": tilt_deg, "travel_m": travel_m, "stands": stands}


WHOLE = [
    view(chamfer_m=0.0012, seconds=0.2, **rested(0.5, 0.001, stands=True)),
    view(chamfer_m=0.0014, seconds=0.4, **rested(7.0, 0.002, stands=False)),
    view(chamfer_m=0.0052, seconds=0.9, error="InvalidMesh"),
    view(error="FitDiverged"),
]
HALF = [
    view(0.5, chamfer_m=0.004, seconds=5.0, **rested(0.0, 0.0, stands=True)),
    view(0.5, error="NothingDetected"),
]
SCENES = [
    SceneRow(
        scene=0, completer="own", objects=4, cuts_m=(0.0, 0.0005, 0.0012, 0.0012), unparted_m=(0.0, 0.02, 0.02, 0.01)
    ),
    SceneRow(scene=1, completer="own", objects=4, cuts_m=(0.0, 0.0), unparted_m=(0.0, 0.0), error="FitDiverged"),
]


def test_shares_are_of_all_that_was_asked_for_and_medians_of_what_was_answered():
    figures = summarise([*WHOLE, *HALF], SCENES)
    assert figures.pop("hidden") == {
        "50": {
            "views": 2,
            "failed": 1,
            "chamfer_median_mm": 4.0,
            "chamfer_mean_mm": 4.0,
            "under_2_mm": 0.0,
            "not_simulated": 1,
            "tilt_median_deg": 0.0,
            "travel_median_mm": 0.0,
            "stands": 0.5,
        }
    }
    assert figures == {
        "views": 4,
        "failed": 1,
        "chamfer_median_mm": 1.4,
        "chamfer_mean_mm": 2.6,
        "under_2_mm": 0.5,
        "not_simulated": 2,
        "tilt_median_deg": 3.75,
        "travel_median_mm": 1.5,
        "stands": 0.25,
        "seconds_median": 0.4,
        "seconds_p95": 0.85,
        "scenes": 2,
        "objects": 8,
        "missing": 2,
        "cut_most_mm": 1.2,
        "cut_over_1_mm": 0.5,
        "unparted_most_mm": 20.0,
        "unparted_over_1_mm": 0.625,
    }


def test_rows_are_told_apart_by_group_and_completer_and_scenes_are_of_the_first_group():
    rows = [view(chamfer_m=0.001), view(chamfer_m=0.002, completer="other"), view(chamfer_m=0.003, group="real")]
    figures = by_group(rows, [*SCENES, SceneRow(scene=0, completer="other", objects=3)])
    medians = {(group, name): of["chamfer_median_mm"] for group, names in figures.items() for name, of in names.items()}
    assert medians == {
        ("procedural", "own"): 1.0,
        ("procedural", "other"): 2.0,
        ("real", "own"): 3.0,
        ("real", "other"): None,
    }
    assert (figures["procedural"]["own"]["objects"], figures["procedural"]["other"]["missing"]) == (8, 3)
    assert "objects" not in figures["real"]["own"]


def test_a_row_says_what_failed_and_has_a_dash_where_nothing_was_answered():
    figures = summarise([*WHOLE, *HALF], SCENES)
    assert ready_headings({"own": figures}) == (
        "completer",
        "Chamfer, mm",
        "< 2 mm",
        "cut, mm",
        "cut unparted, mm",
        "tilt, deg",
        "travel, mm",
        "stand",
        "50 % hidden: mm, stand",
        "s",
    )
    assert ready_cells("own", figures) == (
        "own",
        "1.40, 2.60 (1 failed)",
        "50 %",
        "1.2, 50 % (2 failed)",
        "20.0, 62 %",
        "3.8 (2 failed)",
        "1.5",
        "25 %",
        "4.0, 50 % (1 failed)",
        "0.40, 0.85",
    )
    nothing = summarise([view(error="FitDiverged"), view(0.3, error="FitDiverged")], [])
    assert ready_cells("none", nothing) == (
        "none",
        "- (1 failed)",
        "0 %",
        "- (1 failed)",
        "-",
        "0 %",
        "-, 0 % (1 failed)",
        "-",
    )


def report(*names: str) -> dict[str, Any]:
    """A report on procedural views, and on one real view without scenes."""
    procedural = {name: summarise([*WHOLE, *HALF], SCENES) for name in names}
    real = {name: summarise([view(chamfer_m=0.003)], []) for name in names}
    settings = {**asdict(ReadyConfig(views=4)), "objects": {"procedural": 3, "real": 1}, "machine": "abacus"}
    return {"settings": settings, "rows": {"procedural": procedural, "real": real}}


PAGE = """# Page

<!-- ready procedural: b a -->
an old table
<!-- end of ready -->
between
<!-- ready real -->
<!-- end of ready -->
after
"""


def test_tables_stand_between_the_marks_of_a_page_and_nowhere_else():
    text = with_tables(PAGE, report("a", "b", "c"), "../results/own.json")
    before, first, between, second, after = text.replace("<!-- end of ready -->", "<!-- ready").split("<!-- ready")
    assert (before, between, after) == ("# Page\n\n", "\nbetween\n", "\nafter\n")
    assert "old" not in first
    lines = first.split("\n")
    assert lines[0] == " procedural: b a -->"
    caption = " ".join(lines[2:5])
    assert ", on 4 views of 3 procedural objects and on 8 objects in 2 scenes (" in caption
    assert "(`gfp-grasp bench ready --data FOLDER --views 4`, " in caption
    assert "abacus, [results/own.json](../results/own.json)):" in caption
    assert max(map(len, lines[2:5])) <= 120
    table = [line for line in lines if line.startswith("|")]
    assert table[0].startswith("| | Chamfer, mm | < 2 mm | cut, mm |")
    assert table[1] == "|" + 10 * " --- |"
    assert [line.split(" | ")[0] for line in table[2:]] == ["| b", "| a"]
    assert [line.split(" | ")[0] for line in second.split("\n") if line.startswith("| ")][2:] == ["| a", "| b", "| c"]
    assert "1 real objects (`gfp-grasp bench ready --data FOLDER --views 4`" in second.replace("\n", " ")
    assert "cut" not in second
    assert with_tables(text, report("a", "b", "c"), "../results/own.json") == text
    empty = with_tables(text, {"rows": {}}, "")
    assert "|" not in empty
    assert with_tables(empty, {"rows": {}}, "") == empty


def test_pages_are_written_with_the_way_to_the_file_of_the_figures(tmp_path: Path):
    page = tmp_path / "docs" / "page.md"
    page.parent.mkdir()
    page.write_text(PAGE)
    write_pages(report("a", "b"), tmp_path / "results" / "own.json", [page])
    assert page.read_text() == with_tables(PAGE, report("a", "b"), "../results/own.json")


def test_a_page_without_marks_is_refused(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text("# Page\n<!-- ready procedural -->\n")
    with pytest.raises(InvalidOption, match="has no table"):
        check_pages([page])
    check_pages(PAGES)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tables_of_a_page_are_those_of_the_committed_figures(page: Path):
    """Without committed figures there are no tables."""
    figures = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.is_file() else {"rows": {}}
    link = "results/ready.json" if page.parent == ROOT else "../results/ready.json"
    text = page.read_text(encoding="utf-8")
    assert with_tables(text, figures, link) == text
