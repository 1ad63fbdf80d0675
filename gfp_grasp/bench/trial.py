"""Bench of the grasp trial itself: `gfp-grasp bench trial`.

Grasps planned on true objects are attempted at the simulator's time step and at half and a quarter of it: an outcome
that depends on the step is the simulator's, not the grasp's. Beside that, how fast held objects creep in the jaws, and
what the trial's own code and whole episodes cost.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np

from gfp_grasp.bench.views import procedural_classes
from gfp_grasp.envs import GfpGraspEnv, TrialSettings, run_trial
from gfp_grasp.envs.creep import creep_mps
from gfp_grasp.envs.pace import TimedStep, fetch_steps_per_s
from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.parallel import pmap
from gfp_grasp.scenes import World, label_of
from gfp_grasp.types import Grasp

_STEPS = (1, 2, 4)  # parts of the simulator's time step


def bench_trial(
    objects: str | None = None,
    *,
    limit: int = 24,
    grasps: int = 4,
    completer: str = "gfpnet",
    seed: int = 0,
    workers: int = 1,
    progress=None,
) -> dict[str, Any]:
    """How outcomes depend on the time step, and how fast attempts are.

    Args:
        objects: Families, or a folder of meshes.
        limit: Objects in all.
        grasps: Attempts on each, the best planned on the true mesh.
        completer: Of the whole episodes that are timed.
        seed: Of places and plans.
        workers: Processes; use 1 where the speed matters.
        progress: Wraps the stream of objects.

    Returns:
        {"settings", "attempts", "held": successes at each share of the step, "agreement": share of the attempts whose
        success at half the step is that at the whole one, and at a quarter that at half, "differing": those that do
        not, "creep_mm_per_s": median and largest speed of held objects in the jaws, over the objects' best grasps,
        "attempts_per_s" and "episodes_per_s" a core, of attempts alone and with the view, its completion and the plan
        before each (without an attempt where no grasp was found), "share_in_mj_step": of an attempt's time, median,
        "steps_per_s": physics steps a second of whole attempts, and of FetchPickAndPlace-v4 in the same run where
        gymnasium-robotics is installed, "trials": every attempt's}.
    """
    objects = objects or procedural_classes()
    if limit < 1 or grasps < 1:
        raise InvalidOption(f"limit is {limit} and grasps {grasps}; at least 1 of each is expected")
    env = GfpGraspEnv(objects=objects, completer="oracle", limit=limit)
    run = partial(_measured, objects=objects, limit=limit, grasps=grasps, completer=completer, seed=seed)
    done = list(pmap(run, range(len(env.sources)), workers=workers, progress=progress))
    found = [trial for one in done for trial in one["trials"]]
    creeps = [one["creep_mps"] for one in done if one["creep_mps"] is not None]
    held = np.array([t["held"] for t in found], dtype=bool).reshape(-1, len(_STEPS))
    same = held[:, 1:] == held[:, :-1]
    return {
        "settings": {
            "objects": label_of(objects),
            "num_objects": len(env.sources),
            "grasps": grasps,
            "completer": completer,
            "seed": seed,
        },
        "attempts": len(found),
        "held": {f"1/{part}": int(count) for part, count in zip(_STEPS, held.sum(axis=0), strict=True)},
        "agreement": [round(float(share), 4) for share in same.mean(axis=0)] if len(found) else None,
        "differing": [t for t, agree in zip(found, same.all(axis=1), strict=True) if not agree],
        "creep_mm_per_s": [round(1e3 * float(np.quantile(creeps, q)), 4) for q in (0.5, 1.0)] if creeps else None,
        "attempts_per_s": round(len(found) / max(sum(t["seconds"] for t in found), 1e-9), 2),
        "episodes_per_s": round(len(done) / max(sum(one["episode_s"] for one in done), 1e-9), 2),
        "share_in_mj_step": round(float(np.median([t["share"] for t in found])), 4) if found else None,
        "steps_per_s": {
            "GfpGrasp-v0": round(sum(t["steps"] for t in found) / max(sum(t["seconds"] for t in found), 1e-9), 1),
            "FetchPickAndPlace-v4": fetch_steps_per_s(),
        },
        "trials": found,
    }


def _measured(number: int, *, objects: str, limit: int, grasps: int, completer: str, seed: int) -> dict[str, Any]:
    env = GfpGraspEnv(objects=objects, completer="oracle", limit=limit)
    env.reset(seed=seed + number, options={"object": number})
    found: dict[str, Any] = {"trials": [], "creep_mps": None}
    if env.completion is not None and env.world is not None:
        planned = plan_grasps(env.completion, grasps, seed=seed)
        found["trials"] = [
            {"object": env.episode.truth.name, "grasp": rank, **_at_all_steps(env.world, grasp, env.trial_settings)}
            for rank, grasp in enumerate(planned)
        ]
        if planned:
            found["creep_mps"] = creep_mps(env.world, planned[0], env.trial_settings)
    return found | {"episode_s": _episode_s(number, objects, limit, completer, seed)}


def _episode_s(number: int, objects: str, limit: int, completer: str, seed: int) -> float:
    """Seconds of the second episode with an object: weights are read and its scene is compiled in the first."""
    env = GfpGraspEnv(objects=objects, completer=completer, limit=limit)
    env.reset(seed=seed + number, options={"object": number})
    start = time.perf_counter()
    env.reset(options={"object": number})
    planned = [] if env.completion is None else plan_grasps(env.completion, 1, seed=seed)
    if planned:
        env.step(env.action_code.encode(planned[0]))
    return time.perf_counter() - start


def _at_all_steps(world: World, grasp: Grasp, settings: TrialSettings) -> dict[str, Any]:
    whole = world.model.opt.timestep
    held, reasons, seconds, share, steps = [], [], 0.0, 0.0, 0
    for part in _STEPS:
        world.model.opt.timestep = whole / part
        timer = TimedStep()
        start = time.perf_counter()
        outcome = run_trial(world, grasp, settings, stepper=timer)
        if part == 1:
            seconds = time.perf_counter() - start
            share, steps = timer.seconds / seconds, timer.steps
        held.append(outcome.success)
        reasons.append(outcome.reason)
    world.model.opt.timestep = whole
    return {"held": held, "reasons": reasons, "seconds": round(seconds, 4), "share": round(share, 4), "steps": steps}
