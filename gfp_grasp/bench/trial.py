"""Bench of the grasp trial itself: `gfp-grasp bench trial`.

Grasps planned on true objects are tried at the simulator's time step and at half and a quarter of it: an outcome that
depends on the step is the simulator's, not the grasp's. Beside that, how fast held objects creep in the jaws, and what
the trial's own code and whole episodes cost.
"""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import importlib.util
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from gfp_grasp.bench.rows import Row
from gfp_grasp.envs import EnvConfig, GraspTask, TrialSettings, run_trial
from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.parallel import pmap
from gfp_grasp.scenes import TARGET, Handles, World, label_of
from gfp_grasp.transforms import invert_T
from gfp_grasp.types import Grasp

_STEPS = (1, 2, 4)  # parts of the simulator's time step
_SETTLES_S = 1.0  # from the end of the lift on, before creep is measured


@dataclass(frozen=True, kw_only=True)
class TrialRow(Row):
    """One grasp on one object, tried at each time step.

    Attributes:
        object: Name of the object.
        grasp: Rank of the grasp, 0 is the best.
        held: Success at each share of the time step.
        reasons: Reason for which each trial ended.
        seconds: Time of the trial at the whole step, s.
        share: Share of that time that MuJoCo's own step took.
        steps: Number of steps of that trial.
    """

    object: str
    grasp: int
    held: tuple[bool, ...]
    reasons: tuple[str, ...]
    seconds: float
    share: float
    steps: int


@dataclass(frozen=True)
class _Measured:
    """All that is measured on one object.

    Attributes:
        rows: One row for each grasp.
        creep_mps: Creep of the best grasp; None where it was not held.
        episode_s: Time of a whole episode, s.
    """

    rows: tuple[TrialRow, ...]
    creep_mps: float | None
    episode_s: float


def bench_trial(
    objects: str = "all",
    *,
    limit: int = 24,
    grasps: int = 4,
    completer: str = "gfpnet",
    seed: int = 0,
    workers: int = 1,
    progress=None,
) -> dict[str, Any]:
    """How outcomes depend on the time step, and how fast trials are.

    Args:
        objects: Procedural families with commas between or "all", or a folder of meshes.
        limit: Most objects in all.
        grasps: Number of grasps on each object, the best planned on the true mesh.
        completer: Name of the completer in the whole episodes that are timed.
        seed: Seed of places and plans.
        workers: Number of processes; use 1 where the speed matters.
        progress: Wraps the stream of objects.

    Returns:
        {"settings", "attempts": number of grasps that were tried, "held": successes at each share of the step,
        "agreement": share of the grasps whose success at half the step is that at the whole one, and at a quarter that
        at half, "differing": the grasps for which it is not, "creep_mm_per_s": median and largest speed of held objects
        in the jaws, over the objects' best grasps, "attempts_per_s" and "episodes_per_s" a core, for trials alone and
        with the view, its completion and the plan before each (without a trial where no grasp was found),
        "share_in_mj_step": of a trial's time, median, "steps_per_s": physics steps a second in whole trials, and of the
        scene of FetchPickAndPlace-v4 in the same run where gymnasium-robotics is installed, "trials": every
        `TrialRow`}.
    """
    if limit < 1 or grasps < 1:
        raise InvalidOption(f"limit is {limit} and grasps {grasps}; at least 1 of each is expected")
    num_objects = len(_task(objects, limit, "oracle").sources)
    run = partial(_measure_object, objects=objects, limit=limit, grasps=grasps, completer=completer, seed=seed)
    done = list(pmap(run, range(num_objects), workers=workers, progress=progress))
    rows = [row for one in done for row in one.rows]
    creeps = [one.creep_mps for one in done if one.creep_mps is not None]
    held = np.array([row.held for row in rows], dtype=bool).reshape(-1, len(_STEPS))
    same = held[:, 1:] == held[:, :-1]
    seconds = max(sum(row.seconds for row in rows), 1e-9)
    return {
        "settings": {
            "objects": label_of(objects),
            "num_objects": num_objects,
            "grasps": grasps,
            "completer": completer,
            "seed": seed,
        },
        "attempts": len(rows),
        "held": {f"1/{part}": int(count) for part, count in zip(_STEPS, held.sum(axis=0), strict=True)},
        "agreement": [round(float(share), 4) for share in same.mean(axis=0)] if rows else None,
        "differing": [row.to_json() for row, agree in zip(rows, same.all(axis=1), strict=True) if not agree],
        "creep_mm_per_s": [round(1e3 * float(np.quantile(creeps, q)), 4) for q in (0.5, 1.0)] if creeps else None,
        "attempts_per_s": round(len(rows) / seconds, 2),
        "episodes_per_s": round(len(done) / max(sum(one.episode_s for one in done), 1e-9), 2),
        "share_in_mj_step": round(float(np.median([row.share for row in rows])), 4) if rows else None,
        "steps_per_s": {
            "GfpGrasp-v0": round(sum(row.steps for row in rows) / seconds, 1),
            "FetchPickAndPlace-v4": fetch_steps_per_s(),
        },
        "trials": [row.to_json() for row in rows],
    }


