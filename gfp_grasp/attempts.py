"""One object, one view, one completer: its best grasp, on the true object and in its own world."""

from __future__ import annotations

import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import Any

import numpy as np

from gfp_grasp.complete import Completion
from gfp_grasp.envs.grasp_env import GfpGraspEnv
from gfp_grasp.errors import GfpGraspError, InvalidOption, WorkerLost
from gfp_grasp.grasps.planners import PLANNERS, planner
from gfp_grasp.metrics import CompletionErrors, completion_errors
from gfp_grasp.report import Trial, row_names
from gfp_grasp.types import Grasp

# What a planner of one's own may fail with at the cost of its own trials.
_OF_USERS = (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)


@dataclass(frozen=True)
class AttemptJob:
    """What an attempt is made of; picklable.

    Attributes:
        objects: As `scenes.load_objects` takes them.
        split: The same.
        number: Of the object among them.
        object_name: Its name.
        row: Name of the completer, and behind a slash the planner's, if it is not `antipodal`.
        view: Number of the view.
        seed: Of the whole score.
        clutter: So many other objects stand around it.
        grasps: So many of the best are attempted until one holds.
    """

    objects: str
    split: str
    number: int
    object_name: str
    row: str
    view: int
    seed: int
    clutter: int
    grasps: int

    @property
    def completer(self) -> str:
        """Its name, without the planner's."""
        return row_names(self.row)[0]

    @property
    def episode_seed(self) -> int:
        """The same for every completer, whatever else is scored."""
        entropy = [self.seed, zlib.crc32(self.object_name.encode()), self.view]
        return int(np.random.SeedSequence(entropy).generate_state(1)[0])


@lru_cache(maxsize=16)
def _env(objects: str, split: str, clutter: int, completer_name: str, world: str) -> GfpGraspEnv:
    """One environment a process and completer, so that scenes are compiled once."""
    env = GfpGraspEnv(objects=objects, split=split, clutter=clutter, completer=completer_name, world=world)
    env.kept_worlds = 1 + clutter  # a score goes object by object
    return env


def attempt(job: AttemptJob) -> Trial:
    """Make an attempt from its seeds: the same job gives the same trial, but for its timings."""
    started = time.perf_counter()
    env = _env(job.objects, job.split, job.clutter, job.completer, "true")
    _, info = env.reset(seed=job.episode_seed, options={"object": job.number})
    completed_at = time.perf_counter()
    found, note = (), str(info["completion_error"])
    if env.completion is not None:
        found, note = _best_grasps(env, env.completion, job)
    planned_at = time.perf_counter()
    grasp = found[0] if found else None
    true_info, completed_info = _in_both_worlds(env, job, grasp)
    rank_held = 1 if true_info["is_success"] else _first_held(env, found)
    executed_at = time.perf_counter()
    errors = _errors(env, job)
    return Trial(
        object=job.object_name,
        category=str(info["category"]),
        completer=job.row,
        view=job.view,
        episode_seed=job.episode_seed,
        success=bool(true_info["is_success"]),
        reason=str(true_info["reason"]),
        lift_m=float(true_info["lift_m"]),
        slip_m=float(true_info["slip_m"]),
        falls_free=bool(true_info["falls_free"]),
        mass_kg=float(info["mass_kg"]),
        friction=float(info["friction"]),
        grip_n=float(info["grip_n"]),
        completed_success=bool(completed_info["is_success"]),
        completed_reason=str(completed_info["reason"]),
        quality=None if grasp is None else grasp.quality,
        width_m=None if grasp is None else grasp.width_m,
        cd_m=None if errors is None else errors.cd_m,
        f_score=None if errors is None else errors.f_score,
        note=note,
        rank_held=rank_held,
        timings_s={
            "complete": completed_at - started,
            "plan": planned_at - completed_at,
            "execute": executed_at - planned_at,
        },
    )


def _best_grasps(env: GfpGraspEnv, completion: Completion, job: AttemptJob) -> tuple[tuple[Grasp, ...], str]:
    name = row_names(job.row)[1]
    try:
        found = tuple(islice(planner(name)(completion, job.grasps, seed=job.seed), job.grasps))
        for grasp in found:
            if not isinstance(grasp, Grasp):
                raise InvalidOption(
                    f"planner {name!r} gave a {type(grasp).__name__}; a gfp_grasp.types.Grasp is expected"
                )
            env.action_code.encode(grasp)
    except GfpGraspError as error:  # e.g. the completion could not be decomposed
        return (), f"{type(error).__name__}: {error}"
    except _OF_USERS as error:
        if name in PLANNERS:
            raise
        return (), f"planner {name!r} failed with {type(error).__name__}: {error}"  # the user's own, of one trial
    return found, "" if found else "the planner found no grasp"


def _first_held(env: GfpGraspEnv, grasps: Sequence[Grasp]) -> int | None:
    """Rank of the first grasp after the best that holds the true object."""
    for rank, grasp in enumerate(grasps[1:], start=2):
        if env.step(env.action_code.encode(grasp))[4]["is_success"]:
            return rank
    return None


def _in_both_worlds(
    env: GfpGraspEnv, job: AttemptJob, grasp: Grasp | None
) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Info of the attempt on the true object and on the completed one."""
    if grasp is None:
        nothing = {"is_success": False, "reason": "no_grasp_found", "lift_m": 0.0, "slip_m": 0.0, "falls_free": False}
        return nothing, nothing
    action = env.action_code.encode(grasp)
    true_info = env.step(action)[4]
    other = _env(job.objects, job.split, job.clutter, job.completer, "completed")
    other.reset(seed=job.episode_seed, options={"object": job.number, "completion": env.completion})
    return true_info, other.step(action)[4]


def _errors(env: GfpGraspEnv, job: AttemptJob) -> CompletionErrors | None:
    episode = env.episode
    if episode.completion is None:
        return None
    return completion_errors(episode.completion.mesh, episode.true_mesh(), rng=np.random.default_rng(job.episode_seed))


def lost_attempt(job: AttemptJob, error: WorkerLost) -> Trial:
    """A failed trial: the night's work goes on without it."""
    return Trial(
        object=job.object_name,
        category="",
        completer=job.row,
        view=job.view,
        episode_seed=job.episode_seed,
        success=False,
        reason="no_grasp_found",
        lift_m=0.0,
        slip_m=0.0,
        falls_free=False,
        mass_kg=0.0,
        friction=0.0,
        grip_n=0.0,
        completed_success=False,
        completed_reason="no_grasp_found",
        quality=None,
        width_m=None,
        cd_m=None,
        f_score=None,
        note=f"WorkerLost: {error}",
        timings_s={"complete": 0.0, "plan": 0.0, "execute": 0.0},
    )
