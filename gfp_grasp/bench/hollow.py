"""Bench of hollow things: `gfp-grasp bench hollow`.

Objects are completed from one view. A marble falls into every open vessel, a mug with a handle is hung on a peg, and a
bottle is put down; each also as its convex hull, which keeps nothing.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.bench.views import see
from gfp_grasp.camera import cast_rays
from gfp_grasp.collision import hull
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.completion import Completion
from gfp_grasp.envs.hollow import drop_marble, handle_hole, hangs, inside_of, tilt_deg
from gfp_grasp.errors import GfpGraspError
from gfp_grasp.parallel import pmap
from gfp_grasp.scenes import ObjectSource, load_objects
from gfp_grasp.types import HANDLE, ConvexPart

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
        {"settings", "rows": {class: {"marble": {"tried", "kept", "off_mm" median and largest distance of the kept ones
        from the true floor, "hull_kept"}, "peg": {"tried", "hung", "hull_hung"}, "stand": {"tried", "stood"}}},
        "trials": every object's}. Kept is a marble that lies within 10 mm of the height of the true floor; what is not
        open, has no handle that was seen, or did not stand itself is not tried.
    """
    sources = load_objects(objects, limit=limit)
    trials = pmap(partial(_trial, seed=seed), list(enumerate(sources)), workers=workers, progress=progress)
    rows = {
        c: _figures([t for t in trials if t["category"] == c]) for c in dict.fromkeys(t["category"] for t in trials)
    }
    return {"settings": {"objects": objects, "num_objects": len(sources), "seed": seed}, "rows": rows, "trials": trials}


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
    inside = inside_of(completion.mesh)
    if inside is None:
        return {}
    above = np.array([*inside.middle[:2], truth.bounds[1, 2] + 0.1])
    floor = above[2] - cast_rays([(truth.vertices, truth.faces)], above, np.array([[0, 0, -1.0]]))[0][0]
    off = [float(drop_marble(p, inside, radius_m=MARBLE_M)[2] - MARBLE_M - floor) for p in (parts, whole)]
    return {"marble_off_mm": [round(1000 * distance, 2) for distance in off]}


def _peg(
    completion: Completion, parts: Sequence[ConvexPart], whole: Sequence[ConvexPart], truth: trimesh.Trimesh
) -> dict[str, object]:
    del truth
    assert completion.fit is not None
    handle = completion.fit.primitive.regions == HANDLE
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
    marbles = [t["marble_off_mm"] for t in trials if "marble_off_mm" in t]
    pegs, tilts = [t["hung"] for t in trials if "hung" in t], [t["tilt_deg"] for t in trials if "tilt_deg" in t]
    kept = [abs(off) for off, _ in marbles if abs(off) <= 1000 * _FLOOR_M]
    return {
        "failed": sum("failed" in t for t in trials),
        "marble": {
            "tried": len(marbles),
            "kept": len(kept),
            "off_mm": [round(float(np.median(kept)), 2), round(max(kept), 2)] if kept else None,
            "hull_kept": sum(abs(off) <= 1000 * _FLOOR_M for _, off in marbles),
        },
        "peg": {"tried": len(pegs), "hung": sum(p for p, _ in pegs), "hull_hung": sum(p for _, p in pegs)},
        "stand": {"tried": len(tilts), "stood": sum(tilt <= _TILT_DEG for tilt in tilts)},
    }
