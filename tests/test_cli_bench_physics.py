"""`gfp-grasp bench` in MuJoCo: every option reaches the bench, and its figures are printed."""

import json
from pathlib import Path

import pytest
from recorded_calls import recorded, rows_of, run

from gfp_grasp.bench import PARTS_METHODS, HostileConfig, ReadyConfig
from gfp_grasp.completers import COMPLETERS


@pytest.fixture(autouse=True)
def named_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    """A progress bar is known by what it counts."""
    monkeypatch.setattr("gfp_grasp.cli.bench_physics.track", lambda description: f"bar of {description}")


@pytest.fixture
def json_file(tmp_path: Path) -> Path:
    return tmp_path / "figures.json"


ONE_VIEW = {"chamfer_median_mm": 1.234, "chamfer_mean_mm": 2.345, "under_2_mm": 0.5, "failed": 0, "not_simulated": 1}
AT_REST = {"tilt_median_deg": 0.56, "travel_median_mm": 0.78, "stands": 0.25}


def test_ready_hands_on_every_option_prints_each_group_and_writes_the_pages(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], json_file: Path, tmp_path: Path
) -> None:
    row = {**ONE_VIEW, **AT_REST, "hidden": {}, "seconds_median": 0.3, "seconds_p95": 0.4}
    report = {"rows": {"procedural": {"own": row}, "real": {"own": row}}, "trials": [{"view": 1}]}
    bench = recorded(monkeypatch, "gfp_grasp.bench.ready.bench_ready", report)
    checked = recorded(monkeypatch, "gfp_grasp.bench.ready_table.check_pages")
    written = recorded(monkeypatch, "gfp_grasp.bench.ready_table.write_pages")
    words = "bench ready --completers own,other --views 7 --scenes 3 --workers 2 --seed 5 --page a.md --page b.md"
    assert run(words, "--data", tmp_path, "--json", json_file) == 0
    how = {"completers": ("own", "other"), "config": ReadyConfig(views=7, scenes=3, seed=5), "workers": 2}
    assert bench.only == ((tmp_path,), {**how, "progress": "bar of views and scenes"})
    pages = [Path("a.md"), Path("b.md")]
    assert checked.only == ((pages,), {})
    assert written.only == ((report, json_file, pages), {})
    printed = capsys.readouterr().out
    assert printed.index("procedural") < printed.index("real")
    assert rows_of(printed) == 2 * [
        "own       │  1.23, 2.35 │   50 % │ 0.6 (1 failed) │        0.8 │  25 % │ 0.30, 0.40"
    ]
    assert json.loads(json_file.read_text()) == report


def test_ready_takes_all_completers_and_a_few_views_where_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = recorded(monkeypatch, "gfp_grasp.bench.ready.bench_ready", {"rows": {}})
    assert run("bench ready") == 0
    how = {"completers": COMPLETERS, "config": ReadyConfig(), "workers": 1}
    assert bench.only == ((None,), {**how, "progress": "bar of views and scenes"})


def test_a_page_names_the_file_of_its_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = recorded(monkeypatch, "gfp_grasp.bench.ready.bench_ready")
    assert run("bench ready --page README.md") == 2
    assert bench.calls == []


def test_collision_hands_on_every_option_and_prints_a_dash_for_what_was_not_measured(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], json_file: Path
) -> None:
    row = {"ms": 12.34, "parts": 17.6, "vertices": 411.2, "error_mm": (0.126, 0.987), "iou": 0.9216, "objects": 8}
    rows = {
        "own": {**row, "steps_per_s": 1234.6, "failed": 1},
        "still": {**row, "steps_per_s": None, "failed": 0},
        "none": {"objects": 2, "failed": 6},
    }
    report = {"rows": {"completed": {"mug": rows}}}
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_collision", report)
    words = "bench collision --objects cup --methods own,still --limit 7 --truth --workers 2 --seed 5 --json"
    assert run(words, json_file) == 0
    assert bench.only == (
        ("cup",),
        {
            "methods": ("own", "still"),
            "limit": 7,
            "truth": True,
            "seed": 5,
            "workers": 2,
            "progress": "bar of objects",
        },
    )
    printed = capsys.readouterr().out
    assert printed.startswith("mug, completed meshes")
    assert rows_of(printed) == [
        "own    │ 12.3 │    18 │      411 │    0.13 │     0.99 │ 0.922 │    1235 │       8 │      1",
        "still  │ 12.3 │    18 │      411 │    0.13 │     0.99 │ 0.922 │       - │       8 │      0",
        "none   │    - │     - │        - │       - │        - │     - │       - │       2 │      6",
    ]
    assert json.loads(json_file.read_text())["rows"]["completed"]["mug"]["none"] == rows["none"]


