"""Failures made again and the words of the page, for rows that are known."""

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gfp_grasp import __version__
from gfp_grasp.errors import CannotWrite, InvalidMesh, InvalidOption
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.score import Report, ScoreConfig, ScoreRow, failures, page
from gfp_grasp.score.failures import Exhibit, choose_failures, has_oracle, is_oracle, make_exhibits
from gfp_grasp.score.rows import as_step
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Grasp

ROW = ScoreRow(
    object="mug-<7>",
    category="mug",
    completer="gfs/top-down",
    view=3,
    episode_seed=4711,
    success=False,
    reason="slipped_on_lift",
    lift_m=0.1,
    slip_m=0.02,
    falls_free=False,
    mass_kg=0.2,
    friction=0.7,
    grip_n=30.0,
    completed_success=True,
    completed_reason="held",
    quality=0.5,
    width_m=0.05,
    cd_m=0.01234,
    f_score=0.7,
)
SETTINGS: dict[str, Any] = {
    "objects": "cup,mug",
    "split": "val",
    "num_objects": 5,
    "no_grip": ["cup-1", "mug-2"],
    "classes": ["", "bottle", "cup", "mug"],
    "completers": ["gfs/top-down", "oracle"],
    "views": 3,
    "clutter": 2,
    "grasps": 4,
    "seed": 6,
    "trial": {"lift_m": 0.2},
}
GRASP = Grasp(make_T(None, (0.01, 0.02, 0.3)), 0.05)


class Task:
    """An episode whose trial ends with a reason."""

    def __init__(self, completion: Any = "completion", clutter: int = 0) -> None:
        self.asked: list = []
        self.config = SimpleNamespace(clutter=clutter)
        self.trial_settings = "settings of the trial"
        self.completion = None if completion is None else SimpleNamespace(mesh="completed mesh")

    def draw(self, rng, *, number):
        self.asked.append((float(rng.uniform()), number))
        T = make_T(None, (1.0, 2.0, 3.0))
        return SimpleNamespace(
            completion=self.completion, image=SimpleNamespace(T_world_camera=T), true_mesh=lambda: "true mesh"
        )

    def world(self):
        return "world"


@pytest.fixture
def drawn(monkeypatch) -> dict[str, list]:
    """Pictures without a renderer; what they were to show. Trials end as `reason` says."""
    drawn: dict[str, list] = {"overlay": [], "film": [], "clips": [], "planned": [], "reason": ["slipped_on_lift"]}

    def overlay(true, completed, *, seen_from):
        drawn["overlay"].append((true, completed, seen_from.tolist()))
        return np.full((6, 12, 3), 77, np.uint8)

    def filmed(world, grasp, settings, **how):
        drawn["film"].append((world, grasp.T_world_gripper.tolist(), settings, how))
        return SimpleNamespace(reason=drawn["reason"][0]), "frames"

    def plan(*which):
        drawn["planned"].append(which)
        return (GRASP, "another"), ""

    monkeypatch.setattr(failures, "overlay", overlay)
    monkeypatch.setattr(failures, "filmed_trial", filmed)
    monkeypatch.setattr(failures, "write_clip", lambda path, frames: drawn["clips"].append((path, frames)))
    monkeypatch.setattr(failures, "best_grasps", plan)
    return drawn


CONFIG = ScoreConfig(grasps=4, seed=6)


def exhibit(tmp_path: Path, row: ScoreRow, task: Task) -> Exhibit:
    return failures._exhibit(row, task, 9, CONFIG, tmp_path / "failure-2")  # type: ignore[arg-type]


def test_a_failure_is_made_again_from_its_seed_with_its_best_grasp(tmp_path, drawn):
    task = Task()
    assert exhibit(tmp_path, ROW, task) == Exhibit(ROW, "failure-2.png", "failure-2.gif", "")
    assert task.asked == [(float(np.random.default_rng(4711).uniform()), 9)]
    assert drawn["overlay"] == [("true mesh", "completed mesh", [1.0, 2.0, 3.0])]
    assert drawn["planned"] == [(task.completion, "gfs/top-down", 4, 6)]
    how = {"alone": True, "commands_a_frame": 8}
    assert drawn["film"] == [("world", as_step(GRASP).T_world_gripper.tolist(), "settings of the trial", how)]
    assert drawn["clips"] == [(tmp_path / "failure-2.gif", "frames")]
    with Image.open(tmp_path / "failure-2.png") as picture:
        assert (picture.size, picture.getpixel((0, 0))) == ((12, 6), (77, 77, 77))
    exhibit(tmp_path, ROW, Task(clutter=1))
    assert drawn["film"][1][3]["alone"] is False


