"""Rows of a score, for episodes and grasps whose outcomes are known, and the jobs that they are made by."""

import json
from dataclasses import asdict
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bodies import box_part, l_shape
from clocks import SteadyClock

from gfp_grasp.envs import ActionCode, EnvConfig
from gfp_grasp.errors import WorkerLost
from gfp_grasp.grasps import GraspConfig
from gfp_grasp.score import ScoreConfig, ScoreRow
from gfp_grasp.score import rows as score_rows
from gfp_grasp.score.rows import RowJob, best_grasps, hindrance, lost_row, make_row, task_of
from gfp_grasp.transforms import make_T
from gfp_grasp.types import CollisionMesh, Grasp, Outcome, TrueObject

RESULTS = Path(__file__).parents[1] / "results"
GRASPS = tuple(Grasp(make_T(None, (0, 0, 0.1 + 0.05 * n)), 0.04 + 0.01 * n, 0.9 - 0.2 * n) for n in range(4))
CONFIG = ScoreConfig(views=2, grasps=4, seed=3, clutter=2, gps="mine", detector="tabletop", split="val")
JOB = RowJob("cup", 7, "cup-7", "gfs/top-down", 1, CONFIG)


def rounded(grasp: Grasp) -> tuple:
    """What a grasp is told apart by after it has gone through an action."""
    return tuple(grasp.T_world_gripper[:3, 3].round(4)), round(grasp.width_m, 4)


def test_the_seed_of_a_view_is_that_of_the_committed_scores():
    content = json.loads((RESULTS / "score_test.json").read_text(encoding="utf-8"))
    assert len(content["trials"]) > 1000
    for row in content["trials"][::37]:
        job = RowJob("", 0, row["object"], row["completer"], row["view"], ScoreConfig(seed=content["settings"]["seed"]))
        assert job.episode_seed == row["episode_seed"]
    job = RowJob("", 0, row["object"], "mirror", row["view"], ScoreConfig(seed=1))
    assert job.episode_seed != row["episode_seed"]


class Task:
    """An episode whose trials end as they are told to, by the grasp's height and the world."""

    def __init__(self, held: dict[str, tuple[int, ...]], completion: Any = "completion", failure: str = "") -> None:
        self.held, self.asked = held, []
        self.drawn = SimpleNamespace(
            truth=SimpleNamespace(category="cup"),
            randomisation=SimpleNamespace(mass_kg=0.25, friction=0.6, grip_n=28.0),
            completion=None if completion is None else SimpleNamespace(mesh="completed mesh"),
            failure=failure,
            true_mesh=lambda: "true mesh",
        )

    def draw(self, rng, *, number):
        self.asked.append((float(rng.uniform()), number))
        return self.drawn

    def run_trial(self, grasp, *, world="true", margin_trials=0):
        self.asked.append((rounded(grasp), world, margin_trials) if margin_trials else (rounded(grasp), world))
        rank = round((grasp.T_world_gripper[2, 3] - 0.1) / 0.05)
        success = rank in self.held[world]
        least = (0.25 if success else np.inf) if margin_trials else None
        return Outcome(success, "held" if success else "unstable", 0.1 + rank, 0.002 + rank, success, {}, least)


def row_of(monkeypatch, task: Task, found=GRASPS, note="") -> tuple[ScoreRow, list]:
    """The row of JOB, and what was asked on the way."""
    asked: list = []

    def errors(mesh, truth, *, rng):
        asked.append((mesh, truth, float(rng.uniform())))
        return SimpleNamespace(cd_m=0.003, f_score=0.75)

    monkeypatch.setattr(score_rows, "task_of", lambda *which: (asked.append(which), task)[1])
    monkeypatch.setattr(score_rows, "best_grasps", lambda *which: (asked.append(which), (found, note))[1])
    monkeypatch.setattr(score_rows, "completion_errors", errors)
    monkeypatch.setattr(score_rows, "time", SteadyClock(0.5))
    return make_row(JOB), asked


