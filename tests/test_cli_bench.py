"""`gfp-grasp bench`: every option reaches the bench, and its figures are printed in the units of the headings."""

import json
from pathlib import Path

import pytest
from recorded_calls import recorded, rows_of, run

from gfp_grasp.bench import BRIEF, METHODS, AblationConfig, CompletionConfig, RegistrationConfig, SearchConfig
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.train import OpenSetConfig

ROW = {"cd_m": 0.00456, "f_score": 0.9123, "iou": 0.5678, "scale_error_median": 0.0213, "ms": 41.6, "views": 7}
PAIRED = {"pairs": 3, "ci95_m": (-0.000123, 0.000456), "gain_m": 0.000234, "gain_share": 0.0716, "wins": 0.652}


@pytest.fixture(autouse=True)
def named_bars(monkeypatch: pytest.MonkeyPatch) -> None:
    """A progress bar is known by what it counts."""
    for module in ("bench", "bench_physics"):
        monkeypatch.setattr(f"gfp_grasp.cli.{module}.track", lambda description: f"bar of {description}")


@pytest.fixture
def json_file(tmp_path: Path) -> Path:
    return tmp_path / "figures.json"


def test_completion_hands_on_every_option_and_prints_millimetres(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, json_file: Path
) -> None:
    report = {
        "rows": {"cup": {"own": {**ROW, "failed": 1}, "other": {"views": 5, "failed": 5}}},
        "paired": {"cup": {"own": PAIRED, "other": {"pairs": 0}}},
    }
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_completion", report)
    bars = recorded(monkeypatch, "gfp_grasp.drawing.write_bars")
    json_file.write_text('{"known": 1}')
    words = "bench completion --objects cup,mug --methods own,other --views 3 --split val --limit 6 --given-category"
    more = "--noise-m 0.002 --protocol fallen --workers 4 --ray host:1 --resume --seed 9"
    options = ("--gps", tmp_path, "--json", json_file, "--picture", tmp_path / "rows.svg")
    assert run(f"{words} {more}", *options) == 0
    config = CompletionConfig(
        views=3,
        seed=9,
        split="val",
        limit=6,
        give_category=True,
        noise_m=0.002,
        protocol="fallen",
        gps=str(tmp_path),
    )
    assert bench.only == (
        ("cup,mug",),
        {
            "methods": ("own", "other"),
            "config": config,
            "known": {"known": 1},
            "workers": 4,
            "ray": "host:1",
            "progress": "bar of views",
        },
    )
    assert bars.only == ((report["rows"], tmp_path / "rows.svg"), {"title": "Completion, fallen views"})
    printed = capsys.readouterr().out
    assert [printed.startswith("cup "), "against the same fit undeformed" in printed] == [True, True]
    assert rows_of(printed) == [
        "own    │   4.56 │     0.912 │ 0.568 │ 2.1% │ 42 │     7 │      1",
        "other  │        │           │       │      │    │     5 │      5",
        "cup   │ own    │    0.234 │ -0.123 to 0.456 │ 7.2% │       65%",
    ]
    assert json.loads(json_file.read_text())["rows"] == report["rows"]


@pytest.mark.parametrize(("word", "methods"), [("", BRIEF), ("--methods brief", BRIEF), ("--methods all", METHODS)])
def test_methods_have_short_names_together_and_what_is_not_asked_for_is_not_done(
    word: str, methods: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, json_file: Path
) -> None:
    report = {"rows": {}, "paired": {}}
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_completion", report)
    bars = recorded(monkeypatch, "gfp_grasp.drawing.write_bars")
    json_file.write_text('{"known": 1}')
    assert run(f"bench completion --objects cup {word} --json", json_file) == 0
    assert bench.only[1]["methods"] == methods
    assert bench.only[1]["known"] is None
    assert bench.only[1]["config"] == CompletionConfig(16, 0, "test", None, False, 0.001, "standard", "")
    assert not bars.calls


def test_primitives_hands_on_every_option_and_prints_figures_and_fits(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, json_file: Path
) -> None:
    row = {"vertices": 985, "modes": 8, "variance_kept": 0.993, "generalization_mm": 0.261, "specificity_mm": 6.46}
    row |= {"generalization_percent": 0.245, "parts": 94, "parts_error_mm": [0.215, 0.8], "build_s": 205}
    fit = {"mesh": "a_bowl", "primitive": "bowl.open", "length_m": 0.161, "error_mm": 0.494, "error_percent": 0.307}
    bare = {**dict.fromkeys(row), "vertices": 3, "modes": 1}
    report = {"rows": {"glass": row, "own": bare}, "fits": [fit]}
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_primitives", report)
    drawn = [recorded(monkeypatch, f"gfp_grasp.drawing.draw_{name}") for name in ("primitives", "modes")]
    words = "bench primitives --workers 3 --data"
    assert run(words, tmp_path, "--data", tmp_path, "--pictures", tmp_path, "--json", json_file) == 0
    library = PrimitiveLibrary.shipped()
    told = {"library": library, "workers": 3, "progress": "bar of meshes"}
    assert bench.only == (([tmp_path, tmp_path],), told)
    assert [call.only[0] for call in drawn] == [
        (library, tmp_path / "primitives.png"),
        (library, tmp_path / "modes.png"),
    ]
    assert rows_of(capsys.readouterr().out) == [
        "glass     │      985 │     8 │     0.99 │         0.26 │ 0.24 │       6.5 │    94 │    0.21 │ 205",
        "own       │        3 │     1 │        - │            - │    - │         - │     - │       - │   -",
        "a_bowl │ bowl.open │      0.16 │    0.49 │ 0.31",
    ]
    assert json.loads(json_file.read_text()) == report