def test_what_ended_otherwise_or_cannot_be_made_again_says_so(tmp_path, drawn, monkeypatch):
    drawn["reason"][0] = "no_contact"
    note = exhibit(tmp_path, ROW, Task()).note
    assert note == "made again, the trial ended otherwise: no contact"
    without = exhibit(tmp_path, ROW, Task(completion=None))
    assert without == Exhibit(ROW, "failure-2.png", "", "made again, there was no grasp to try")
    assert drawn["overlay"][-1][1] is None
    monkeypatch.setattr(failures, "best_grasps", lambda *which: ((), "none"))
    assert exhibit(tmp_path, ROW, Task()).note == "made again, there was no grasp to try"

    def fails(*which):
        raise InvalidMesh("too thin")

    monkeypatch.setattr(failures, "best_grasps", fails)
    assert exhibit(tmp_path, ROW, Task()) == Exhibit(ROW, note="it cannot be made again: InvalidMesh: too thin")


def test_a_row_without_a_grasp_has_a_picture_and_its_own_note(tmp_path, drawn):
    nothing = replace(ROW, quality=None, note="FitDiverged: no")
    assert exhibit(tmp_path, nothing, Task()) == Exhibit(nothing, "failure-2.png", "", "FitDiverged: no")
    nothing = replace(nothing, note="")
    assert exhibit(tmp_path, nothing, Task()).note == "there was no grasp to try"
    assert drawn["planned"] == drawn["film"] == []


@pytest.mark.parametrize("error", [OSError(28, "no space"), CannotWrite("failure-2.png cannot be written")])
def test_a_picture_that_cannot_be_written_ends_the_page(tmp_path, drawn, monkeypatch, error):
    def full(path, frames):
        raise error

    monkeypatch.setattr(failures, "write_clip", full)
    with pytest.raises(CannotWrite, match="cannot be written") as caught:
        exhibit(tmp_path, ROW, Task())
    assert ("no space" in str(caught.value)) == (not isinstance(error, CannotWrite))


def test_each_failure_has_the_task_of_its_completer_and_a_number_of_its_own(tmp_path, monkeypatch):
    asked, watched = [], []
    sources = [SimpleNamespace(name=name) for name in ("cup-1", "mug-<7>", "cup-2")]
    monkeypatch.setattr(failures, "load_objects", lambda *which: (asked.append(which), sources)[1])
    monkeypatch.setattr(failures, "task_of", lambda *which: which)
    monkeypatch.setattr(failures, "_exhibit", lambda *which: which)
    rows = (ROW, replace(ROW, object="cup-2", completer="mirror"))
    config = ScoreConfig(split="val")
    found = make_exhibits(
        rows, tmp_path, objects="cup,mug", config=config, progress=lambda e, n: (watched.append(n), e)[1]
    )
    assert found == (
        (ROW, ("cup,mug", config, "gfs"), 1, config, tmp_path / "failure-1"),
        (rows[1], ("cup,mug", config, "mirror"), 2, config, tmp_path / "failure-2"),
    )
    assert (asked, watched) == ([("cup,mug", "val")], [2])
    strange = (ROW, replace(ROW, object="jug-9"), replace(ROW, object="jug-1"))
    with pytest.raises(InvalidOption, match=r"not among the 3 given \(jug-1, jug-9\)"):
        make_exhibits(strange, tmp_path, objects="cup,mug", config=config)


def failed(method: str, name: str, view: int = 0, **changes: Any) -> ScoreRow:
    return replace(ROW, completer=method, object=name, view=view, **changes)


def test_at_most_eight_failures_and_two_of_one_object_are_shown():
    of_one = [failed("mirror", "a", view) for view in range(3)]
    assert len(choose_failures(Report({}, tuple(of_one)))) == 2
    of_many = [failed("mirror", f"{n}") for n in range(9)]
    assert [row.object for row in choose_failures(Report({}, tuple(of_many)))] == [str(n) for n in range(8)]


def test_a_method_whose_failures_are_all_of_one_object_gives_way_to_the_next():
    """The better method takes the first turn and each turn passes over what has been shown twice already."""
    better = [failed("better", "a", view) for view in range(3)]
    better += [failed("better", "z", view, success=True, reason="held") for view in range(3)]
    worse = [failed("worse", "a", 7, cd_m=0.9), failed("worse", "b", 1, cd_m=None), failed("worse", "c", 2)]
    chosen = choose_failures(Report({}, (*worse, *better)))
    assert [(row.completer, row.object, row.view) for row in chosen] == [
        ("better", "a", 0),
        ("worse", "a", 7),
        ("worse", "c", 2),
        ("worse", "b", 1),
    ]


