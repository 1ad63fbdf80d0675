"""Several scores side by side, from rows that are written by hand."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hand_rows import a_row
from recorded_calls import run

from gfp_grasp.errors import InvalidOption, UnreadableFile
from gfp_grasp.score import TOGETHER, Report, read_report, study


@pytest.fixture
def scores(tmp_path: Path) -> list[Path]:
    """Cups, of which mirror holds one of three, and tools, of which it holds none of one; both worlds differ."""
    cups = [a_row("mirror", 0, True, True), a_row("mirror", 1, False, True), a_row("mirror", 2, False, False)]
    cups += [replace(a_row("oracle", view, True, True), margin=4.0) for view in range(3)]
    tools = [a_row("mirror", 0, False, True), replace(a_row("oracle", 0, True, True), margin=2.0)]
    paths = [tmp_path / "cups.json", tmp_path / "tools.json"]
    for path, rows in zip(paths, (cups, tools), strict=True):
        Report({"objects": path.stem}, tuple(rows)).write(path)
    return paths


def named(scores: list[Path]) -> dict[str, Path]:
    return {path.stem: path for path in scores}


def test_a_report_is_read_as_it_was_written(scores: list[Path]):
    report = read_report(scores[0])
    assert report.to_json() + "\n" == scores[0].read_text()
    assert report.rows[1].completed_reason == "held"


def test_sets_stand_side_by_side_and_together(scores: list[Path]):
    sets = study(named(scores))["sets"]
    assert list(sets) == ["cups", "tools", TOGETHER]
    assert sets["tools"]["settings"] == {"objects": "tools"}
    assert [sets[name]["completers"]["mirror"]["successes"] for name in sets] == [1, 0, 1]
    assert [sets[name]["completers"]["mirror"]["attempts"] for name in sets] == [3, 1, 4]
    assert [sets[name]["paired"]["mirror"]["oracle"]["margin"] for name in sets] == pytest.approx([-3, -2, -11 / 4])
    assert sets[TOGETHER]["paired"]["mirror"]["oracle"]["pairs"] == 4


def test_objects_of_one_name_in_two_sets_are_two_objects(scores: list[Path]):
    """Both sets call theirs `a`: together the interval is over two objects, with one alone it has no width."""
    sets = study(named(scores))["sets"]
    low, high = sets["cups"]["paired"]["mirror"]["oracle"]["margin_ci95"]
    assert low == high
    low, high = sets[TOGETHER]["paired"]["mirror"]["oracle"]["margin_ci95"]
    assert (low, high) == (pytest.approx(-3.0), pytest.approx(-2.0))


def test_promises_that_the_completed_world_did_not_keep_are_counted(scores: list[Path]):
    sets = study(named(scores))["sets"]
    assert [sets[name]["broken_promises"]["mirror"] for name in sets] == [
        {"no_contact": 1},
        {"no_contact": 1},
        {"no_contact": 2},
    ]
    assert sets[TOGETHER]["broken_promises"]["oracle"] == {}


def test_what_is_no_score_is_refused(scores: list[Path], tmp_path: Path):
    other = tmp_path / "other.json"
    other.write_text('{"trials": 3}')
    with pytest.raises(UnreadableFile, match=r"other\.json is no score"):
        study(named([scores[0], other]))
    with pytest.raises(UnreadableFile, match=r"missing\.json"):
        read_report(tmp_path / "missing.json")
    with pytest.raises(InvalidOption, match="sets are none"):
        study({})
    with pytest.raises(InvalidOption, match="none called together"):
        study({TOGETHER: scores[0]})
    Report({}, (replace(a_row("mirror", 0, True, True), margin=None),)).write(other)
    with pytest.raises(InvalidOption, match="without a margin"):
        study(named([other]))
    Report({}, (a_row("oracle", 0, True, True),)).write(other)
    with pytest.raises(InvalidOption, match="completers oracle and cups mirror, oracle"):
        study(named([scores[0], other]))


def test_the_command_prints_draws_and_writes(
    scores: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("COLUMNS", "250")
    drawn, written = tmp_path / "study.svg", tmp_path / "study.json"
    assert run("bench study", scores[0], f"hand tools={scores[1]}", "--picture", drawn, "--json", written) == 0
    told = capsys.readouterr().out
    assert "-2.75 (-3.00 to -2.00)" in told
    assert "no_contact 2" in told
    known = study({"cups": scores[0], "hand tools": scores[1]})
    assert json.loads(written.read_text())["sets"] == known["sets"]
    chart = drawn.read_text()
    assert "hand tools, 1 views" in chart
    assert chart.count("<circle") == 6
    assert run("bench study", scores[0], scores[0]) != 0
    assert "2 scores have 1 names" in capsys.readouterr().err
