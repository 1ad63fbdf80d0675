"""The bench of the trial, with trials whose outcomes, times and creep are known."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from clocks import SteadyClock

from gfp_grasp.bench import bench_trial, trial
from gfp_grasp.bench.trial import TrialRow, creep_mps, fetch_steps_per_s
from gfp_grasp.envs import TrialSettings
from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes import TARGET
from gfp_grasp.shapes import HOUSEHOLD
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Grasp, Outcome

GRASPS = tuple(Grasp(make_T(None, (0, 0, 0.1 * rank)), 0.05) for rank in range(3))


def row(name: str, grasp: int, held: tuple[bool, ...], seconds: float = 0.25, share: float = 0.5) -> TrialRow:
    return TrialRow(object=name, grasp=grasp, held=held, reasons=("held",) * 3, seconds=seconds, share=share, steps=100)


def measured(monkeypatch, *objects: Any) -> list:
    """What was measured on each object; the jobs that were asked for."""
    asked = []

    def measure(number, **how):
        asked.append((number, how))
        return objects[number]

    monkeypatch.setattr(trial, "_task", lambda *which: (asked.append(which), SimpleNamespace(sources=objects))[1])
    monkeypatch.setattr(trial, "_measure_object", measure)
    monkeypatch.setattr(trial, "fetch_steps_per_s", lambda: 1234.5)
    return asked


def test_outcomes_are_compared_from_step_to_step(monkeypatch):
    rows = (
        row("a", 0, (True, True, True), share=0.9),
        row("a", 1, (True, True, False), seconds=0.5, share=0.7),
        row("b", 0, (False, True, True), share=0.8),
        row("b", 1, (False, False, False), share=0.4),
    )
    asked = measured(
        monkeypatch,
        trial._Measured(rows[:2], 0.001, 1.0),
        trial._Measured(rows[2:], 0.003, 2.0),
        trial._Measured((), None, 1.0),
    )
    report = bench_trial("cup,mug", limit=5, grasps=2, completer="mirror", seed=6)
    assert report == {
        "settings": {"objects": "cup,mug", "num_objects": 3, "grasps": 2, "completer": "mirror", "seed": 6},
        "attempts": 4,
        "held": {"1/1": 2, "1/2": 3, "1/4": 2},
        "agreement": [0.75, 0.75],
        "differing": [rows[1].to_json(), rows[2].to_json()],
        "creep_mm_per_s": [2.0, 3.0],
        "attempts_per_s": 3.2,
        "episodes_per_s": 0.75,
        "share_in_mj_step": 0.75,
        "steps_per_s": {"GfpGrasp-v0": 320.0, "FetchPickAndPlace-v4": 1234.5},
        "trials": [r.to_json() for r in rows],
    }
    how = {"objects": "cup,mug", "limit": 5, "grasps": 2, "completer": "mirror", "seed": 6}
    assert asked == [("cup,mug", 5, "oracle"), (0, how), (1, how), (2, how)]


def test_objects_without_a_grasp_give_counts_alone(monkeypatch):
    measured(monkeypatch, trial._Measured((), None, 0.5))
    report = bench_trial("all")
    assert report["settings"]["objects"] == ",".join(HOUSEHOLD)
    assert (report["attempts"], report["held"], report["agreement"]) == (0, {"1/1": 0, "1/2": 0, "1/4": 0}, None)
    assert (report["creep_mm_per_s"], report["share_in_mj_step"], report["differing"]) == (None, None, [])
    assert (report["attempts_per_s"], report["episodes_per_s"]) == (0.0, 2.0)


class World:
    """A scene of which the bench reads and sets the time step."""

    def __init__(self) -> None:
        self.model = SimpleNamespace(opt=SimpleNamespace(timestep=0.002))


def test_each_trial_runs_at_the_whole_step_at_half_and_at_a_quarter_of_it(monkeypatch):
    world, asked = World(), []

    def run(scene, grasp, settings, *, stepper):
        asked.append((scene, grasp, settings, scene.model.opt.timestep))
        stepper.seconds, stepper.steps = 0.75 * len(asked), 10 * len(asked)
        success = len(asked) != 2
        return Outcome(success, "held" if success else "unstable", 0.2, 0.0)

    monkeypatch.setattr(trial, "run_trial", run)
    monkeypatch.setattr(trial, "time", SteadyClock(1.5))
    settings: Any = object()
    found = trial._at_all_steps(world, settings, GRASPS[2], "jug", 2)  # type: ignore[arg-type]
    assert found == TrialRow(
        object="jug",
        grasp=2,
        held=(True, False, True),
        reasons=("held", "unstable", "held"),
        seconds=1.5,
        share=0.5,
        steps=10,
    )
    assert asked == [(world, GRASPS[2], settings, step) for step in (0.002, 0.001, 0.0005)]
    assert world.model.opt.timestep == 0.002


def test_a_stepper_counts_its_calls_and_their_time(monkeypatch):
    called = []
    monkeypatch.setattr(trial, "mujoco", SimpleNamespace(mj_step=lambda *which: called.append(which)))
    monkeypatch.setattr(trial, "time", SteadyClock(0.25))
    stepper = trial._TimedStep()
    assert (stepper.seconds, stepper.steps) == (0.0, 0)
    for _ in range(3):
        stepper("model", "data")  # type: ignore[arg-type]
    assert called == [("model", "data")] * 3
    assert (stepper.seconds, stepper.steps) == (0.75, 3)


class Task:
    """Draws the same episode again and again, and notes what is asked of it."""

    def __init__(self, *which: Any, completion: Any = "completed", world: Any = "world") -> None:
        self.which, self.asked = which, []
        self.trial_settings = TrialSettings(grip_n=20.0)
        self._completion, self._world = completion, world

    def draw(self, rng, *, number):
        self.asked.append((float(rng.uniform()), number))
        return SimpleNamespace(completion=self._completion, truth=SimpleNamespace(name="jug"))

    def world(self):
        return self._world

    def run_trial(self, grasp):
        self.asked.append(grasp)


def draw_of(seed: int, count: int) -> list[float]:
    return np.random.default_rng(seed).uniform(size=count).tolist()


def test_an_object_is_measured_with_its_best_grasps_in_the_true_scene(monkeypatch):
    tasks, planned, tried, crept, timed = [], [], [], [], []

    def task(*which):
        tasks.append(Task(*which))
        return tasks[-1]

    def plan(completion, num, *, seed):
        planned.append((completion, num, seed))
        return GRASPS

    def at_all(world, settings, grasp, name, rank):
        tried.append((world, settings, grasp, name, rank))
        return row(name, rank, (True, True, True))

    monkeypatch.setattr(trial, "_task", task)
    monkeypatch.setattr(trial, "plan_grasps", plan)
    monkeypatch.setattr(trial, "_at_all_steps", at_all)
    monkeypatch.setattr(trial, "creep_mps", lambda *which: (crept.append(which), 0.002)[1])
    monkeypatch.setattr(trial, "_episode_s", lambda *which: (timed.append(which), 7.0)[1])
    found = trial._measure_object(4, objects="cup", limit=9, grasps=3, completer="gfs", seed=30)
    assert found == trial._Measured(tuple(row("jug", rank, (True, True, True)) for rank in range(3)), 0.002, 7.0)
    (one,) = tasks
    assert one.which == ("cup", 9, "oracle")
    assert one.asked == [(draw_of(34, 1)[0], 4)]
    assert planned == [("completed", 3, 30)]
    assert tried == [("world", one.trial_settings, GRASPS[rank], "jug", rank) for rank in range(3)]
    assert crept == [("world", GRASPS[0], one.trial_settings)]
    assert timed == [(4, "cup", 9, "gfs", 30)]


@pytest.mark.parametrize(("completion", "world"), [(None, "world"), ("completed", None)])
def test_an_object_without_a_completion_or_a_scene_has_no_rows(monkeypatch, completion, world):
    monkeypatch.setattr(trial, "_task", lambda *which: Task(*which, completion=completion, world=world))
    monkeypatch.setattr(trial, "plan_grasps", lambda *_, **__: GRASPS)
    monkeypatch.setattr(trial, "_episode_s", lambda *which: 7.0)
    assert trial._measure_object(0, objects="cup", limit=1, grasps=3, completer="gfs", seed=0) == trial._Measured(
        (), None, 7.0
    )


@pytest.mark.parametrize(("completion", "tried"), [("completed", [GRASPS[0]]), (None, [])])
def test_the_second_episode_is_timed_with_its_plan_and_its_trial(monkeypatch, completion, tried):
    tasks = []

    def task(*which):
        tasks.append(Task(*which, completion=completion))
        return tasks[-1]

    planned = []
    monkeypatch.setattr(trial, "_task", task)
    monkeypatch.setattr(trial, "plan_grasps", lambda *which, seed: (planned.append((*which, seed)), GRASPS)[1])
    monkeypatch.setattr(trial, "time", SteadyClock(0.5))
    assert trial._episode_s(4, "cup", 9, "gfs", 30) == 0.5
    (one,) = tasks
    assert one.which == ("cup", 9, "gfs")
    assert one.asked == [*((draw, 4) for draw in draw_of(34, 2)), *tried]
    assert planned == [("completed", 1, 30)] * len(tried)


def test_a_task_is_of_the_objects_limit_and_completer(monkeypatch):
    monkeypatch.setattr(trial, "GraspTask", lambda config: config)
    config: Any = trial._task("cup", 3, "mirror")
    assert (config.objects, config.limit, config.completer) == ("cup", 3, "mirror")


class Hanging:
    """Handles of a scene in which the object moves 10 micrometres down in the gripper at each command."""

    def __init__(self) -> None:
        self.command = 0

    @property
    def T_world_gripper(self) -> np.ndarray:
        return make_T(None, (0.0, 0.3, 0.01 * self.command))

    @property
    def T_world_target(self) -> np.ndarray:
        return make_T(None, (0.0, 0.3, 0.01 * self.command - 1e-5 * self.command))


def creep(monkeypatch, *, commands: int, settings: TrialSettings, timestep: float = 0.002, **how: float):
    """Creep over a trial that lasts so many commands, and the settings of the trial."""
    hanging, world, asked = Hanging(), World(), []
    world.model.opt.timestep = timestep

    def handles(scene, target):
        assert (scene, target) == (world, TARGET)
        return hanging

    def run(scene, grasp, held, *, on_step):
        asked.append(held)
        assert (scene, grasp) == (world, GRASPS[0])
        for hanging.command in range(commands):
            on_step(None)

    monkeypatch.setattr(trial, "Handles", SimpleNamespace(of=handles))
    monkeypatch.setattr(trial, "run_trial", run)
    return creep_mps(world, GRASPS[0], settings, **how), asked[0]  # type: ignore[arg-type]


SETTINGS = TrialSettings(approach_s=0.5, close_s=0.3, lift_s=0.7, control_s=0.01)
AT_REST = 50 + 30 + 70 + 100 + 300  # commands until the end of a hold of 1 + 3 s


def test_creep_is_the_speed_in_the_gripper_over_the_last_seconds_of_a_long_hold(monkeypatch):
    speed, held = creep(monkeypatch, commands=AT_REST, settings=SETTINGS)
    assert speed == pytest.approx(1e-3)
    assert held == replace(SETTINGS, hold_s=4.0)
    speed, held = creep(monkeypatch, commands=AT_REST - 200, settings=SETTINGS, seconds=1.0)
    assert (speed, held.hold_s) == (pytest.approx(1e-3), 2.0)


def test_a_command_lasts_a_whole_number_of_time_steps(monkeypatch):
    speed, _ = creep(monkeypatch, commands=AT_REST, settings=SETTINGS, timestep=0.004)  # 0.01 s are two of 0.004 s
    assert speed == pytest.approx(1e-5 / 0.008)
    speed, _ = creep(monkeypatch, commands=AT_REST, settings=SETTINGS, timestep=0.05)
    assert speed == pytest.approx(1e-5 / 0.05)


def test_an_object_that_was_lost_before_the_end_of_the_hold_has_no_creep(monkeypatch):
    assert creep(monkeypatch, commands=AT_REST - 1, settings=SETTINGS)[0] is None


def test_the_beginning_and_the_end_of_the_hold_are_what_is_compared(monkeypatch):
    """An object that lies still but for the last 3 s has crept over all of these and over nothing before."""
    monkeypatch.setattr(Hanging, "T_world_target", property(lambda self: make_T(None, (0.0, 0.3, moved(self.command)))))

    def moved(command: int) -> float:
        return 0.01 * command - 1e-5 * min(max(command, AT_REST - 301), AT_REST - 1)

    assert creep(monkeypatch, commands=AT_REST + 50, settings=SETTINGS)[0] == pytest.approx(1e-3)


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("inf"), float("nan")])
def test_creep_over_no_time_is_refused(seconds):
    with pytest.raises(InvalidOption, match="positive finite"):
        creep_mps(None, GRASPS[0], SETTINGS, seconds=seconds)  # type: ignore[arg-type]


def test_the_scene_beside_it_is_stepped_for_three_seconds(monkeypatch, tmp_path):
    origin = tmp_path / "gymnasium_robotics" / "__init__.py"
    stepped, read = [], []
    fake = SimpleNamespace(
        MjModel=SimpleNamespace(from_xml_path=lambda path: (read.append(path), "model")[1]),
        MjData=lambda model: f"data of {model}",
        mj_step=lambda *which: stepped.append(which),
    )
    found = SimpleNamespace(origin=str(origin))
    monkeypatch.setattr(trial.importlib.util, "find_spec", lambda name: found if name == "gymnasium_robotics" else None)
    monkeypatch.setattr(trial, "mujoco", fake)
    monkeypatch.setattr(trial, "time", SteadyClock(0.5))
    assert fetch_steps_per_s() == round(500 / 3.5, 1)
    assert stepped == [("model", "data of model", 100)] * 5
    assert read == [str(origin.parent / "envs" / "assets" / "fetch" / "pick_and_place.xml")]
    monkeypatch.setattr(trial.importlib.util, "find_spec", lambda name: None)
    assert fetch_steps_per_s() is None
    monkeypatch.setattr(trial.importlib.util, "find_spec", lambda name: SimpleNamespace(origin=None))
    assert fetch_steps_per_s() is None
