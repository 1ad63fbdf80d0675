"""Bench of hollow things: `gfp-grasp bench hollow`.

Objects are completed from one view. A marble falls into every open vessel, a handle that has a hole is hung on a peg,
and what stands is put down; each also as its convex hull, which keeps and hangs nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.bench.methods import view_object
from gfp_grasp.bench.rows import Row
from gfp_grasp.bench.vessels import drop_marble, handle_hole, hangs, inside_of, tilt_deg
from gfp_grasp.collision import hull
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.completion import Completion
from gfp_grasp.errors import GfpGraspError
from gfp_grasp.parallel import pmap
from gfp_grasp.scenes import ObjectSource, label_of, load_objects
from gfp_grasp.types import ConvexPart

MARBLE_M = 0.006
_FLOOR_MM = 10.0  # a marble may lie this far off the floor's height
_TILT_DEG = 5.0
_PEG_SHARE, _PEG_M = 0.6, 0.005  # radius of the peg: this share of the hole's, and at most so much


@dataclass(frozen=True, kw_only=True)
class HollowRow(Row):
    """One object in the three tests; None where a test was not made.

    Attributes:
        object: Name of the object.
        category: True class of the object.
        failed: Error that ended the completion.
        taken_for: Class that the completion took it for.
        made_by: Engine that made the convex parts.
        marble_off_mm: Height of the marble's rest in the parts above the true floor.
        off_own_mm: Height of the same rest above the floor of the completed mesh; None where that is closed.
        hull_off_mm: Height of the marble's rest in the convex hull above the true floor.
        opened: The completion is open, which the truth is not.
        hung: Whether the parts hang on the peg, and whether the hull does.
        tilt_deg: Angle by which the parts have tilted on a plane.
    """

    object: str
    category: str
    failed: str | None = None
    taken_for: str | None = None
    made_by: str | None = None
    marble_off_mm: float | None = None
    off_own_mm: float | None = None
    hull_off_mm: float | None = None
    opened: bool | None = None
    hung: tuple[bool, bool] | None = None
    tilt_deg: float | None = None


def bench_hollow(
    objects: str = "all", *, limit: int | None = 20, seed: int = 0, workers: int = 1, progress=None
) -> dict[str, Any]:
    """Let completed objects hold a marble, hang on a peg and stand.

    Args:
        objects: Procedural families with commas between or "all", or a folder of meshes.
        limit: Most objects in all; None takes all.
        seed: Seed of the views.
        workers: Number of processes.
        progress: Wraps the stream of objects.

    Returns:
        {"settings", "rows": {class: figures}, "trials": every `HollowRow`}. The figures are

        - "objects", and "failed", the number that were not completed;
        - "marble": "tried" (truly open to the marble), "completed_closed" (completed as closed, which keep none),
          "kept" (it lies within 10 mm of the height of the true floor), "kept_on_own" (of the completed mesh's floor),
          "off_mm" (median and largest distance of the kept ones from the true floor), "hull_kept" (from the convex
          hull), and "opened" (completed as open, which the truth is not; not tried);
        - "peg": "tried" (a handle was completed that has a hole), "hung", "hull_hung";
        - "stand": "tried" (the truth stands), "stood".

        An object that failed is in no count but its own.
    """
    sources = load_objects(objects, limit=limit)
    rows = pmap(partial(_measure_object, seed=seed), list(enumerate(sources)), workers=workers, progress=progress)
    classes = dict.fromkeys(row.category for row in rows)
    return {
        "settings": {"objects": label_of(objects), "num_objects": len(sources), "seed": seed},
        "rows": {c: _figures([row for row in rows if row.category == c]) for c in classes},
        "trials": [row.to_json() for row in rows],
    }


def _measure_object(job: tuple[int, ObjectSource], *, seed: int) -> HollowRow:
    number, source = job
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        view = view_object(source.load_mesh(), np.random.default_rng([seed, number]))
        try:
            completion = complete_to_mesh(view.cloud.points, viewpoint=view.cloud.viewpoint)
            parts = completion.collision.parts
        except GfpGraspError as error:
            return HollowRow(object=source.name, category=source.category, failed=f"{type(error).__name__}: {error}")
        whole = hull(completion.mesh).parts
    return HollowRow(
        object=source.name,
        category=source.category,
        taken_for=completion.category,
        made_by=completion.collision.made_by,
        **_marble(completion, parts, whole, view.mesh),
        hung=_peg(completion, parts, whole),
        tilt_deg=_stand(completion, parts, view.mesh),
    )


def _marble(
    completion: Completion, parts: Sequence[ConvexPart], whole: Sequence[ConvexPart], truth: trimesh.Trimesh
) -> dict[str, Any]:
    """Fields of a `HollowRow` that tell of the marble."""
    own, true = inside_of(completion.mesh), inside_of(truth)
    if true is None or true.room_m <= MARBLE_M:
        return {"opened": True} if own is not None else {}
    start = replace(own or true, rim_m=max(completion.mesh.bounds[1, 2], truth.bounds[1, 2]))
    bottoms = [drop_marble(p, start, radius_m=MARBLE_M)[2] - MARBLE_M for p in (parts, whole)]
    off, hull_off = ((bottom - true.floor_m) * 1000 for bottom in bottoms)
    off_own = None if own is None else round(float(bottoms[0] - own.floor_m) * 1000, 2)
    return {"marble_off_mm": round(float(off), 2), "off_own_mm": off_own, "hull_off_mm": round(float(hull_off), 2)}


def _peg(completion: Completion, parts: Sequence[ConvexPart], whole: Sequence[ConvexPart]) -> tuple[bool, bool] | None:
    assert completion.fit is not None
    handle = completion.fit.primitive.on_region("handle")
    hole = handle_hole(completion.mesh, handle) if handle.any() else None
    if hole is None:
        return None
    middle, through, room = hole
    radius = min(_PEG_M, _PEG_SHARE * room)
    hung, hull_hung = (hangs(completion.mesh, p, middle, through, radius) for p in (parts, whole))
    return hung, hull_hung


def _stand(completion: Completion, parts: Sequence[ConvexPart], truth: trimesh.Trimesh) -> float | None:
    if tilt_deg(truth, hull(truth).parts) > _TILT_DEG:
        return None
    return round(tilt_deg(completion.mesh, parts), 2)


def _figures(rows: Sequence[HollowRow]) -> dict[str, Any]:
    marbles = [row for row in rows if row.marble_off_mm is not None]
    opened = [row for row in marbles if row.off_own_mm is not None]
    kept = [abs(row.marble_off_mm) for row in opened if row.marble_off_mm is not None and _near(row.marble_off_mm)]
    pegs, tilts = [row.hung for row in rows if row.hung], [row.tilt_deg for row in rows if row.tilt_deg is not None]
    return {
        "objects": len(rows),
        "failed": sum(row.failed is not None for row in rows),
        "marble": {
            "tried": len(marbles),
            "completed_closed": len(marbles) - len(opened),
            "kept": len(kept),
            "kept_on_own": sum(_near(row.off_own_mm) for row in opened),
            "off_mm": [round(float(np.median(kept)), 2), round(max(kept), 2)] if kept else None,
            "hull_kept": sum(_near(row.hull_off_mm) for row in marbles),
            "opened": sum(row.opened is not None for row in rows),
        },
        "peg": {"tried": len(pegs), "hung": sum(p for p, _ in pegs), "hull_hung": sum(p for _, p in pegs)},
        "stand": {"tried": len(tilts), "stood": sum(tilt <= _TILT_DEG for tilt in tilts)},
    }


def _near(off_mm: float | None) -> bool:
    return off_mm is not None and abs(off_mm) <= _FLOOR_MM
