"""What completions are worth: the success of the grasps planned on them, on the true objects and in their own world."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from gfp_grasp import __version__
from gfp_grasp.attempts import AttemptJob, attempt, lost_attempt
from gfp_grasp.completers import completer
from gfp_grasp.envs.graspable import is_graspable
from gfp_grasp.envs.settings import TrialSettings
from gfp_grasp.errors import GfpGraspError, InvalidMesh, InvalidOption
from gfp_grasp.grasps.planners import planner
from gfp_grasp.journal import Journal
from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import list_primitives
from gfp_grasp.report import Report, Trial, row_names
from gfp_grasp.scenes import ObjectSource, label_of, load_objects

ALL_CLASSES = "*"
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
    clutter: int = 0,
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
    best grasp fails on the true object, the next ones are attempted, each on the scene as it was. Objects that the
    gripper cannot take hold of though all of them is known are left out, and named in the report's settings.

    Args:
        objects: Families ("cup,mug"), a mesh file, or a folder of `<class>__<name>.<suffix>`.
        completers: Names, see `gfp_grasp.completers.completer`; behind a slash the planner's, see
            `gfp_grasp.grasps.planner`, if it is not `antipodal`, as in "gfpnet/top-down".
        views: Views of each object.
        grasps: So many of the best are attempted until one holds; the first alone is the score.
        seed: Of poses, views, noise and planning.
        split: Which seeds of a family.
        clutter: So many other objects, of the same choice, stand around each.
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
        InvalidOption: Objects that are not there, none of these classes or none that can be grasped, views or grasps
            below one, or an unknown planner.
        CannotWrite: The journal; what was written before is kept.
        InvalidMesh: Files of which no object can be made; all of them are named, before anything is scored.
    """
    for count, what in ((views, "views"), (grasps, "grasps"), (1 if limit is None else limit, "limit")):
        if count < 1:
            raise InvalidOption(f"{what} is {count}; at least 1 is expected")
    if clutter < 0:
        raise InvalidOption(f"clutter is {clutter}; zero or more is expected")
    if not completers or len(set(completers)) < len(completers):
        raise InvalidOption(f"completers are {tuple(completers)}; at least one is expected, and each but once")
    for row in completers:
        name, planner_name = row_names(row)
        completer(name)
        planner(planner_name)
    how = {"workers": workers, "ray": ray}
    chosen = _chosen(objects, split, classes, limit)
    fits = pmap(partial(_is_graspable, objects=str(objects), split=split), [number for number, _ in chosen], **how)
    kept = [pair for pair, fit in zip(chosen, fits, strict=True) if fit]
    ungraspable = [name for (_, name), fit in zip(chosen, fits, strict=True) if not fit]
    if not kept:
        raise InvalidOption(f"the gripper cannot take hold of any of {', '.join(ungraspable)}: are they in metres?")
    jobs = [
        AttemptJob(str(objects), split, number, source_name, row, view, seed, clutter, grasps)
        for number, source_name in kept
        for view in range(views)
        for row in completers
    ]
    settings = {
        "objects": label_of(objects),
        "split": split,
        "num_objects": len(kept),
        "ungraspable": ungraspable,
        "classes": sorted(_classes(classes)),
        "completers": list(completers),
        "views": int(views),
        "clutter": int(clutter),
        "grasps": int(grasps),
        "seed": int(seed),
        "trial": asdict(TrialSettings()),
    }
    return Report(settings, _trials(jobs, settings, journal, progress=progress, **how))


def _is_graspable(number: int, *, objects: str, split: str) -> bool:
    source = load_objects(objects, split)[number]
    try:
        return is_graspable(source.load())
    except GfpGraspError:  # the trials will say of it what there is to be said
        return True


def _trials(
    jobs: Sequence[AttemptJob], settings: Mapping[str, object], path: str | Path | None, **how: Any
) -> tuple[Trial, ...]:
    """Of all jobs, but those that the journal holds are not made again."""
    if path is None:
        return tuple(pmap(attempt, jobs, lost=lost_attempt, **how))
    journal = Journal(path, {"version": __version__, **settings})
    trials = {(t.object, t.view, t.completer): t for t in (Trial(**record) for record in journal.records)}
    left = [job for job in jobs if (job.object_name, job.view, job.row) not in trials]
    for trial in pmap(attempt, left, lost=lost_attempt, keep=lambda _, trial: journal.add(asdict(trial)), **how):
        trials[trial.object, trial.view, trial.completer] = trial
    return tuple(trials[job.object_name, job.view, job.row] for job in jobs)


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


__all__ = ["ALL_CLASSES", "BRACKETED", "Report", "Trial", "score"]