def test_the_oracle_is_known_under_any_planner():
    assert [is_oracle(name) for name in ("oracle", "oracle/top-down", "mirror", "XXoracleXX")] == [
        True,
        True,
        False,
        False,
    ]
    assert has_oracle(Report({}, (ROW, failed("oracle/top-down", "a"))))
    assert not has_oracle(Report({}, (ROW,)))


def test_a_figure_has_its_pictures_facts_and_note():
    html = page._figure(Exhibit(ROW, "failure-1.png", "failure-1.gif", "a <note>"))
    what = "mug-&lt;7&gt;, view 3, gfs/top-down"
    assert html == (
        f'<figure><img src="failure-1.png" alt="Completion over the true object: {what}" width="600" height="300" '
        f'loading="lazy"><img src="failure-1.gif" alt="The trial: {what}" width="400" height="300" loading="lazy">'
        "<figcaption><strong>gfs/top-down on mug-&lt;7&gt;</strong><dl><dt>object</dt><dd>mug-&lt;7&gt;</dd>"
        "<dt>view</dt><dd>3</dd><dt>seed</dt><dd>4711</dd><dt>completer</dt><dd>gfs/top-down</dd>"
        "<dt>CD</dt><dd>12.3 mm</dd><dt>reason</dt><dd>slipped on lift</dd><dt>on the completion</dt><dd>held</dd></dl>"
        "<p>a &lt;note&gt;</p></figcaption></figure>"
    )
    plain = page._figure(Exhibit(replace(ROW, cd_m=None)))
    assert "<img" not in plain
    assert "<p>" not in plain
    assert "<dt>CD</dt><dd>-</dd>" in plain


def test_settings_are_a_list_and_the_numbers_of_a_trial_are_folded_away():
    html = page._settings_section({**SETTINGS, "gps": []}, command="gfp-grasp score & more")
    assert re.sub(r"\n", "", html) == (
        '<section id="settings"><h2>Settings</h2><div class="card settings"><dl><dt>objects</dt><dd>cup,mug</dd>'
        "<dt>split</dt><dd>val</dd><dt>num_objects</dt><dd>5</dd><dt>no_grip</dt><dd>cup-1, mug-2</dd>"
        "<dt>classes</dt><dd>(unknown), bottle, cup, mug</dd><dt>completers</dt><dd>gfs/top-down, oracle</dd>"
        "<dt>views</dt><dd>3</dd><dt>clutter</dt><dd>2</dd><dt>grasps</dt><dd>4</dd><dt>seed</dt><dd>6</dd>"
        "<dt>gps</dt><dd>none</dd></dl><details><summary>numbers of a trial</summary><dl><dt>lift_m</dt><dd>0.2</dd>"
        "</dl></details></div><pre><code>gfp-grasp score &amp; more</code></pre></section>"
    )
    assert "<details>" not in page._settings_section({"views": 1}, command="")


def test_the_table_has_a_column_of_words_at_either_end_and_figures_between():
    html = page._figures_section(Report(SETTINGS, (ROW,)), link="score.json")
    head, body = re.findall(r"<t(?:head|body)>(.*?)</t(?:head|body)>", html)
    names = [
        "completer",
        "true world",
        "margin",
        "of best few",
        "completed world",
        "precision, recall",
        "CD mm",
        "failures",
    ]
    words = {"completer", "failures"}
    columns = [f"<th{' class=' + chr(34) + 'word' + chr(34) if name in words else ''}>{name}</th>" for name in names]
    assert head == f"<tr>{''.join(columns)}</tr>"
    cells = re.findall(r'<td( class="word")? data-name="([^"]*)">([^<]*)</td>', body)
    assert [name for _, name, _ in cells] == names
    assert [bool(kind) for kind, _, _ in cells] == [name in words for name in names]
    assert [cells[0][2], cells[6][2], cells[7][2]] == ["gfs/top-down", "12.3", "slipped on lift 1"]
    assert "one of the best 4 grasps held" in html
    assert 'All of them are in <a href="score.json">score.json</a>.' in html
    assert "<thead><tr></tr></thead>" in page._figures_section(Report(SETTINGS, ()), link="x")


