"""`gfp-grasp bench peers`: options reach the bench, parts are written as they come, and figures are printed in mm."""

import json
from pathlib import Path
from typing import Any

import pytest
from recorded_calls import Recorder, recorded, rows_of, run

from gfp_grasp.bench import PeersConfig
from gfp_grasp.cli import bench_peers as command
from gfp_grasp.peers import PEERS

ROW = {"cd_m": 0.00456, "f_score": 0.9123, "ms": 41.6, "views": 7, "failed": 1}
NONE = {"cd_m": None, "f_score": 0.0, "ms": 1.2, "views": 7, "failed": 7}
GAIN = {"pairs": 3, "ci95_m": (-0.000123, 0.000456), "gain_m": 0.000234, "gain_share": 0.0716, "wins": 0.652}
MARGIN = {"margin": -0.5, "margin_ci95": [-1.0, 0.25]}
REPORT: dict[str, Any] = {
    "left_out": [{"method": "scrg", "why": "no weights: `gfp-grasp train peer scrg` trains it"}],
    "groups": {"thing": {"pcn": ROW, "topnet": NONE, "gfpnet": {**ROW, "cd_m": 0.0021}}},
    "paired": {"thing": {"pcn": GAIN, "topnet": {"pairs": 0}}},
    "occlusion": {"0.0": {"pcn": ROW, "gfpnet": ROW}, "0.9": {"pcn": NONE, "gfpnet": ROW}},
    "kitti": {"pcn": {"things": 3, "refused": 1, "fidelity_m": 0.5}},
    "score": {
        "completers": {"pcn": {"successes": 2, "attempts": 5, "margin": 1.25, "margin_ci95": [0.5, 2.0]}},
        "paired": {"pcn": {"oracle": MARGIN}},
    },
    "cost": {"pcn": {"ms": None, "first_ms": 900.0, "memory_mb": 250.5, "weights_mb": 1.57, "parameters": 782979}},
    "trials": [],
}


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    monkeypatch.setattr(command, "track", lambda part: f"bar of {part}")
    return recorded(monkeypatch, "gfp_grasp.bench.bench_peers", REPORT)


def test_every_option_is_handed_on_and_every_part_is_printed(
    bench: Recorder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    chart = recorded(monkeypatch, "gfp_grasp.drawing.write_peers")
    file, journals = tmp_path / "peers.json", tmp_path / "peers.part"
    file.write_text('{"known": 1}')
    left_over(journals)
    words = "bench peers --views 2 --limit 9 --peers pcn,scrg --no-score --resume --workers 3 --seed 4"
    shapes = recorded(monkeypatch, "gfp_grasp.bench.shapes_of_peers", {"cup": {}})
    gallery = recorded(monkeypatch, "gfp_grasp.drawing.draw_completions")
    pictures = ("--picture", tmp_path / "a.svg", "--shapes", tmp_path / "a.png")
    assert run(words, "--data", tmp_path, "--kitti", tmp_path, "--json", file, *pictures) == 0
    _, how = bench.only
    assert how["config"] == PeersConfig(("pcn", "scrg"), 2, 9, 4, tmp_path, tmp_path, with_score=False)
    assert (how["known"], how["workers"], how["journals"]) == ({"known": 1}, 3, journals)
    assert how["progress"]("this") == "bar of this"
    assert shapes.only == ((how["config"],), {})
    assert gallery.only == (({"cup": {}}, tmp_path / "a.png"), {})
    assert chart.only == ((REPORT["groups"], REPORT["occlusion"], tmp_path / "a.svg"), {})
    assert json.loads(file.read_text()) == json.loads(json.dumps(REPORT))
    assert not journals.exists()
    how["save"]({"half": "done"})
    assert json.loads(file.read_text()) == {"half": "done"}
    printed = capsys.readouterr()
    assert "note: scrg is left out: no weights: `gfp-grasp train peer scrg` trains it" in printed.err
    rows = [" ".join(row.replace("│", " ").split()) for row in rows_of(printed.out)]
    assert rows == [
        "pcn 4.56 0.912 42 1 of 7 0.234 -0.123 to 0.456 7.2% 65%",
        "topnet - 0.000 1 7 of 7",
        "gfpnet 2.10 0.912 42 1 of 7",
        "pcn 4.56 -",
        "gfpnet 4.56 4.56",
        "pcn 3 1 - - 0.5 - - -",
        "pcn 2/5 1.25 (0.50 to 2.00) - - -0.50 (-1.00 to +0.25)",
        "pcn - 900.0 250.5 1.57 782979 -",
    ]


def test_what_is_not_asked_for_is_not_done(bench: Recorder) -> None:
    bench.answer = {**REPORT, "left_out": [], "occlusion": {}, "kitti": {}, "score": {}}
    assert run("bench peers") == 0
    _, how = bench.only
    assert how["config"] == PeersConfig(tuple(PEERS), 1, 60, 0, None, None, with_score=True)
    assert (how["known"], how["workers"], how["journals"]) == (None, 1, None)


def left_over(journals: Path) -> None:
    journals.mkdir(exist_ok=True)
    (journals / "pcn.0123.jsonl").write_text("rows of grasps")


@pytest.mark.parametrize("words", ["", "--resume"])
def test_trials_that_a_stopped_run_left_are_there_for_one_that_goes_on_only(
    words: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    journals, found = tmp_path / "peers.part", []

    def bench(**how: Any) -> dict[str, Any]:
        found.extend(path.name for path in journals.glob("*"))
        left_over(journals)
        return REPORT

    monkeypatch.setattr("gfp_grasp.bench.bench_peers", bench)
    left_over(journals)
    (journals / "own.txt").write_text("of the user's")
    assert run(f"bench peers {words} --json", tmp_path / "peers.json") == 0
    assert sorted(found) == (["own.txt", "pcn.0123.jsonl"] if words else ["own.txt"])
    assert [path.name for path in journals.iterdir()] == ["own.txt"]


def test_mistakes_are_told_in_a_line(bench: Recorder, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    file = tmp_path / "peers.json"
    assert run("bench peers --resume") == 2
    assert "InvalidOption: --resume goes on from the file of --json, which is missing" in capsys.readouterr().err
    assert run("bench peers --peers pcn,magic") == 2
    assert "no peer 'magic': choose one of pcn, foldingnet" in capsys.readouterr().err
    for content, message in (('{"settings": ', "is no readable JSON"), ("[1]", "holds a list; an object")):
        file.write_text(content)
        assert run("bench peers --resume --json", file) == 2
        assert f"UnreadableFile: {file} {message}" in capsys.readouterr().err
        assert file.read_text() == content
    assert not bench.calls
