"""The score of completers on plain cylinders, and its report."""

import json
import os
import signal
from pathlib import Path

import pytest
import trimesh

from gfp_grasp.errors import InvalidOption, UnknownCompleter
from gfp_grasp.score import ScoreConfig, score
from gfp_grasp.score.rows import make_row
from gfp_grasp.types import REASONS

COMPLETERS = ("oracle", "mirror/top-down", "own_completers:upright_box", "own_completers:gives_up")
ONE_VIEW = ScoreConfig(views=1, seed=5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("two-things")
    for name, radius_m in (("bottle__slim", 0.025), ("plain", 0.034), ("anvil__heavy", 0.03)):
        mesh = trimesh.creation.cylinder(radius_m, 0.14, sections=32)
        mesh.apply_translation((0, 0, 0.07))
        mesh.export(path / f"{name}.ply")
    return path


@pytest.fixture(scope="module")
def report(folder):
    return score(folder, COMPLETERS, config=ONE_VIEW)


def without_timings(report):
    content = json.loads(report.to_json())
    for row in (*content["trials"], *content["completers"].values()):
        del row["timings_s"]
    return content


def test_a_run_that_was_stopped_goes_on_where_it_was(folder, report, tmp_path):
    journal = tmp_path / "score.part.jsonl"
    stopped = []

    def stop_after_three(trials, total):
        assert total == len(report.rows)
        for trial in trials:
            stopped.append(trial)
            if len(stopped) == 3:
                raise KeyboardInterrupt
            yield trial

    with pytest.raises(KeyboardInterrupt):
        score(folder, COMPLETERS, config=ONE_VIEW, journal=journal, progress=stop_after_three)
    assert len(journal.read_text().splitlines()) == 4  # the settings and three trials
    left = []
    again = score(folder, COMPLETERS, config=ONE_VIEW, journal=journal, progress=lambda t, n: (left.append(n), t)[1])
    assert left == [len(report.rows) - 3]
    assert without_timings(again) == without_timings(report)


def test_the_journal_of_another_seed_is_refused(folder, tmp_path):
    journal = tmp_path / "score.part.jsonl"
    score(folder, ("oracle",), config=ScoreConfig(views=1), journal=journal)
    with pytest.raises(InvalidOption, match="another run"):
        score(folder, ("oracle",), config=ScoreConfig(views=1, seed=1), journal=journal)


def test_what_the_gripper_cannot_take_hold_of_is_left_out_and_named(tmp_path):
    for name, radius_m in (("bottle__slim", 0.025), ("bottle__stout", 0.08)):
        mesh = trimesh.creation.cylinder(radius_m, 0.14, sections=32)
        mesh.apply_translation((0, 0, 0.07))
        mesh.export(tmp_path / f"{name}.ply")
    found = score(tmp_path, ("oracle",), config=ScoreConfig(views=1, grasps=1))
    assert (found.settings["no_grip"], found.settings["too_heavy"]) == (["stout"], [])
    assert {row.object for row in found.rows} == {"slim"}
    (tmp_path / "bottle__slim.ply").unlink()
    with pytest.raises(InvalidOption, match="no grip: stout"):
        score(tmp_path, ("oracle",), config=ScoreConfig(views=1))


def killed_at_first_row(job):
    marker = Path(job.objects) / "was_here"
    if not marker.exists():
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return make_row(job)


@pytest.mark.slow
def test_a_killed_worker_costs_no_row(folder, report, monkeypatch):
    monkeypatch.setattr("gfp_grasp.score.run.make_row", killed_at_first_row)
    again = score(folder, COMPLETERS, config=ONE_VIEW, workers=2)
    assert (folder / "was_here").exists()
    assert without_timings(again) == without_timings(report)


@pytest.mark.slow
def test_a_cluster_of_two_nodes_scores_the_same_trial_by_trial(folder, report, monkeypatch):
    utils = pytest.importorskip("ray.cluster_utils")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))  # the nodes are to find own_completers
    cluster = utils.Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        cluster.add_node(num_cpus=1)
        again = score(folder, COMPLETERS, config=ONE_VIEW, ray=cluster.address)
    finally:
        cluster.shutdown()
    assert without_timings(again) == without_timings(report)


def test_every_completer_meets_the_same_objects_and_views(report):
    met = {
        name: [(t.object, t.view, t.episode_seed) for t in report.rows if t.completer == name] for name in COMPLETERS
    }
    assert all(rows == met["oracle"] for rows in met.values())
    assert [row[0] for row in met["oracle"]] == ["slim", "plain"]  # an anvil is of no class that can be completed


