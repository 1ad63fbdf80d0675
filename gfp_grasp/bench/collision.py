"""Bench of collision parts: `gfp-grasp bench collision`.

Objects are completed from one view, and the same completed mesh is given to every method: the primitive's parts carried
along, CoACD afresh, V-HACD, and the hull. The scans of a folder are decomposed as they are, too.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import trimesh

from gfp_grasp.bench.views import see
from gfp_grasp.collision import DecomposeConfig, collision_of, decompose, hull
from gfp_grasp.collision.convex import within_parts
from gfp_grasp.collision.fidelity import union_error_m
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.completion import Completion
from gfp_grasp.envs.pace import held_steps_per_s
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.parallel import pmap
from gfp_grasp.scenes import ObjectSource, label_of, load_objects
from gfp_grasp.types import CollisionMesh, ConvexPart, Grasp

_ENGINES = {
    "coacd_0.05": DecomposeConfig(threshold=0.05, cache=False),
    "coacd_0.02": DecomposeConfig(threshold=0.02, cache=False),
    "vhacd": DecomposeConfig(engine="vhacd", max_convex_hull=64, cache=False),
}
METHODS = ("carried", *_ENGINES, "hull")
_INSIDE = 40_000  # places that the intersection over union is counted on


def bench_collision(
    objects: str = "cup,mug,bottle",
    *,
    methods: Sequence[str] = METHODS,
    limit: int | None = 4,
    truth: bool = False,
    seed: int = 0,
    workers: int = 1,
    progress=None,
) -> dict[str, object]:
    """Time, size, truth and speed in MuJoCo of each method's parts, on the same completed meshes.

    Args:
        objects: Families, or a folder of meshes.
        methods: Of METHODS.
        limit: Objects in all, families taking turns; None for all.
        truth: Decompose the true meshes as well, by all methods but "carried".
        seed: Of views and samples.
        workers: Processes; use 1 where the times matter.
        progress: Wraps the stream of objects.

    Returns:
        {"settings", "rows": {"completed" or "true": {class or "all": {method: {"ms" median, "parts", "vertices" means,
        "error_mm" mean and 95 %, medians, "iou" mean, "steps_per_s" median in a gripper, "objects", "failed"}}}},
        "ratio": {class: median of the time of coacd_0.05 over that of carried}, "trials": every object's}.
    """
    unknown = set(methods) - set(METHODS)
    if unknown or not methods:
        raise InvalidOption(f"methods are {tuple(methods)}; some of {METHODS} are expected")
    sources = load_objects(objects, limit=limit)
    jobs = list(enumerate(sources))
    run = partial(_trial, methods=tuple(methods), truth=truth, seed=seed)
    trials = [t for found in pmap(run, jobs, workers=workers, progress=progress) for t in found]
    rows: dict[str, dict[str, dict]] = {}
    for kind in dict.fromkeys(t["mesh"] for t in trials):
        mine = [t for t in trials if t["mesh"] == kind]
        groups = {c: [t for t in mine if t["category"] == c] for c in dict.fromkeys(t["category"] for t in mine)}
        rows[str(kind)] = {
            name: {
                m: _figures([t for t in group if t["method"] == m])
                for m in methods
                if m in {t["method"] for t in group}
            }
            for name, group in {**groups, "all": mine}.items()
        }
    settings = {"objects": label_of(objects), "num_objects": len(sources), "seed": seed, "methods": list(methods)}
    return {"settings": settings, "rows": rows, "ratio": _ratios(trials), "trials": trials}


def _trial(job: tuple[int, ObjectSource], *, methods: Sequence[str], truth: bool, seed: int) -> list[dict]:
    number, source = job
    mesh = source.load_mesh()
    found = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        sight = see(mesh, np.random.default_rng([seed, number]))
        try:
            completion = complete_to_mesh(sight.cloud.points, viewpoint=sight.cloud.viewpoint)
            grasps = plan_grasps(completion, num=1, seed=seed)
        except GfpGraspError:
            completion, grasps = None, ()
        if completion is not None:
            _way("carried", completion)()  # what is loaded once is loaded
            for method in methods:
                found.append(_judged(method, completion.mesh, _way(method, completion), grasps, seed))
        if truth:
            for method in methods:
                if method != "carried":
                    found.append({**_judged(method, mesh, _way(method, mesh), (), seed), "mesh": "true"})
    return [{"mesh": "completed", **trial, "object": source.name, "category": source.category} for trial in found]


def _way(method: str, of: Completion | trimesh.Trimesh) -> Callable[[], CollisionMesh]:
    mesh = of.mesh if isinstance(of, Completion) else of
    if method == "carried":
        assert isinstance(of, Completion)
        return lambda: collision_of(replace(of.shape, mesh=mesh.copy()))
    if method == "hull":
        return lambda: hull(mesh)
    return lambda: decompose(mesh, config=_ENGINES[method])


def _judged(
    method: str, mesh: trimesh.Trimesh, way: Callable[[], CollisionMesh], grasps: Sequence[Grasp], seed: int
) -> dict[str, object]:
    """Run a method, and measure all in one way, whatever the method says of itself."""
    start = time.perf_counter()
    try:
        found = way()
    except GfpGraspError as error:
        return {"method": method, "failed": f"{type(error).__name__}: {error}"}
    seconds = time.perf_counter() - start
    rng = np.random.default_rng(seed)
    error_m = union_error_m(found.parts, mesh, count=4000, rng=rng)
    return {
        "method": method,
        "made_by": found.made_by,
        "ms": round(1000 * seconds, 2),
        "parts": len(found.parts),
        "vertices": sum(len(part.vertices) for part in found.parts),
        "error_mm": [round(1000 * error, 3) for error in error_m],
        "iou": round(_iou(found.parts, mesh, rng), 4),
        "steps_per_s": held_steps_per_s(found.parts, grasps[0]) if len(grasps) else None,
    }


def _iou(parts: Sequence[ConvexPart], mesh: trimesh.Trimesh, rng: np.random.Generator) -> float:
    reach = np.concatenate([mesh.bounds, *(part.vertices for part in parts)])
    places = rng.uniform(reach.min(axis=0), reach.max(axis=0), (_INSIDE, 3))
    mine, its = within_parts(places, parts).any(axis=1), mesh.contains(places)
    return float((mine & its).sum() / max((mine | its).sum(), 1))


def _figures(trials: Sequence[dict]) -> dict[str, object]:
    done = [t for t in trials if "failed" not in t]
    figures: dict[str, object] = {"objects": len(trials), "failed": len(trials) - len(done)}
    if not done:
        return figures
    steps = [t["steps_per_s"] for t in done if t["steps_per_s"] is not None]
    return {
        **figures,
        "ms": round(float(np.median([t["ms"] for t in done])), 2),
        "parts": round(float(np.mean([t["parts"] for t in done])), 1),
        "vertices": round(float(np.mean([t["vertices"] for t in done])), 1),
        "error_mm": np.round(np.median([t["error_mm"][:2] for t in done], axis=0), 3).tolist(),
        "iou": round(float(np.mean([t["iou"] for t in done])), 4),
        "steps_per_s": round(float(np.median(steps)), 1) if steps else None,
    }


def _ratios(trials: Sequence[dict]) -> dict[str, float]:
    """Time of CoACD at 0.05 over that of carrying, median over the completed objects of each class."""
    ms = {
        (t["object"], t["method"]): (t["category"], t["ms"]) for t in trials if t["mesh"] == "completed" and "ms" in t
    }
    ratios: dict[str, list[float]] = {}
    for (name, method), (category, slow) in ms.items():
        if method == "coacd_0.05" and (name, "carried") in ms:
            for group in (category, "all"):
                ratios.setdefault(group, []).append(slow / ms[name, "carried"][1])
    return {group: round(float(np.median(found)), 1) for group, found in ratios.items()}
