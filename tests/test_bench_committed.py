"""The committed results follow from their own rows, and were made with the settings of today."""

import json
from dataclasses import asdict, replace
from inspect import signature
from pathlib import Path
from typing import Any

import pytest

from gfp_grasp import bench
from gfp_grasp.bench import (
    AblationConfig,
    CompletionConfig,
    HostileConfig,
    ReadyConfig,
    RegistrationConfig,
    collision,
    hollow,
    hostile,
    methods,
    peer_trials,
    peers,
    registration,
    rows,
    search,
)
from gfp_grasp.bench.ablation import ITERATIONS
from gfp_grasp.bench.collision import PartsRow
from gfp_grasp.bench.hollow import HollowRow
from gfp_grasp.bench.hostile import HostileRow
from gfp_grasp.bench.methods import FORMER_NAMES
from gfp_grasp.bench.openset import report_of
from gfp_grasp.bench.ready import by_group
from gfp_grasp.bench.ready_rows import SceneRow, ViewRow
from gfp_grasp.bench.registration import FitRow
from gfp_grasp.bench.rows import CompletionRow
from gfp_grasp.completers import COMPLETERS, PEER_COMPLETERS
from gfp_grasp.envs import TrialSettings
from gfp_grasp.score import Report, ScoreConfig, ScoreRow
from gfp_grasp.train import CACHE, OpenSetRow, ViewsConfig

RESULTS = Path(__file__).parents[1] / "results"


def committed(name: str) -> dict[str, Any]:
    return json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))


def of_today(name: str) -> str:
    return FORMER_NAMES.get(name, name)


def json_of(value: Any) -> Any:
    return json.loads(json.dumps(value))


def without_gaps(record: dict[str, Any]) -> dict[str, Any]:
    """A row as it is written today: figures that do not apply are left out."""
    return {name: value for name, value in record.items() if value is not None}


@pytest.mark.parametrize("name", ["collision_test", "collision_real", "collision_mug"])
def test_figures_of_parts_follow_from_their_rows(name: str):
    report = committed(name)
    found = [PartsRow(**row) for row in report["trials"]]
    assert [json_of(row.to_json()) for row in found] == [without_gaps(row) for row in report["trials"]]
    methods = report["settings"]["methods"]
    for mesh, figures in report["rows"].items():
        assert collision._by_class([row for row in found if row.mesh == mesh], methods) == figures
    assert collision._ratios(found) == report["ratio"]


@pytest.mark.parametrize("name", ["hollow_test", "hollow_real"])
def test_figures_of_hollow_things_follow_from_their_rows(name: str):
    report = committed(name)
    found = [HollowRow(**row) for row in report["trials"]]
    assert [json_of(row.to_json()) for row in found] == [without_gaps(row) for row in report["trials"]]
    for category, figures in report["rows"].items():
        assert hollow._figures([row for row in found if row.category == category]) == figures


def test_figures_of_hostile_meshes_follow_from_their_rows():
    report = committed("hostile")
    done = {(row["step"], row["number"]): HostileRow(**row) for row in reversed(report["trials"])}
    assert hostile._report(HostileConfig(), done) == report


def test_figures_of_known_and_unknown_follow_from_their_rows():
    report = committed("openset")
    found = [OpenSetRow(**{name: _as_row(value) for name, value in row.items()}) for row in report["trials"]]
    assert json_of([row.to_json() for row in found]) == report["trials"]
    assert json_of({**report_of(found), "trials": report["trials"]}) == report