def test_collision_takes_all_methods_and_four_objects_where_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_collision", {"rows": {}})
    assert run("bench collision") == 0
    received = {"methods": PARTS_METHODS, "limit": 4, "truth": False, "seed": 0, "workers": 1}
    assert bench.only == (("all",), {**received, "progress": "bar of objects"})


def test_hollow_hands_on_every_option_and_prints_its_rows(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], json_file: Path
) -> None:
    report = {"rows": {"cup": 0.25}, "settings": {}}
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_hollow", report)
    assert run("bench hollow --objects cup --limit 7 --workers 2 --seed 5 --json", json_file) == 0
    assert bench.only == (("cup",), {"limit": 7, "seed": 5, "workers": 2, "progress": "bar of objects"})
    assert json.loads(capsys.readouterr().out) == {"cup": 0.25}
    assert json.loads(json_file.read_text()) == report


def test_trial_hands_on_every_option_and_prints_all_but_its_many_trials(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], json_file: Path
) -> None:
    report = {"creep_mm": 0.5, "trials": [{"number": 1}, {"number": 2}]}
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_trial", report)
    words = "bench trial --objects cup --limit 7 --grasps 3 --completer mirror --workers 2 --seed 5 --json"
    assert run(words, json_file) == 0
    received = {"limit": 7, "grasps": 3, "completer": "mirror", "seed": 5, "workers": 2}
    assert bench.only == (("cup",), {**received, "progress": "bar of objects"})
    assert json.loads(capsys.readouterr().out) == {"creep_mm": 0.5}
    assert json.loads(json_file.read_text()) == report


def test_resets_hand_on_every_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], json_file: Path
) -> None:
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_resets", {"mb": 1.5})
    words = "bench resets --objects cup --resets 12 --completer gfs --limit 7 --seed 5 --json"
    assert run(words, json_file) == 0
    assert bench.only == (
        ("cup",),
        {"resets": 12, "completer": "gfs", "limit": 7, "seed": 5, "progress": "bar of resets"},
    )
    assert json.loads(capsys.readouterr().out) == json.loads(json_file.read_text()) == {"mb": 1.5}


@pytest.mark.parametrize(("crashed", "code"), [(0, 0), (2, 1)])
def test_hostile_hands_on_every_option_and_fails_where_anything_was_bad(
    crashed: int, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], json_file: Path
) -> None:
    report = {"rows": {"repair": {"open": {"solid": 4, "refused": 3}}}, "bad": {"hung": 0, "crashed": crashed}}
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_hostile", report)
    json_file.write_text('{"known": 1}')
    words = "bench hostile --count 30 --coacd 4 --workers 2 --seed 5 --resume --json"
    assert run(words, json_file) == code
    arguments, named = bench.only
    save = named.pop("save")
    assert arguments == ()
    assert named == {
        "config": HostileConfig(count=30, coacd=4, seed=5),
        "known": {"known": 1},
        "workers": 2,
        "progress": "bar of meshes",
    }
    printed = capsys.readouterr().out
    assert printed.startswith("repair")
    assert rows_of(printed) == ["open │ refused 3, solid 4"]
    assert printed.strip().endswith(f"hung 0, crashed {crashed}")
    assert json.loads(json_file.read_text()) == report
    save({"so far": 1})
    assert json.loads(json_file.read_text()) == {"so far": 1}


def test_hostile_begins_anew_where_it_is_not_told_to_resume(monkeypatch: pytest.MonkeyPatch, json_file: Path) -> None:
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_hostile", {"rows": {}, "bad": {}})
    json_file.write_text('{"known": 1}')
    assert run("bench hostile --json", json_file) == 0
    assert bench.only[1]["known"] is None
    assert bench.only[1]["config"] == HostileConfig(10_000, 1000, 0)
