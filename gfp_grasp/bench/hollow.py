"""Bench of hollow things: `gfp-grasp bench hollow`.

Objects are completed from one view. A marble falls into every open vessel, a mug with a handle is hung on a peg, and a
bottle is put down; each also as its convex hull, which keeps nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.bench.vessels import drop_marble, handle_hole, hangs, inside_of, tilt_deg
from gfp_grasp.bench.views import see
from gfp_grasp.collision import hull
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.completion import Completion
from gfp_grasp.errors import GfpGraspError
from gfp_grasp.parallel import pmap
from gfp_grasp.scenes import ObjectSource, label_of, load_objects
from gfp_grasp.types import ConvexPart

MARBLE_M = 0.006
_FLOOR_M = 0.010  # of the floor's height, that a marble may lie off it
_TILT_DEG = 5.0
_PEG_SHARE, _PEG_M = 0.6, 0.005  # of the hole, and at most


def bench_hollow(
    objects: str = "cup,mug,bottle", *, limit: int | None = 20, seed: int = 0, workers: int = 1, progress=None
) -> dict[str, Any]:
    """What completed things hold, hang on and stand on.

    Args:
        objects: Families, or a folder of meshes.
        limit: Objects in all; None for all.
        seed: Of the views.
        workers: Processes.
        progress: Wraps the stream of objects.

    Returns:
        {"settings", "rows": {class: figures}, "trials": every object's}, the figures being

        - "objects", and "failed" of them, which were not completed;
        - "marble": "tried" (what is truly open to the marble), "completed_closed" (of those, which then keep none),
          "kept" (it lies within 10 mm of the height of the true floor), "kept_on_own" (of the completed mesh's floor),
          "off_mm" (median and largest distance of the kept ones from the true floor), "hull_kept" (from the convex
          hull), and "opened" (completed as open, which the truth is not; not tried);
        - "peg": "tried" (a handle was completed that has a hole), "hung", "hull_hung";
        - "stand": "tried" (the truth stands), "stood".

        An object that failed is in no count but its own.
    """
    sources = load_objects(objects, limit=limit)
    trials = pmap(partial(_trial, seed=seed), list(enumerate(sources)), workers=workers, progress=progress)
    rows = {
        c: _figures([t for t in trials if t["category"] == c]) for c in dict.fromkeys(t["category"] for t in trials)
    }
    settings = {"objects": label_of(objects), "num_objects": len(sources), "seed": seed}
    return {"settings": settings, "rows": rows, "trials": trials}


def _trial(job: tuple[int, ObjectSource], *, seed: int) -> dict[str, object]:
    number, source = job
    found: dict[str, object] = {"object": source.name, "category": source.category}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sight = see(source.load_mesh(), np.random.default_rng([seed, number]))
        try:
            completion = complete_to_mesh(sight.cloud.points, viewpoint=sight.cloud.viewpoint)
            parts = completion.collision.parts
        except GfpGraspError as error:
            return {**found, "failed": f"{type(error).__name__}: {error}"}
        whole = hull(completion.mesh).parts
    found |= {"taken_for": completion.category, "made_by": completion.collision.made_by}
    for test in (_marble, _peg, _stand):
        found |= test(completion, parts, whole, sight.mesh)
    return found


def _marble(
    completion: Completion, parts: Sequence[ConvexPart], whole: Sequence[ConvexPart], truth: trimesh.Trimesh
) -> dict[str, object]:
    own, true = inside_of(completion.mesh), inside_of(truth)
    if true is None or true.room_m <= MARBLE_M:
        return {} if own is None else {"opened": True}
    start = replace(own or true, rim_m=max(completion.mesh.bounds[1, 2], truth.bounds[1, 2]))
    bottoms = [drop_marble(p, start, radius_m=MARBLE_M)[2] - MARBLE_M for p in (parts, whole)]
    off, hull_off = ((bottom - true.floor_m) * 1000 for bottom in bottoms)
    off_own = None if own is None else round(float(bottoms[0] - own.floor_m) * 1000, 2)
    return {"marble_off_mm": round(float(off), 2), "off_own_mm": off_own, "hull_off_mm": round(float(hull_off), 2)}


def _peg(
    completion: Completion, parts: Sequence[ConvexPart], whole: Sequence[ConvexPart], truth: trimesh.Trimesh
) -> dict[str, object]:
    del truth
    assert completion.fit is not None
    handle = completion.fit.primitive.on_region("handle")
    hole = handle_hole(completion.mesh, handle) if handle.any() else None
    if hole is None:
        return {}
    middle, through, room = hole
    radius = min(_PEG_M, _PEG_SHARE * room)
    return {"hung": [hangs(completion.mesh, p, middle, through, radius) for p in (parts, whole)]}


def _stand(
    completion: Completion, parts: Sequence[ConvexPart], whole: Sequence[ConvexPart], truth: trimesh.Trimesh
) -> dict[str, object]:
    if tilt_deg(truth, hull(truth).parts) > _TILT_DEG:
        return {}
    return {"tilt_deg": round(tilt_deg(completion.mesh, parts), 2)}


def _figures(trials: Sequence[dict]) -> dict[str, object]:
    marbles = [t for t in trials if "marble_off_mm" in t]
    pegs, tilts = [t["hung"] for t in trials if "hung" in t], [t["tilt_deg"] for t in trials if "tilt_deg" in t]
    opened = [t for t in marbles if t["off_own_mm"] is not None]
    kept = [abs(t["marble_off_mm"]) for t in opened if _near(t["marble_off_mm"])]
    return {
        "objects": len(trials),
        "failed": sum("failed" in t for t in trials),
        "marble": {
            "tried": len(marbles),
            "completed_closed": len(marbles) - len(opened),
            "kept": len(kept),
            "kept_on_own": sum(_near(t["off_own_mm"]) for t in opened),
            "off_mm": [round(float(np.median(kept)), 2), round(max(kept), 2)] if kept else None,
            "hull_kept": sum(_near(t["hull_off_mm"]) for t in marbles),
            "opened": sum("opened" in t for t in trials),
        },
        "peg": {"tried": len(pegs), "hung": sum(p for p, _ in pegs), "hull_hung": sum(p for _, p in pegs)},
        "stand": {"tried": len(tilts), "stood": sum(tilt <= _TILT_DEG for tilt in tilts)},
    }


def _near(off_mm: float) -> bool:
    return abs(off_mm) <= 1000 * _FLOOR_M