def _task(objects: str, limit: int, completer: str) -> GraspTask:
    return GraspTask(EnvConfig(objects=objects, completer=completer, limit=limit))


def _measure_object(number: int, *, objects: str, limit: int, grasps: int, completer: str, seed: int) -> _Measured:
    task = _task(objects, limit, "oracle")
    episode, world = task.draw(np.random.default_rng(seed + number), number=number), task.world()
    planned = () if episode.completion is None else plan_grasps(episode.completion, grasps, seed=seed)
    rows, creep = (), None
    if planned and world is not None:
        name = episode.truth.name
        rows = tuple(_at_all_steps(world, task.trial_settings, grasp, name, rank) for rank, grasp in enumerate(planned))
        creep = creep_mps(world, planned[0], task.trial_settings)
    return _Measured(rows, creep, _episode_s(number, objects, limit, completer, seed))


def _episode_s(number: int, objects: str, limit: int, completer: str, seed: int) -> float:
    """Seconds of the second episode with an object: weights are read and its scene is compiled in the first."""
    task, rng = _task(objects, limit, completer), np.random.default_rng(seed + number)
    task.draw(rng, number=number)
    start = time.perf_counter()
    completion = task.draw(rng, number=number).completion
    planned = () if completion is None else plan_grasps(completion, 1, seed=seed)
    if planned:
        task.run_trial(planned[0])
    return time.perf_counter() - start


def _at_all_steps(world: World, settings: TrialSettings, grasp: Grasp, name: str, rank: int) -> TrialRow:
    whole = world.model.opt.timestep
    outcomes, seconds, timers = [], [], []
    for part in _STEPS:
        world.model.opt.timestep = whole / part
        timers.append(_TimedStep())
        start = time.perf_counter()
        outcomes.append(run_trial(world, grasp, settings, stepper=timers[-1]))
        seconds.append(time.perf_counter() - start)
    world.model.opt.timestep = whole
    return TrialRow(
        object=name,
        grasp=rank,
        held=tuple(outcome.success for outcome in outcomes),
        reasons=tuple(outcome.reason for outcome in outcomes),
        seconds=round(seconds[0], 4),
        share=round(timers[0].seconds / seconds[0], 4),
        steps=timers[0].steps,
    )


class _TimedStep:
    """MuJoCo's own step that counts its calls and adds up their time."""

    def __init__(self) -> None:
        self.seconds, self.steps = 0.0, 0

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        start = time.perf_counter()
        mujoco.mj_step(model, data)
        self.seconds += time.perf_counter() - start
        self.steps += 1


def creep_mps(world: World, grasp: Grasp, settings: TrialSettings, *, seconds: float = 3.0) -> float | None:
    """Speed of the object in the gripper while it hangs there at rest, from one second after the lift on.

    Args:
        world: Scene with the object at rest, which is restored first.
        grasp: Grasp in the world's frame.
        settings: Numbers of the trial; its hold is made longer.
        seconds: Time over which the speed is taken, s.

    Returns:
        m/s, of the object's point at the gripper's origin, as slip is measured; None where the trial ended before.

    Raises:
        InvalidOption: seconds is not a positive number.
    """
    if not 0 < seconds < float("inf"):
        raise InvalidOption(f"seconds is {seconds}; a positive finite number is expected")
    handles = Handles.of(world, TARGET)
    poses: list[np.ndarray] = []

    def note(_: mujoco.MjData) -> None:
        poses.append(invert_T(handles.T_world_gripper) @ handles.T_world_target)

    held = replace(settings, hold_s=_SETTLES_S + seconds)
    run_trial(world, grasp, held, on_step=note)
    # The trial lasts a whole number of commands; the last of them at rest is that at the end of the hold.
    phases = (held.approach_s, held.close_s, held.lift_s, held.hold_s)
    last = sum(max(1, round(phase / held.control_s)) for phase in phases) - 1
    first = last - max(1, round(seconds / held.control_s))
    if last >= len(poses):
        return None
    moved = (poses[last] @ invert_T(poses[first]))[:3, 3]
    command_s = max(1, round(held.control_s / world.model.opt.timestep)) * world.model.opt.timestep
    return float(np.linalg.norm(moved) / ((last - first) * command_s))


def fetch_steps_per_s(*, seconds: float = 3.0) -> float | None:
    """Steps a second of MuJoCo in the scene of FetchPickAndPlace-v4 at rest; None without gymnasium-robotics."""
    package = importlib.util.find_spec("gymnasium_robotics")
    if package is None or package.origin is None:
        return None
    scene = Path(package.origin).parent / "envs" / "assets" / "fetch" / "pick_and_place.xml"
    model = mujoco.MjModel.from_xml_path(str(scene))
    data = mujoco.MjData(model)
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        mujoco.mj_step(model, data, 100)
        steps += 100
    return round(steps / (time.perf_counter() - start), 1)
