"""`gfp-grasp score`: every option arrives, and files are written where they were asked for."""

from pathlib import Path
from typing import ClassVar

import pytest
from recorded_calls import Recorder, recorded, rows_of, run

from gfp_grasp.cli.score import COMPLETERS
from gfp_grasp.completers import get_completer
from gfp_grasp.score import ScoreConfig


class FakeReport:
    """Two rows, and a file that says that it was written."""

    settings: ClassVar[dict[str, list[str]]] = {"no_grip": ["jar-3", "can-7"], "too_heavy": []}

    def table(self) -> list[dict[str, str]]:
        return [{"completer": "own", "held": "3/4"}, {"completer": "oracle", "held": "4/4"}]

    def write(self, path: Path) -> None:
        path.write_text("written")


REPORT = FakeReport()


@pytest.fixture(autouse=True)
def score(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    monkeypatch.setattr("gfp_grasp.cli.score.track", lambda description: f"bar of {description}")
    return recorded(monkeypatch, "gfp_grasp.score.score", REPORT)


def test_score_hands_on_every_option_and_prints_its_table(
    score: Recorder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    picture = recorded(monkeypatch, "gfp_grasp.score.write_picture")
    page = recorded(monkeypatch, "gfp_grasp.score.write_score_page", tmp_path / "[b]" / "index.html")
    (tmp_path / "rows.part.jsonl").write_text("")
    words = "score --objects cup --views 2 --grasps 3 --split val --clutter 1 --limit 6 --classes cup,mug"
    more = "--detector own:find --workers 4 --ray auto --seed 9"
    files = ("--json", tmp_path / "rows.json", "--picture", tmp_path / "rows.svg", "--report", tmp_path / "page")
    assert run(f"{words} {more}", "--completers", "own, oracle", "--gps", tmp_path, *files) == 0
    config = ScoreConfig(
        views=2,
        grasps=3,
        seed=9,
        split="val",
        clutter=1,
        limit=6,
        classes=("cup", "mug"),
        gps=str(tmp_path),
        detector="own:find",
    )
    journal = tmp_path / "rows.part.jsonl"
    received = {"config": config, "workers": 4, "ray": "auto", "journal": journal, "progress": "bar of rows"}
    assert score.only == (("cup", ("own", "oracle")), received)
    assert (tmp_path / "rows.json").read_text() == "written"
    assert not journal.exists()
    assert picture.only == ((REPORT, tmp_path / "rows.svg"), {})
    told = {"objects": "cup", "config": config, "progress": "bar of failures"}
    assert page.only == ((REPORT, tmp_path / "page"), told)
    printed = capsys.readouterr().out
    assert rows_of(printed) == ["own       │  3/4", "oracle    │  4/4"]
    assert f"open {tmp_path / '[b]' / 'index.html'}" in printed


def test_objects_that_were_left_out_are_named(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("score --objects cup") == 0
    assert capsys.readouterr().err == "note: left out, for no grasp fits the jaws: jar-3, can-7\n"


def test_score_takes_all_completers_and_writes_nothing_where_nothing_is_said(
    score: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = recorded(monkeypatch, "gfp_grasp.score.write_picture")
    page = recorded(monkeypatch, "gfp_grasp.score.write_score_page")
    assert run("score --objects all") == 0
    names = tuple(COMPLETERS.split(","))
    config = ScoreConfig(views=4, grasps=5, seed=0, split="test", clutter=0, detector="tabletop")
    received = {"config": config, "workers": 1, "ray": None, "journal": None, "progress": "bar of rows"}
    assert score.only == (("all", names), received)
    assert not picture.calls
    assert not page.calls
    assert (names[0], names[-1]) == ("observed", "oracle")
    assert all(get_completer(name.split("/")[0]) for name in names[:-1])


def test_a_page_has_its_figures_beside_it_and_its_folder_is_made_first(
    score: Recorder, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    recorded(monkeypatch, "gfp_grasp.score.write_score_page", "made")
    assert run("score --objects all --report", tmp_path / "page") == 0
    assert score.only[1]["journal"] == tmp_path / "page" / "score.part.jsonl"
    assert (tmp_path / "page" / "score.json").read_text() == "written"
    (tmp_path / "file").write_text("")
    assert run("score --objects all --report", tmp_path / "file") == 2
    assert len(score.calls) == 1
