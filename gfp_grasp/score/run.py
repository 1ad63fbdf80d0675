"""What completions are worth: the success of the grasps planned on them, on the true objects and in their own world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from gfp_grasp import __version__
from gfp_grasp.completers import get_completer
from gfp_grasp.detect import get_detector
from gfp_grasp.envs import TrialSettings
from gfp_grasp.errors import GfpGraspError, InvalidMesh, InvalidOption
from gfp_grasp.grasps import get_planner
from gfp_grasp.journal import Journal
from gfp_grasp.parallel import Progress, pmap
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes import ObjectSource, label_of, load_objects
from gfp_grasp.score.report import Report, ScoreRow, method_names
from gfp_grasp.score.rows import NO_GRIP, TOO_HEAVY, RowJob, ScoreConfig, hindrance, lost_row, make_row

ALL_CLASSES = "*"
BRACKETED = ("observed", "observed/top-down", "mirror", "gfs", "registration", "gfpnet-paper", "gfpnet", "oracle")


def score(
    objects: str | Path,
    completers: Sequence[str] = BRACKETED,
    *,
    config: ScoreConfig = ScoreConfig(),
    workers: int = 1,
    ray: str | None = None,
    journal: str | Path | None = None,
    progress: Progress | None = None,
) -> Report:
    """Score completers by their grasps.

    Every completer meets the same objects in the same poses, views and sensor noise. The best grasp planned on each
    completion is tried as `GfpGraspEnv.step` tries it, once on the true object and once with the completion's convex
    parts simulated in its place. No completion, or no grasp on it, counts as a failure (`no_grasp_found`). Where the
    best grasp fails on the true object, the next ones are tried, each on the scene as it was. Objects that the gripper
    cannot take hold of though all of them is known, and such as it cannot carry, are left out and named in the report's
    settings as no_grip and too_heavy.

    Args:
        objects: Families ("cup,mug"), a mesh file, or a folder of `<class>__<name>.<suffix>`.
        completers: Names, see `gfp_grasp.completers.get_completer`; behind a slash the planner's, see
            `gfp_grasp.grasps.get_planner`, if it is not `antipodal`, as in "gfpnet/top-down".
        config: Objects, views and grasps.
        workers: Number of processes; the result does not depend on it.
        ray: Address of a Ray cluster to run on, or "auto"; the result is the same.
        journal: File that rows are written to as they come. Rows that it holds from a run that was stopped are kept,
            and the file stays: it is the caller's to remove once the report is written.
        progress: Wraps the stream of rows, told how many there will be.

    Raises:
        UnknownCompleter: A name that is not on offer.
        InvalidOption: Objects that are not there, none of these classes or none that can be grasped, or an unknown
            planner.
        CannotWrite: The journal; what was written before is kept.
        InvalidMesh: Files that no object can be made from; all of them are named, before anything is scored.
    """
    if not completers or len(set(completers)) < len(completers):
        raise InvalidOption(f"completers are {tuple(completers)}; at least one is expected, and each but once")
    for method in completers:
        completer_name, planner_name = method_names(method)
        get_completer(completer_name)
        get_planner(planner_name)
    how = {"workers": workers, "ray": ray}
    kept, left_out = _split_graspable(_chosen(objects, config), str(objects), config.split, **how)
    jobs = [
        RowJob(str(objects), number, object_name, method, view, config)
        for number, object_name in kept
        for view in range(config.views)
        for method in completers
    ]
    settings = {
        "objects": label_of(objects),
        "split": config.split,
        "num_objects": len(kept),
        **left_out,
        "classes": sorted(config.wanted()),
        "completers": list(completers),
        "views": int(config.views),
        "clutter": int(config.clutter),
        "grasps": int(config.grasps),
        "seed": int(config.seed),
        "trial": asdict(TrialSettings()),
    }
    get_detector(config.detector)
    if config.detector != "tabletop":
        settings["detector"] = config.detector
    if config.gps:
        settings["gps"] = [folder.name for folder in PrimitiveLibrary.from_option(config.gps).folders[1:]]
    return Report(settings, _rows(jobs, settings, journal, progress=progress, **how))


def _rows(
    jobs: Sequence[RowJob], settings: Mapping[str, object], path: str | Path | None, **how: Any
) -> tuple[ScoreRow, ...]:
    """Rows of all jobs; those that the journal holds are not made again."""
    if path is None:
        return tuple(pmap(make_row, jobs, lost=lost_row, **how))
    journal = Journal(path, {"version": __version__, **settings})
    rows = {(row.object, row.view, row.completer): row for row in (ScoreRow(**record) for record in journal.records)}
    left = [job for job in jobs if (job.object_name, job.view, job.method) not in rows]
    for row in pmap(make_row, left, lost=lost_row, keep=lambda _, row: journal.add(asdict(row)), **how):
        rows[row.object, row.view, row.completer] = row
    return tuple(rows[job.object_name, job.view, job.method] for job in jobs)


def _chosen(objects: str | Path, config: ScoreConfig) -> list[tuple[int, str]]:
    """Numbers and names of the objects that are asked for."""
    sources = load_objects(objects, config.split)
    wanted = config.wanted()
    kept = [(i, s.name) for i, s in enumerate(sources) if ALL_CLASSES in wanted or s.category in wanted]
    if not kept:
        found = ", ".join(sorted({source.category for source in sources}))
        raise InvalidOption(f"no object is of class {', '.join(sorted(wanted))}; there are: {found}")
    kept = kept[: config.limit]
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


def _split_graspable(
    chosen: Sequence[tuple[int, str]], objects: str, split: str, **how: Any
) -> tuple[list[tuple[int, str]], dict[str, list[str]]]:
    """Numbers and names of the objects that the gripper can carry, and the names of the others by what hinders."""
    reasons = pmap(partial(_hindrance, objects=objects, split=split), [number for number, _ in chosen], **how)
    asked = list(zip(chosen, reasons, strict=True))
    kept = [pair for pair, reason in asked if not reason]
    left_out = {kind: [name for (_, name), reason in asked if reason == kind] for kind in (NO_GRIP, TOO_HEAVY)}
    if not kept:
        told = "; ".join(f"{kind.replace('_', ' ')}: {', '.join(names)}" for kind, names in left_out.items() if names)
        raise InvalidOption(f"the gripper cannot carry any of the objects ({told}): are they in metres?")
    return kept, left_out


def _hindrance(number: int, *, objects: str, split: str) -> str:
    source = load_objects(objects, split)[number]
    try:
        return hindrance(source.load())
    except GfpGraspError:  # its rows will tell what there is to be told
        return ""
