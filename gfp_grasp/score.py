"""What completions are worth: the success of the grasps planned on them, on the true objects and in their own world."""

from __future__ import annotations

import functools
import time
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from gfp_grasp import __version__
from gfp_grasp.complete import Completion
from gfp_grasp.completers import completer
from gfp_grasp.envs.grasp_env import GfpGraspEnv
from gfp_grasp.envs.settings import TrialSettings
from gfp_grasp.errors import GfpGraspError, InvalidMesh, InvalidOption, WorkerLost
from gfp_grasp.grasps.planners import PLANNERS, planner
from gfp_grasp.journal import Journal
from gfp_grasp.metrics import CompletionErrors, completion_errors
from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import list_primitives
from gfp_grasp.report import Report, Trial
from gfp_grasp.scenes import ObjectSource, load_objects
from gfp_grasp.types import Grasp

ALL_CLASSES = "*"
# What a planner of one's own may fail with at the cost of its own trials.
_OF_USERS = (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
BRACKETED = ("observed", "observed/top-down", "mirror", "gfs", "registration", "gfpnet-paper", "gfpnet", "oracle")
Progress = Callable[[Iterable[Trial], int], Iterable[Trial]]


def score(
    objects: str | Path,
    completers: Sequence[str] = BRACKETED,
    *,
    views: int = 4,
    grasps: int = 5,
    seed: int = 0,
    split: str = "test",
    limit: int | None = None,
    classes: Sequence[str] | None = None,
    workers: int = 1,
    ray: str | None = None,
    journal: str | Path | None = None,
    progress: Progress | None = None,
) -> Report:
    """Score completers by their grasps.

    Every completer meets the same objects in the same poses, views and sensor noise. On each completion the best
    planned grasp is attempted by `GfpGraspEnv.step`, once on the true object and once with the completion's convex
    parts simulated in its place. No completion, or no grasp on it, is a failed attempt (`no_grasp_found`). Where the
    best grasp fails on the true object, the next ones are attempted, each on the scene as it was.

    Args:
        objects: Families ("cup,mug"), a mesh file, or a folder of `<class>__<name>.<suffix>`.
        completers: Names, see `gfp_grasp.completers.completer`; behind a slash the planner's, see
            `gfp_grasp.grasps.planner`, if it is not `antipodal`, as in "gfpnet/top-down".
        views: Views of each object.
        grasps: So many of the best are attempted until one holds; the first alone is the score.
        seed: Of poses, views, noise and planning.
        split: Which seeds of a family.
        limit: At most so many objects.
        classes: Keep objects of these classes; None keeps those that have a primitive and those whose class is not
            known, ("*",) keeps all.
        workers: Processes; the result does not depend on it.
        ray: Address of a Ray cluster to run on, or "auto"; the result is the same.
        journal: File that trials are written to as they come. Those that it holds of a run that was stopped are kept,
            and the file stays: it is the caller's to remove once the report is written.
        progress: Wraps the stream of trials, told how many there will be.

    Raises:
        UnknownCompleter: A name that is not on offer.
        InvalidOption: Objects that are not there, no object of these classes, views or grasps below one, or an unknown
            planner.
        CannotWrite: The journal; what was written before is kept.
        InvalidMesh: Files of which no object can be made; all of them are named, before anything is scored.
    """
    for count, what in ((views, "views"), (grasps, "grasps"), (1 if limit is None else limit, "limit")):
        if count < 1:
            raise InvalidOption(f"{what} is {count}; at least 1 is expected")
    if not completers or len(set(completers)) < len(completers):
        raise InvalidOption(f"completers are {tuple(completers)}; at least one is expected, and each but once")
    for row in completers:
        name, planner_name = _names(row)
        completer(name)
        planner(planner_name)
    kept = _chosen(objects, split, classes, limit)
    jobs = [
        _Job(str(objects), split, number, source_name, row, view, seed, grasps)
        for number, source_name in kept
        for view in range(views)
        for row in completers
    ]
    settings = {
        "objects": _label(objects),
        "split": split,
        "num_objects": len(kept),
        "classes": sorted(_classes(classes)),
        "completers": list(completers),
        "views": int(views),
        "grasps": int(grasps),
        "seed": int(seed),
        "trial": asdict(TrialSettings()),
    }
    return Report(settings, _trials(jobs, settings, journal, workers=workers, ray=ray, progress=progress))


@dataclass(frozen=True)
class _Job:
    """One object, one view, one completer."""

    objects: str
    split: str
    number: int
    object_name: str
    row: str
    view: int
    seed: int
    grasps: int

    @property
    def completer(self) -> str:
        """Its name, without the planner's."""
        return _names(self.row)[0]

    @property
    def episode_seed(self) -> int:
        """The same for every completer, whatever else is scored."""
        entropy = [self.seed, zlib.crc32(self.object_name.encode()), self.view]
        return int(np.random.SeedSequence(entropy).generate_state(1)[0])


def _trials(
    jobs: Sequence[_Job], settings: Mapping[str, object], path: str | Path | None, **how: Any
) -> tuple[Trial, ...]:
    """Of all jobs, but those that the journal holds are not made again."""
    if path is None:
        return tuple(pmap(_attempt, jobs, lost=_lost, **how))
    journal = Journal(path, {"version": __version__, **settings})
    trials = {(t.object, t.view, t.completer): t for t in (Trial(**record) for record in journal.records)}
    left = [job for job in jobs if (job.object_name, job.view, job.row) not in trials]
    for trial in pmap(_attempt, left, lost=_lost, keep=lambda _, trial: journal.add(asdict(trial)), **how):
        trials[trial.object, trial.view, trial.completer] = trial
    return tuple(trials[job.object_name, job.view, job.row] for job in jobs)


def _lost(job: _Job, error: WorkerLost) -> Trial:
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


def _names(row: str) -> tuple[str, str]:
    """Of the completer and the planner of a row."""
    name, _, planner_name = row.partition("/")
    return name, planner_name or "antipodal"


def _chosen(objects: str | Path, split: str, classes: Sequence[str] | None, limit: int | None) -> list[tuple[int, str]]:
    """Number and name of the objects that are scored."""
    sources = load_objects(objects, split)
    wanted = _classes(classes)
    kept = [(i, s.name) for i, s in enumerate(sources) if ALL_CLASSES in wanted or s.category in wanted]
    if not kept:
        found = ", ".join(sorted({source.category for source in sources}))
        raise InvalidOption(f"no object is of class {', '.join(sorted(wanted))}; there are: {found}")
    kept = kept[:limit]
    _refuse_broken([sources[i] for i, _ in kept])
    return kept


def _refuse_broken(sources: Sequence[ObjectSource]) -> None:
    """Now, not in the middle of a night's work."""
    broken = []
    for source in sources:
        if source.path is None:
            continue
        try:
            source.load_mesh()
        except GfpGraspError as error:
            broken.append(f"{source.path.name} ({error})")
    if broken:
        raise InvalidMesh(
            f"{len(broken)} of {len(sources)} files cannot be scored, repair them or take them out: {'; '.join(broken)}"
        )


def _classes(classes: Sequence[str] | None) -> set[str]:
    return {*list_primitives(), ""} if classes is None else set(classes)


def _label(objects: str | Path) -> str:
    """Families as they are, files and folders by their own name: results never hold a path."""
    return Path(objects).resolve().name if Path(objects).exists() else str(objects)


@functools.lru_cache(maxsize=16)
def _env(objects: str, split: str, completer_name: str, world: str) -> GfpGraspEnv:
    """One environment a process and completer, so that scenes are compiled once."""
    return GfpGraspEnv(objects=objects, split=split, completer=completer_name, world=world)


def _attempt(job: _Job) -> Trial:
    started = time.perf_counter()
    env = _env(job.objects, job.split, job.completer, "true")
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


def _best_grasps(env: GfpGraspEnv, completion: Completion, job: _Job) -> tuple[tuple[Grasp, ...], str]:
    name = _names(job.row)[1]
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


def _in_both_worlds(env: GfpGraspEnv, job: _Job, grasp: Grasp | None) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Info of the attempt on the true object and on the completed one."""
    if grasp is None:
        nothing = {"is_success": False, "reason": "no_grasp_found", "lift_m": 0.0, "slip_m": 0.0, "falls_free": False}
        return nothing, nothing
    action = env.action_code.encode(grasp)
    true_info = env.step(action)[4]
    other = _env(job.objects, job.split, job.completer, "completed")
    other.reset(seed=job.episode_seed, options={"object": job.number, "completion": env.completion})
    return true_info, other.step(action)[4]


def _errors(env: GfpGraspEnv, job: _Job) -> CompletionErrors | None:
    episode = env.episode
    if episode.completion is None:
        return None
    truth = episode.truth.mesh.copy()
    truth.apply_transform(episode.T_world_object)
    return completion_errors(episode.completion.mesh, truth, rng=np.random.default_rng(job.episode_seed))


__all__ = ["ALL_CLASSES", "BRACKETED", "Report", "Trial", "score"]