def _as_row(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def test_figures_of_registrations_follow_from_their_rows():
    report = committed("registration")
    found = [FitRow(**row) for row in report["trials"]]
    assert [row.to_json() for row in found] == report["trials"]
    for family, figures in report["rows"].items():
        for start, of_start in figures.items():
            mine = [row for row in found if family in ("all", row.family) and row.start == start]
            assert registration._summarise(mine) == of_start
    assert report["settings"] == {
        **asdict(RegistrationConfig(views=2, limit=6)),
        "view": json_of(asdict(ViewsConfig())),
    }


@pytest.mark.parametrize("name", [path.stem for path in sorted(RESULTS.glob("completion_*.json"))])
def test_figures_of_completions_follow_from_their_rows(name: str):
    report = committed(name)
    found = [CompletionRow(**{**row, "method": of_today(row["method"])}) for row in report["trials"]]
    for category, figures in report["rows"].items():
        mine = [row for row in found if category in ("all", row.category)]
        for method, of_method in figures.items():
            assert rows.summarise([row for row in mine if row.method == of_today(method)]) == of_method
        for method, gain in report["paired"][category].items():
            assert rows.paired_gain(mine, method, "registration") == gain
    table = {c: {of_today(m): f for m, f in figures.items()} for c, figures in report["rows"].items()}
    assert rows.table_one(table) == report["paper_table_one"]


@pytest.mark.parametrize("name", [path.stem for path in sorted(RESULTS.glob("score_*.json"))])
def test_figures_of_scores_follow_from_their_rows(name: str):
    report = committed(name)
    again = Report(report["settings"], tuple(ScoreRow(**row) for row in report["trials"]))
    assert json.loads(again.to_json()) == report


@pytest.mark.parametrize("name", ["peers_test", "peers_real"])
def test_figures_of_the_comparison_with_other_networks_follow_from_their_trials(name: str):
    report = committed(name)
    compared = report["groups"] | {f"hidden {share}": figures for share, figures in report["occlusion"].items()}
    assert len(compared) >= 12
    for group, figures in compared.items():
        records = [trial for trial in report["trials"] if trial["group"] == group]
        found = [CompletionRow(**row) for row in peer_trials.unpacked(records, report["settings"]["groups"][group], {})]
        assert set(figures) >= set(PEER_COMPLETERS)
        for method, of_method in figures.items():
            again = rows.summarise([row for row in found if row.method == method])
            assert {figure: again[figure] for figure in of_method} == of_method
        for method, gain in report["paired"][group].items():
            assert rows.paired_gain(found, "gfpnet", method) == gain
    grasped = [
        ScoreRow(**peers._own(trial)) for trial in report["trials"] if trial["group"] == peer_trials.IN_SIMULATOR
    ]
    scored = Report(report["settings"]["score"], tuple(grasped))
    assert json_of(scored.completers()) == report["score"]["completers"]
    assert set(report["cost"]) >= set(PEER_COMPLETERS)


def test_figures_of_readiness_follow_from_their_rows_and_are_of_every_completer():
    report = committed("ready")
    views = [ViewRow(**row) for row in report["trials"]]
    scenes = [SceneRow(**row) for row in report["scenes"]]
    assert [json_of(row.to_json()) for row in (*views, *scenes)] == [*report["trials"], *report["scenes"]]
    assert by_group(views, scenes) == report["rows"]
    for name in ("seed", "noise_m"):
        assert report["settings"][name] == getattr(ReadyConfig(), name)
    assert report["settings"]["completers"] == list(COMPLETERS)


def test_the_ablation_was_made_with_the_defaults_and_has_every_row():
    report = committed("ablation")
    assert report["settings"] == {**asdict(AblationConfig()), "iterations": list(ITERATIONS)}
    assert len(report["rows"]) == 15
    assert "64-128-1024, 0.01 m noise" in report["rows"]
    for row in report["rows"].values():
        assert len(row["cd_units"]) == len(ITERATIONS) == 7
        assert row["thirds"][2] == row["cd_units"][4]


def test_the_search_was_made_with_the_defaults_and_its_front_follows_from_its_networks():
    report = committed("search")
    assert report["settings"] == asdict(search.SearchConfig())
    assert len({row["name"] for row in report["trials"]}) == len(report["trials"]) == 40
    assert report["front"] == search.front_of(report["trials"])
    assert report["paper"] == report["trials"][0]
    assert report["paper"]["name"] == search.name_of(search.PAPER)


@pytest.mark.parametrize("protocol", ["standard", "fallen", "hidden", "noisy"])
def test_real_objects_were_completed_with_the_defaults_but_for_the_protocol(protocol: str):
    settings = committed("completion_real" + f"_{protocol}" * (protocol != "standard"))["settings"]
    of_config = asdict(replace(CompletionConfig(), protocol=protocol))
    assert (of_config.pop("gps"), of_config.pop("hidden_share")) == ("", 0.5)
    assert settings == {"objects": settings["objects"], "samples": 8192, **of_config}


def test_scores_were_made_with_the_defaults_but_for_the_views():
    settings = committed("score_test")["settings"]
    config = ScoreConfig(views=settings["views"])
    for name in ("grasps", "seed", "split", "clutter"):
        assert settings[name] == getattr(config, name)
    assert set(settings["classes"]) <= config.wanted()
    assert settings["trial"] == asdict(TrialSettings())
    assert (ScoreConfig().views, ScoreConfig().limit, ScoreConfig().detector) == (4, None, "tabletop")


def test_a_bench_without_options_is_the_one_that_its_result_was_made_with():
    resets, trial, stability = committed("resets"), committed("trial"), committed("stability")
    assert defaults("bench_resets") == {
        "objects": "all",
        "progress": None,
        **{name: resets["settings"][name] for name in ("resets", "completer", "limit", "seed")},
    }
    assert defaults("bench_trial") == {
        "objects": "all",
        "limit": trial["settings"]["num_objects"],
        **{name: trial["settings"][name] for name in ("grasps", "completer", "seed")},
        **QUIET,
    }
    assert defaults("bench_stability") == {
        "objects": "all",
        "motions": stability["motions"],
        "limit": stability["objects"],
        "seed": 0,
        **QUIET,
    }
    assert defaults("bench_hollow") == {
        "objects": "all",
        "limit": committed("hollow_test")["rows"]["cup"]["objects"],
        "seed": 0,
        **QUIET,
    }


def test_the_other_benches_are_short_without_options():
    every = {"objects": "all", "seed": 0, **QUIET}
    assert defaults("bench_collision") == every | {"methods": collision.METHODS, "limit": 4, "truth": False}
    assert defaults("bench_speed") == {"objects": "all", "limit": 30, "calls": 0, "seed": 0, "progress": None}
    assert defaults("bench_detection") == {"cache": CACHE, "num_views": 4, "workers": 1}
    assert defaults("bench_registration") == {
        "starts": ("proposal", "box", "pcrnet"),
        "config": RegistrationConfig(views=4, limit=None, seed=0, mean_size=False),
        **QUIET,
    }
    assert defaults("bench_ready") == {"data": None, "completers": COMPLETERS, "config": ReadyConfig(), **QUIET}
    assert defaults("bench_ablation") == {
        "config": AblationConfig(),
        "runs": Path("runs"),
        "workers": 1,
        "report": None,
    }


def test_the_room_shows_what_its_modules_have():
    assert bench.BRIEF is methods.BRIEF
    assert bench.METHODS is methods.METHODS
    assert bench.PARTS_METHODS is collision.METHODS
    for name in bench.__all__:
        if name.startswith("bench_") or name.endswith("Config"):
            assert getattr(bench, name).__name__ == name
    with pytest.raises(AttributeError, match="no attribute 'magic'"):
        bench.magic  # noqa: B018


QUIET = {"workers": 1, "progress": None}


def defaults(name: str) -> dict[str, Any]:
    parameters = signature(getattr(bench, name)).parameters.values()
    return {p.name: p.default for p in parameters if p.default is not p.empty}