@pytest.mark.parametrize(
    ("methods", "shown", "words"),
    [
        (("mirror",), False, "No trial failed."),
        (("mirror", "oracle"), False, "No row failed where the oracle held."),
        (("mirror",), True, "<h2>Failures</h2>"),
        (("mirror", "oracle"), True, "<h2>Failures where the oracle held</h2>"),
    ],
)
def test_the_gallery_says_what_it_shows(methods, shown, words):
    report = Report({}, tuple(failed(method, "a") for method in methods))
    html = page._failures_section(report, (Exhibit(ROW, "x.png"), Exhibit(ROW, "y.png")) if shown else ())
    assert html.startswith('<section id="failures">\n')
    assert words in html
    assert html.count("<figure>") == 2 * shown
    if shown:
        assert 'style="--dot:#335f9e"></i>true object' in html
        assert 'style="--dot:#faad42"></i>completion' in html


def test_the_command_makes_the_page_again():
    every = (
        "gfp-grasp score --objects cup,mug --completers gfs/top-down,oracle --views 3 --grasps 4 --seed 6 --split val"
    )
    of_all = {**SETTINGS, "classes": ["", *PrimitiveLibrary.shipped().categories]}
    assert page._command(of_all, "my page") == f"{every} --clutter 2 --limit 7 --report 'my page'"
    settings = {**SETTINGS, "detector": "own:one", "gps": ["a", "b c"], "classes": ["", "jug"]}
    del settings["no_grip"], settings["clutter"]
    more = "--detector own:one --limit 5 --gps a --gps 'b c' --classes ,jug --report out"
    assert page._command(settings, "out") == f"{every} {more}"


def test_a_page_without_a_config_takes_that_of_the_settings(tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(page, "make_exhibits", lambda rows, folder, **how: (asked.append((rows, folder, how)), ())[1])
    report = Report({**SETTINGS, "detector": "own:one"}, (ROW,))
    watch: Any = object()
    written = page.write_score_page(report, tmp_path / "new", objects="cup,mug", progress=watch)
    config = ScoreConfig(views=3, grasps=4, seed=6, split="val", clutter=2, detector="own:one")
    assert asked == [((ROW,), tmp_path / "new", {"objects": "cup,mug", "config": config, "progress": watch})]
    own = ScoreConfig(seed=1)
    page.write_score_page(report, tmp_path / "new", objects="cup,mug", config=own)
    assert asked[1][2] == {"objects": "cup,mug", "config": own, "progress": None}
    text = written.read_text(encoding="utf-8")
    assert written == tmp_path / "new" / "index.html"
    assert "<title>gfp_grasp: what completions are worth</title>" in text
    assert "Objects: 5 of cup, mug. Views of each: 3." in text
    assert f"Made by gfp_grasp {__version__}." in text
    assert "--report new" in text
    assert page._css() in text
    order = ["<h1>", 'id="brackets"', 'id="failures"', 'id="figures"', 'id="settings"', "<footer>"]
    assert [text.index(part) for part in order] == sorted(text.index(part) for part in order)
    assert sorted(path.name for path in written.parent.iterdir()) == ["index.html", "score.json"]


def test_the_charts_have_a_legend_for_both_worlds_and_the_brackets():
    html = page._charts_section(Report(SETTINGS, (ROW, failed("oracle", "a"))))
    whisker = '<path d="M1,4 v8 M1,8 H25 M25,4 v8"/><circle cx="13" cy="8" r="5"/></g>'
    keys = re.findall(r'<span><svg class="key" viewBox="0 0 26 16" aria-hidden="true">(.*?)</svg>(.*?)</span>', html)
    assert keys == [
        (f'<g class="true">{whisker}', "on the true object"),
        (f'<g class="completed">{whisker}', "on the completion itself"),
        ('<path class="bracket" d="M13,0 V16"/>', "bracket"),
    ]
    assert html.count('<div class="card">') == 2
    assert "slipped on lift" in html


def test_the_picture_by_itself_has_the_rules_of_the_chart_alone(tmp_path):
    report = Report(SETTINGS, (ROW, failed("oracle", "a")))
    text = page.write_picture(report, tmp_path / "a.svg").read_text(encoding="utf-8")
    opening, style, *_ = text.splitlines()
    assert opening.startswith('<svg xmlns="http://www.w3.org/2000/svg" font-family="Helvetica, Arial, sans-serif" ')
    assert style == "<style>"
    rules = text.split("<style>\n")[1].split("\n</style>")[0].splitlines()
    inks = "--card: #ffffff; --ink: #1d2127; --soft: #5d6570; --rule: #e2e3e0; --accent: #2f66b3;"
    assert rules[0] == f".chart {{ {inks} background: #ffffff; font-size: 14px; }}"
    assert rules[1:] == [line for line in page._css().splitlines() if line.startswith(".chart ")]
    assert len(rules) > 8