def test_registration_hands_on_every_option_and_prints_degrees_and_millimetres(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], json_file: Path
) -> None:
    row = {"axis_deg": 1.26, "yaw_deg": None, "offset_m": 0.00347, "size": 0.0213, "cd_m": 0.00456, "wrong_rest": 0.053}
    report = {"rows": {"mug": {"box": {**row, "ms": 17.7, "failed": 2, "views": 30}}}}
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_registration", report)
    words = "bench registration --starts box,own --views 7 --limit 3 --mean-size --workers 5 --seed 8 --json"
    assert run(words, json_file) == 0
    config = RegistrationConfig(views=7, limit=3, seed=8, mean_size=True)
    assert bench.only == (
        (),
        {"starts": ("box", "own"), "config": config, "workers": 5, "progress": "bar of shapes"},
    )
    assert rows_of(capsys.readouterr().out) == [
        "mug   │ box   │       1.3 │          │        3.5 │ 2.1% │    4.6 │         5% │ 18 │ 2 of 30"
    ]
    assert json.loads(json_file.read_text()) == report


def test_openset_hands_on_every_option_and_prints_distances_beside_the_hull(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, json_file: Path
) -> None:
    figures = {"cd_m": 0.00456, "of_hull": 0.42, "worst_of_hull": 1.07}
    hull = {"cd_m": 0.0108, "of_hull": 1.0, "worst_of_hull": 1.0}
    row = {"views": 30, "unknown": 0.066, "class": figures, "classfree": figures, "answer": figures, "hull": hull}
    report = {"rows": {"plain": {"known": row}}, "curve": {"plain": "points"}, "threshold": 0.9}
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_openset", report)
    drawn = recorded(monkeypatch, "gfp_grasp.drawing.write_operating_curve")
    words = "bench openset --members 2 --mixtures 5 --workers 3 --json"
    assert run(words, json_file, "--picture", tmp_path / "curve.svg") == 0
    config = OpenSetConfig(members=2, mixtures=5)
    assert bench.only == ((), {"config": config, "workers": 3, "progress": "bar of things"})
    assert drawn.only == (({"plain": "points"}, 0.9, tmp_path / "curve.svg"), {})
    near = "4.56 (0.42)"
    assert rows_of(capsys.readouterr().out) == [
        f"known  │    30 │    6.6% │ {near} │    {near} │ {near} │ 10.80 (1.00)"
    ]
    assert json.loads(json_file.read_text()) == report
    assert run("bench openset") == 0
    assert bench.calls[1] == ((), {"config": OpenSetConfig(), "workers": 1, "progress": "bar of things"})


def test_detection_hands_on_every_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, json_file: Path
) -> None:
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_detection", {"found": 3})
    (tmp_path / "captures").mkdir()
    assert run("bench detection --views 6 --workers 2 --data", tmp_path, "--json", json_file) == 0
    assert run("bench detection") == 0
    assert bench.calls == [
        ((tmp_path,), {"num_views": 6, "workers": 2}),
        ((None,), {"num_views": 4, "workers": 1}),
    ]
    assert capsys.readouterr().out.count('"found": 3') == 2
    assert json.loads(json_file.read_text()) == {"found": 3}