def test_the_oracle_holds_every_cylinder_in_both_worlds(report):
    oracle = report.completers()["oracle"]
    assert oracle["success_rate"] == 1.0
    assert oracle["completed_world"]["success_rate"] == 1.0
    assert oracle["cd_m"] < 0.004


def test_a_completer_that_gives_up_has_failed_attempts(report):
    row = report.completers()["own_completers:gives_up"]
    assert row["attempts"] == 2
    assert row["reasons"] == {"no_grasp_found": 2}
    assert row["cd_m"] is None


def test_the_json_has_the_promised_layout_and_no_path(report, folder):
    content = json.loads(report.to_json())
    assert list(content) == ["settings", "completers", "classes", "paired", "trials"]
    assert content["classes"]["bottle"]["oracle"]["successes"] == 1
    assert content["settings"]["objects"] == folder.name
    assert str(folder.parent) not in report.to_json()
    assert len(content["trials"]) == 8
    for row in content["completers"].values():
        assert {"attempts", "successes", "success_rate", "ci95", "reasons", "cd_m"} <= row.keys()
        assert sum(row["reasons"].values()) == row["attempts"]
        assert set(row["reasons"]) <= set(REASONS)


@pytest.mark.slow  # each worker imports everything afresh
def test_the_same_score_on_two_workers_differs_in_timings_alone(report, folder):
    again = score(folder, COMPLETERS, config=ONE_VIEW, workers=2)
    assert without_timings(again) == without_timings(report)


def test_the_report_is_written_and_tabled(report, tmp_path):
    report.write(tmp_path / "score.json")
    assert json.loads((tmp_path / "score.json").read_text()) == json.loads(report.to_json())
    table = report.table()
    assert [row["completer"] for row in table] == list(COMPLETERS)
    assert table[0]["true world"].startswith("2/2 = 1.00 [0.34, 1.00]")
    assert table[3]["failures"] == "no_grasp_found 2"


@pytest.mark.parametrize(
    ("planner", "reason", "note"),
    [
        ("plans_lazily", "held", ""),
        ("plans_nothing", "no_grasp_found", "gave a str"),
        ("plans_badly", "no_grasp_found", "failed with ZeroDivisionError: of my own making"),
    ],
)
def test_a_planner_of_ones_own_costs_its_own_trials_at_most(folder, planner, reason, note):
    report = score(folder, [f"oracle/own_completers:{planner}"], config=ScoreConfig(views=1, seed=5, limit=1))
    assert [row.reason for row in report.rows] == [reason]
    assert note in report.rows[0].note


def test_classes_choose_the_objects(folder):
    report = score(folder, ["own_completers:gives_up"], config=ScoreConfig(views=1, classes=("anvil",)))
    assert [row.object for row in report.rows] == ["heavy"]
    everything = score(folder, ["own_completers:gives_up"], config=ScoreConfig(views=1, classes=("*",)))
    assert len(everything.rows) == 3


@pytest.mark.parametrize(
    ("knobs", "error", "message"),
    [
        ({"completers": ()}, InvalidOption, "at least one"),
        ({"completers": ("mirror", "mirror")}, InvalidOption, "each but once"),
        ({"completers": ("mirror/magic",)}, InvalidOption, "no planner 'magic'.*antipodal"),
        ({"completers": ("mirror/own_completers:missing",)}, InvalidOption, "cannot be imported"),
        ({"completers": ("mirror/own_completers:__doc__",)}, InvalidOption, "is a str, not a function"),
        ({"config": ScoreConfig(classes=("teapot",))}, InvalidOption, "no object is of class teapot"),
        ({"completers": ("magic",)}, UnknownCompleter, "magic"),
        ({"workers": -1}, InvalidOption, "workers"),
    ],
)
def test_what_cannot_be_scored_is_refused(folder, knobs, error, message):
    with pytest.raises(error, match=message):
        score(folder, **{"completers": ("mirror",), **knobs})


@pytest.mark.parametrize(("name", "value"), [("views", 0), ("grasps", 0), ("limit", 0), ("clutter", -1)])
def test_a_config_of_nothing_is_refused_by_name(name, value):
    with pytest.raises(InvalidOption, match=f"{name} is {value}"):
        ScoreConfig(**{name: value})