def test_a_row_tells_the_best_grasp_in_both_worlds(monkeypatch):
    task = Task({"true": (0, 1), "completed": ()})
    row, asked = row_of(monkeypatch, task)
    assert row == ScoreRow(
        object="cup-7",
        category="cup",
        completer="gfs/top-down",
        view=1,
        episode_seed=JOB.episode_seed,
        success=True,
        reason="held",
        lift_m=0.1,
        slip_m=0.002,
        falls_free=True,
        least_friction=0.25,
        margin=pytest.approx(np.log2(1.6 / 0.25)),  # type: ignore[arg-type]
        mass_kg=0.25,
        friction=0.6,
        grip_n=28.0,
        completed_success=False,
        completed_reason="unstable",
        quality=0.9,
        width_m=0.04,
        cd_m=0.003,
        f_score=0.75,
        note="",
        rank_held=1,
        timings_s={"complete": 0.5, "plan": 0.5, "execute": 0.5},
    )
    draw = float(np.random.default_rng(JOB.episode_seed).uniform())
    assert asked == [
        ("cup", CONFIG, "gfs"),
        (task.drawn.completion, "gfs/top-down", 4, 3),
        ("completed mesh", "true mesh", draw),
    ]
    best = rounded(GRASPS[0])
    assert task.asked == [(draw, 7), (best, "true", 5), (best, "completed")]


@pytest.mark.parametrize(("held", "rank"), [((1, 3), 2), ((3,), 4), ((), None)])
def test_where_the_best_grasp_fails_the_next_ones_are_tried_until_one_holds(monkeypatch, held, rank):
    task = Task({"true": held, "completed": (0,)})
    row, _ = row_of(monkeypatch, task)
    assert (row.success, row.reason, row.rank_held) == (False, "unstable", rank)
    assert (row.completed_success, row.completed_reason) == (True, "held")
    assert (row.least_friction, row.margin) == (None, 0.0)
    tried = [which[:2] for which in task.asked[1:] if which[1] == "true"]
    assert tried == [(rounded(grasp), "true") for grasp in GRASPS[: rank or 4]]


def test_a_view_without_a_grasp_has_failed_and_says_why(monkeypatch):
    row, _ = row_of(monkeypatch, Task({"true": (), "completed": ()}), found=(), note="the planner found no grasp")
    nothing = {"success": False, "reason": "no_grasp_found", "lift_m": 0.0, "slip_m": 0.0, "falls_free": False}
    nothing |= {"completed_success": False, "completed_reason": "no_grasp_found", "quality": None, "width_m": None}
    assert nothing.items() <= asdict(row).items()
    assert (row.cd_m, row.rank_held, row.note) == (0.003, None, "the planner found no grasp")
    task = Task({"true": (), "completed": ()}, completion=None, failure="FitDiverged: no")
    row, asked = row_of(monkeypatch, task)
    assert nothing.items() <= asdict(row).items()
    assert (row.cd_m, row.f_score, row.note) == (None, None, "FitDiverged: no")
    assert asked == [("cup", CONFIG, "gfs")]


def test_a_lost_row_is_a_failure_of_the_same_view():
    row = lost_row(JOB, WorkerLost("it died"))
    assert row == ScoreRow(
        object="cup-7",
        category="",
        completer="gfs/top-down",
        view=1,
        episode_seed=JOB.episode_seed,
        success=False,
        reason="no_grasp_found",
        **dict.fromkeys(("lift_m", "slip_m", "mass_kg", "friction", "grip_n"), 0.0),
        falls_free=False,
        margin=0.0,
        completed_success=False,
        completed_reason="no_grasp_found",
        **dict.fromkeys(("quality", "width_m", "cd_m", "f_score"), None),  # type: ignore[arg-type]
        note="WorkerLost: it died",
        rank_held=None,
        timings_s={"complete": 0.0, "plan": 0.0, "execute": 0.0},
    )


def test_a_task_is_made_once_with_the_options_of_the_score(monkeypatch):
    made = []
    monkeypatch.setattr(score_rows, "GraspTask", lambda config, **how: (made.append((config, how)), object())[1])
    task_of.cache_clear()
    try:
        config = ScoreConfig(clutter=3, split="val", detector="mine", gps="")
        first = task_of("cup", config, "mirror")
        assert task_of("cup", config, "mirror") is first
        assert task_of("mug", config, "mirror") is not first
        assert task_of.cache_parameters()["maxsize"] == 16
    finally:
        task_of.cache_clear()
    env = EnvConfig(objects="cup", split="val", detector="mine", clutter=3, completer="mirror")
    assert made[0] == (env, {"num_kept": 4})