def test_ablation_hands_on_every_option_and_prints_a_column_for_each_number_of_iterations(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, json_file: Path
) -> None:
    cd, plain = [7.12654, 6.0, 5.0, 4.0, 3.0, 2.0, 1.004], {"noise_m": 0.0, "reading": "as taken"}
    report = {
        "settings": {"iterations": [1, 2, 3, 4, 5, 6, 7]},
        "rows": {
            "8-32": {"cd_units": cd, "thirds": [4.5, 3.5, 3.0], "widths": [8, 32], **plain},
            "4-16": {"cd_units": cd, "thirds": [4.5, 3.5, 3.0], "widths": [4, 16], **plain},
            "8-4-32": {"cd_units": cd, "thirds": [9.125, 8.0, 3.0], "widths": [8, 4, 32], **plain},
            "noisy": {
                "cd_units": cd,
                "thirds": [5.0, 4.0, 3.0],
                "widths": [8, 32],
                **plain,
                "noise_m": 0.01,
            },
            "read": {
                "cd_units": cd,
                "thirds": [5.0, 4.0, 3.0],
                "widths": [8, 32],
                **plain,
                "reading": "CD to T",
            },
        },
    }
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_ablation", report)
    curves = recorded(monkeypatch, "gfp_grasp.drawing.write_curves")
    words = "bench ablation --steps 30 --limit 8 --runs elsewhere --workers 3 --seed 4 --picture"
    assert run(words, tmp_path / "lines.svg", "--json", json_file) == 0
    _, named = bench.only
    assert named.pop("report")  # tells of rows as they come
    assert named == {
        "config": AblationConfig(steps=30, limit=8, seed=4),
        "runs": Path("elsewhere"),
        "workers": 3,
    }
    title = f"Layers and widths by iterations after 30 steps of {AblationConfig().batch} patches"
    panels = {
        "codes of 32": {"8-32": cd, "8-4-32": cd},
        "codes of 16": {"4-16": cd},
        "learnt otherwise": {"noisy": cd, "read": cd},
    }
    assert curves.only == ((panels, tmp_path / "lines.svg"), {"title": title, "axis": "iterations m"})
    printed = capsys.readouterr().out
    assert [f"m = {m} " in printed for m in range(9)] == [False, *[True] * 7, False]
    figures = " │ 7.1265 │ 6.0000 │ 5.0000 │ 4.0000 │ 3.0000 │ 2.0000 │ 1.0040 │ "
    assert rows_of(printed)[:3:2] == [f"8-32   {figures}4.5000 │ 3.5000", f"8-4-32 {figures}9.1250 │ 8.0000"]
    assert json.loads(json_file.read_text()) == report
    assert run("bench ablation") == 0
    assert bench.calls[1][1]["config"] == AblationConfig()


def test_search_hands_on_every_option_and_prints_the_front_and_the_papers_network(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, json_file: Path
) -> None:
    quick = {"name": "8-32, 64-32-16, m = 1", "ms": 0.126, "cd_units": 0.09876, "parameters": 4321}
    paper = {"name": "64-1024, 64-32-16, m = 5", "ms": 41.0, "cd_units": 0.5, "parameters": 1234567}
    report = {"settings": {}, "trials": [paper, quick], "front": [quick], "paper": paper}
    bench = recorded(monkeypatch, "gfp_grasp.bench.bench_search", report)
    drawn = recorded(monkeypatch, "gfp_grasp.drawing.write_front")
    words = "bench search --trials 9 --steps 30 --limit 8 --runs elsewhere --workers 3 --seed 4 --picture"
    assert run(words, tmp_path / "front.svg", "--json", json_file) == 0
    _, named = bench.only
    assert named.pop("report")
    config = SearchConfig(steps=30, limit=8, seed=4, trials=9)
    assert named == {"config": config, "runs": Path("elsewhere"), "workers": 3}
    title = f"Networks of the paper's kind after 30 steps of {config.batch} patches"
    assert drawn.only == (([paper, quick], [quick], paper, tmp_path / "front.svg"), {"title": title})
    printed = capsys.readouterr().out
    assert "front of 2 networks" in printed
    assert [[cell.strip() for cell in row.split("│")] for row in rows_of(printed)] == [
        ["8-32, 64-32-16, m = 1", "0.13", "0.0988", "4321"],
        ["the paper's: 64-1024, 64-32-16, m = 5", "41.00", "0.5000", "1234567"],
    ]
    assert json.loads(json_file.read_text()) == report
    assert run("bench search") == 0
    assert bench.calls[1][1]["config"] == SearchConfig()


SPEED = {"limit": 7, "calls": 5, "seed": 3, "progress": "bar of clouds"}
STABILITY = {"motions": 12, "limit": 7, "seed": 3, "workers": 2, "progress": "bar of objects"}


@pytest.mark.parametrize(
    ("words", "function", "received"),
    [
        ("bench speed --calls 5", "bench_speed", SPEED),
        ("bench stability --motions 12 --workers 2", "bench_stability", STABILITY),
    ],
)
def test_speed_and_stability_hand_on_every_option_and_print_all_figures(
    words: str,
    function: str,
    received: dict,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    json_file: Path,
) -> None:
    bench = recorded(monkeypatch, f"gfp_grasp.bench.{function}", {"figure": 1.5})
    assert run(f"{words} --objects cup --limit 7 --seed 3 --json", json_file) == 0
    assert bench.only == (("cup",), received)
    assert json.loads(capsys.readouterr().out) == json.loads(json_file.read_text()) == {"figure": 1.5}


@pytest.mark.parametrize(
    ("command", "limit"), [("speed", 30), ("stability", 20), ("hollow", 20), ("trial", 24), ("resets", 20)]
)
def test_benches_that_take_long_have_a_limit_of_their_own(
    command: str, limit: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = recorded(monkeypatch, f"gfp_grasp.bench.bench_{command}", {"rows": {}})
    assert run(f"bench {command}") == 0
    assert bench.only[1]["limit"] == limit
