"""The page of a score: its links resolve, its drawings are true, its failures are made again as they were."""

import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from inspect import signature

import numpy as np
import pytest
import trimesh
from PIL import Image

import gfp_grasp.cli.score
from gfp_grasp.drawing import bracket_chart, reasons_chart
from gfp_grasp.errors import CannotWrite, GfpGraspError, InvalidOption
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.score import (
    BRACKETS,
    Report,
    ScoreConfig,
    ScoreRow,
    prepare_folder,
    score,
    write_picture,
    write_score_page,
)
from gfp_grasp.score.failures import MOST, choose_failures
from gfp_grasp.score.page import _command
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Grasp

pytestmark = pytest.mark.filterwarnings("error")
MISSING = "mirror/test_score_page:grasps_the_air"
HOSTILE = '<script>alert(1)<script>"&'


def grasps_the_air(completion, num, *, seed):
    """The best grasp, above the object."""
    best = plan_grasps(completion, 1, seed=seed)[0]
    return [Grasp(make_T(best.T_world_gripper[:3, :3], best.T_world_gripper[:3, 3] + (0, 0, 0.2)), best.width_m)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two objects that are convex, so that nothing waits for a decomposition."""
    path = tmp_path_factory.mktemp("objects")
    for name, radius_m in (("slim", 0.025), (HOSTILE, 0.034)):
        mesh = trimesh.creation.cylinder(radius_m, 0.14, sections=32)
        mesh.apply_translation((0, 0, 0.07))
        mesh.export(path / f"bottle__{name}.ply")
    return path


@pytest.fixture(scope="module")
def report(folder):
    return score(folder, ("mirror", MISSING, "oracle"), config=ScoreConfig(views=1, seed=5))


@pytest.fixture(scope="module")
def made(folder, report, tmp_path_factory):
    """The folder of the page, and its text."""
    page = write_score_page(report, tmp_path_factory.mktemp("page") / "new" / "report", objects=folder)
    return page.parent, page.read_text(encoding="utf-8")


def test_every_link_of_the_page_resolves_and_none_leaves_its_folder(made):
    directory, text = made
    links = re.findall(r'(?:src|href)="(?!data:)([^"]*)"', text)
    assert {"failure-1.png", "failure-1.gif", "failure-2.png", "failure-2.gif", "score.json"} == set(links)
    assert all((directory / link).is_file() for link in links)
    assert not re.findall(r"(?:https?:)?//[a-z0-9.-]+\.[a-z]{2,}", text)


def test_the_figures_beside_the_page_are_those_of_the_report(made, report):
    assert (made[0] / "score.json").read_text(encoding="utf-8") == report.to_json() + "\n"


def test_failures_are_made_again_as_they_were_and_filmed(made, report):
    directory, text = made
    assert [row.reason for row in report.rows if row.completer == MISSING] == ["no_contact"] * 2
    assert text.count("<dt>reason</dt><dd>no contact</dd>") == 2
    assert "made again" not in text.split('<section id="figures">')[0]
    for number in (1, 2):
        with Image.open(directory / f"failure-{number}.gif") as clip:
            assert clip.n_frames > 10  # pyright: ignore[reportAttributeAccessIssue]
        with Image.open(directory / f"failure-{number}.png") as picture:
            assert picture.size == (600, 300)


def test_names_cannot_break_out_of_the_page(made):
    text = made[1]
    assert "<script" not in text
    assert "&lt;script&gt;alert(1)&lt;script&gt;&quot;&amp;" in text


def test_the_page_holds_no_absolute_path_even_where_a_note_does(folder, report, tmp_path):
    lost = [
        replace(t, reason="no_grasp_found", quality=None, note=f"UnreadableFile: {folder}/slim.ply is none")
        for t in report.rows
        if t.completer == MISSING
    ]
    held = [row for row in report.rows if row.completer == "oracle"]
    page = write_score_page(Report(report.settings, (*lost, *held)), tmp_path, objects=folder)
    text = page.read_text(encoding="utf-8")
    assert "UnreadableFile: slim.ply is none" in text
    assert str(folder.parent) not in text
    (command,) = re.findall(r"gfp-grasp score [^<]*", text)
    assert f" --objects {folder.name} " in command
    assert {word[2:] for word in command.split() if word.startswith("--")} - {"report"} <= options()
    assert not list(tmp_path.glob("*.gif"))


def test_a_score_among_clutter_is_made_again_among_clutter(report):
    assert " --clutter 4 " in _command({**report.settings, "clutter": 4}, "out")


def test_the_command_counts_objects_that_were_left_out(report):
    settings = {**report.settings, "num_objects": 5, "no_grip": ["jug"], "too_heavy": ["vat"], "classes": ["", "jug"]}
    assert " --limit 7 --classes ,jug --report out" in _command(settings, "out")


def test_a_report_without_failures_gives_a_page_that_says_so(report, tmp_path):
    held = tuple(row for row in report.rows if row.success)
    assert {row.completer for row in held} >= {"oracle"}
    page = write_score_page(Report(report.settings, held), tmp_path, objects="nothing is loaded")
    assert "No row failed where the oracle held." in page.read_text(encoding="utf-8")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["index.html", "score.json"]


def test_a_folder_that_cannot_be_written_is_refused_by_name(folder, report, tmp_path):
    (tmp_path / "taken").write_text("a file")
    for act in (prepare_folder, lambda place: write_score_page(report, place, objects=folder)):
        with pytest.raises(CannotWrite, match="taken") as caught:
            act(tmp_path / "taken")
        assert isinstance(caught.value, GfpGraspError)


def test_the_picture_is_a_drawing_by_itself_of_the_rows(report, tmp_path):
    drawing = ElementTree.parse(write_picture(report, tmp_path / "new" / "score.svg")).getroot()
    assert drawing.tag == "{http://www.w3.org/2000/svg}svg"
    words = [element.text for element in drawing.iter("{http://www.w3.org/2000/svg}text")]
    assert {"mirror", "oracle", "2/2"} <= set(words)
    [style] = drawing.iter("{http://www.w3.org/2000/svg}style")
    assert set(re.findall(r"var\((--\w+)\)", style.text or "")) <= set(re.findall(r"(--\w+):", style.text or ""))
    with pytest.raises(CannotWrite, match=r"score\.svg"):
        write_picture(report, tmp_path / "new" / "score.svg" / "score.svg")


def test_objects_that_were_not_scored_are_refused(report, tmp_path):
    with pytest.raises(InvalidOption, match="slim"):
        write_score_page(report, tmp_path, objects="cup")


def options():
    """Of the command, by name."""
    return set(signature(gfp_grasp.cli.score.score).parameters)


def a_row(
    method: str, name: str, view: int, *, success: bool = False, cd_m: float | None = 0.01, note: str = ""
) -> ScoreRow:
    reason = "held" if success else "no_contact"
    return ScoreRow(
        object=name,
        category="",
        completer=method,
        view=view,
        episode_seed=0,
        success=success,
        reason=reason,
        lift_m=0.0,
        slip_m=0.0,
        falls_free=success,
        mass_kg=0.1,
        friction=0.5,
        grip_n=30.0,
        completed_success=True,
        completed_reason="held",
        quality=1.0,
        width_m=0.05,
        cd_m=cd_m,
        f_score=None,
        note=note,
        timings_s={},
    )


def test_failures_are_chosen_where_the_oracle_held_largest_error_first_and_two_of_an_object():
    oracle = [a_row("oracle", name, view, success=(name, view) != ("b", 0)) for name in "abc" for view in range(3)]
    worse = [a_row("worse", "a", view, cd_m=0.01 * (view + 1)) for view in range(3)]
    worse += [a_row("worse", "b", 0, cd_m=0.9), a_row("worse", "b", 1, cd_m=None)]
    better = [a_row("better", "c", 0), a_row("better", "c", 1, success=True)]
    lost = [a_row("better", "c", 2, note="WorkerLost: it died")]
    chosen = choose_failures(Report({}, (*oracle, *worse, *better, *lost)))
    assert [(t.completer, t.object, t.view) for t in chosen] == [
        ("better", "c", 0),
        ("worse", "a", 2),
        ("worse", "a", 1),
        ("worse", "b", 1),
    ]


def test_without_an_oracle_any_failure_may_be_shown_up_to_the_most():
    rows = [a_row("mirror", str(number), 0) for number in range(MOST + 3)]
    assert len(choose_failures(Report({}, tuple(rows)))) == MOST


def test_the_charts_stand_where_the_figures_are():
    rows = {
        name: [a_row(name, "a", view, success=view < held) for view in range(4)]
        for name, held in (("observed", 1), ("<own>", 2), ("oracle", 4))
    }
    summaries = Report({}, tuple(t for trials in rows.values() for t in trials)).completers()
    chart = ElementTree.fromstring(bracket_chart(summaries, BRACKETS))
    at = [float(circle.get("cx", "")) for circle in chart.iterfind("g[@class='true']/circle")]
    zero, one = 10.0, 410.0
    np.testing.assert_allclose(at, [zero + (one - zero) * share for share in (0.25, 0.5, 1.0)])
    lines = [path.get("d", "").split(",")[0] for path in chart.iterfind("path[@class='bracket']")]
    assert lines == ["M410.0", "M110.0"]
    assert "<own>" in [text.text for text in chart.iterfind("text")]
    bars = ElementTree.fromstring(reasons_chart(summaries)).findall("rect")
    widths = [float(bar.get("width", "")) for bar in bars]
    np.testing.assert_allclose(widths, [115, 345, 230, 230, 460])