def test_grasps_are_the_best_few_of_the_methods_planner(monkeypatch):
    asked = []

    def planner(name):
        def plan(completion, num, *, seed):
            asked.append((name, completion, num, seed))
            return iter(GRASPS)

        return plan

    monkeypatch.setattr(score_rows, "get_planner", planner)
    completion: Any = "completion"
    assert best_grasps(completion, "gfs/top-down", 2, 5) == (GRASPS[:2], "")
    assert best_grasps(completion, "gfs", 9, 5) == (GRASPS, "")
    assert asked == [("top-down", "completion", 2, 5), ("antipodal", "completion", 9, 5)]
    monkeypatch.setattr(score_rows, "get_planner", lambda name: lambda *_, **__: ())
    assert best_grasps(completion, "gfs", 2, 5) == ((), "the planner found no grasp")
    far = Grasp(make_T(None, (9.0, 0, 0)), 0.05)
    monkeypatch.setattr(score_rows, "get_planner", lambda name: lambda *_, **__: (far,))
    found, note = best_grasps(completion, "gfs", 2, 5)
    assert (found, note.split(":")[0]) == ((), "InvalidAction")


@pytest.mark.parametrize("error", [ValueError, TypeError, KeyError, RuntimeError, AttributeError, AssertionError])
def test_a_mistake_of_a_users_planner_is_a_note_and_one_of_ours_is_an_error(monkeypatch, error):
    def plan(*_, **__):
        raise error("oh")

    monkeypatch.setattr(score_rows, "get_planner", lambda name: plan)
    completion: Any = "completion"
    note = best_grasps(completion, "gfs/mine:plan", 2, 5)[1]
    assert note.startswith(f"planner 'mine:plan' failed with {error.__name__}: ")
    with pytest.raises(error):
        best_grasps(completion, "gfs", 2, 5)


def test_a_grasp_is_rounded_as_a_step_of_the_environment_rounds_it():
    code, grasp = ActionCode(), Grasp(make_T(None, (0.1, 0.0123456789, 0.3)), 0.0487654321)
    step = score_rows.as_step(grasp)
    again = code.decode(code.encode(grasp))
    np.testing.assert_array_equal(step.T_world_gripper, again.T_world_gripper)
    assert step.width_m == again.width_m != grasp.width_m


@pytest.mark.parametrize(
    ("mass_kg", "found_by", "borne_n", "hindrance_found"),
    # twice 0.5 kg weigh 9.81 N
    [
        (0.5, 1, 9.9, ""),
        (0.5, 2, 9.9, ""),
        (0.5, 1, 9.7, "too_heavy"),
        (0.5, 3, 9.9, "no_grip"),
        (0.4, 1, 9.7, ""),
    ],
)
def test_an_object_can_be_carried_where_a_grasp_planned_on_all_of_it_bears_twice_its_weight(
    monkeypatch, mass_kg, found_by, borne_n, hindrance_found
):
    asked, weighed = [], []

    def plan(completion, num, *, config):
        asked.append((completion, num, config))
        return GRASPS[:2] if len(asked) == found_by else ()

    def bear(completion, grasps, *, friction, grip_n):
        weighed.append((completion, friction, grip_n))
        return np.array([np.nan, borne_n])[: len(grasps)]

    monkeypatch.setattr(score_rows, "plan_grasps", plan)
    monkeypatch.setattr(score_rows, "bearable_weight", bear)
    part = box_part([0, 0, 0], [0.1, 0.06, 0.02])
    parts = CollisionMesh((part,), (0.0, 0.0, 0.0), "hull", 0.0)
    truth = TrueObject("ell", "mug", l_shape(), parts, mass_kg, 0.5)
    assert hindrance(truth) == hindrance_found
    thorough = GraspConfig(num_rays=20_000, num_lines=2000, num_looks=16_000, num_poses=2400)
    tries = [(40, GraspConfig()), (40, thorough)]
    assert [(num, config) for _, num, config in asked] == (tries[:found_by] if hindrance_found == "" else tries)
    assert weighed[0] == (asked[0][0], pytest.approx(0.7), 30.0)
    completion = asked[0][0]
    assert completion.mesh is truth.mesh
    assert completion.collision is truth.collision
    detection = completion.detection
    np.testing.assert_array_equal(detection.cloud.points, truth.mesh.vertices)
    assert detection.up.tolist() == detection.support.normal.tolist() == [0.0, 0.0, 1.0]
    assert detection.support.height_m == 0.0
    np.testing.assert_allclose(detection.box.extents, [0.1, 0.06, 0.02])
