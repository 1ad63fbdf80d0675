"""Bench of collision parts: `gfp-grasp bench collision`.

Objects are completed from one view, and the same completed mesh is given to every method: the primitive's parts carried
along, CoACD afresh, V-HACD, and the hull. The scans of a folder are decomposed as they are, too.
"""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import mujoco
import numpy as np
import trimesh

from gfp_grasp.bench.methods import view_object
from gfp_grasp.bench.rows import Row
from gfp_grasp.collision import DecomposeConfig, collision_of, decompose, hull, union_error_m, within_parts
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.completion import Completion
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.parallel import pmap
from gfp_grasp.scenes import TARGET, Handles, ObjectSource, SceneObject, World, label_of, load_objects
from gfp_grasp.types import CollisionMesh, ConvexPart, Grasp

_ENGINES = {
    "coacd_0.05": DecomposeConfig(threshold=0.05, cache=False),
    "coacd_0.02": DecomposeConfig(threshold=0.02, cache=False),
    "vhacd": DecomposeConfig(engine="vhacd", max_convex_hull=64, cache=False),
}
METHODS = ("carried", *_ENGINES, "hull")
_MASS_KG, _FRICTION = 0.2, 0.8
_INSIDE = 40_000  # places that the intersection over union is counted on


@dataclass(frozen=True, kw_only=True)
class PartsRow(Row):
    """One method on one mesh; None where a figure does not apply.

    Attributes:
        mesh: "completed" or "true".
        object: Name of the object.
        category: True class of the object.
        method: Name of the method.
        failed: Error that ended the method; the figures are None then.
        made_by: Engine that made the parts.
        ms: Time that the method took, ms.
        parts: Number of convex parts.
        vertices: Number of vertices of all parts.
        error_mm: Mean, 95 % and largest distance between parts and mesh, both ways.
        iou: Intersection over union of parts and mesh.
        steps_per_s: Steps of MuJoCo a second with the parts in a gripper.
    """

    mesh: str
    object: str
    category: str
    method: str
    failed: str | None = None
    made_by: str | None = None
    ms: float | None = None
    parts: int | None = None
    vertices: int | None = None
    error_mm: tuple[float, ...] | None = None
    iou: float | None = None
    steps_per_s: float | None = None


def bench_collision(
    objects: str = "all",
    *,
    methods: Sequence[str] = METHODS,
    limit: int | None = 4,
    truth: bool = False,
    seed: int = 0,
    workers: int = 1,
    progress=None,
) -> dict[str, Any]:
    """Time, size, truth and speed in MuJoCo of each method's parts, on the same completed meshes.

    Args:
        objects: Procedural families with commas between or "all", or a folder of meshes.
        methods: Some of METHODS.
        limit: Most objects in all, families taking turns; None takes all.
        truth: Decompose the true meshes as well, by all methods but "carried".
        seed: Seed of views and samples.
        workers: Number of processes; use 1 where the times matter.
        progress: Wraps the stream of objects.

    Returns:
        {"settings", "rows": {"completed" or "true": {class or "all": {method: {"ms" median, "parts", "vertices" means,
        "error_mm" mean and 95 %, medians, "iou" mean, "steps_per_s" median in a gripper, "objects", "failed"}}}},
        "ratio": {class: median of the time of coacd_0.05 over that of carried}, "trials": every `PartsRow`}.
    """
    unknown = set(methods) - set(METHODS)
    if unknown or not methods:
        raise InvalidOption(f"methods are {tuple(methods)}; some of {METHODS} are expected")
    sources = load_objects(objects, limit=limit)
    run = partial(_rows_of_object, methods=tuple(methods), truth=truth, seed=seed)
    found = [row for rows in pmap(run, list(enumerate(sources)), workers=workers, progress=progress) for row in rows]
    rows = {mesh: _by_class([row for row in found if row.mesh == mesh], methods) for mesh in _unique(found, "mesh")}
    settings = {"objects": label_of(objects), "num_objects": len(sources), "seed": seed, "methods": list(methods)}
    trials = [row.to_json() for row in found]
    return {"settings": settings, "rows": rows, "ratio": _ratios(found), "trials": trials}


def _by_class(rows: Sequence[PartsRow], methods: Sequence[str]) -> dict[str, dict[str, dict[str, Any]]]:
    """Figures of each method on the objects of each class and on all of them."""
    groups = {c: [row for row in rows if row.category == c] for c in _unique(rows, "category")}
    return {
        name: {m: _figures([row for row in group if row.method == m]) for m in methods if m in _unique(group, "method")}
        for name, group in {**groups, "all": rows}.items()
    }


def _unique(rows: Sequence[PartsRow], name: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(getattr(row, name) for row in rows))


def _rows_of_object(job: tuple[int, ObjectSource], *, methods: Sequence[str], truth: bool, seed: int) -> list[PartsRow]:
    number, source = job
    mesh = source.load_mesh()
    rows = []

    def measure(method: str, of: Completion | trimesh.Trimesh, grasps: Sequence[Grasp], world: str) -> None:
        own = of.mesh if isinstance(of, Completion) else of
        figures = _measure(own, _way(method, of), grasps, seed)
        rows.append(PartsRow(mesh=world, object=source.name, category=source.category, method=method, **figures))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        view = view_object(mesh, np.random.default_rng([seed, number]))
        try:
            completion = complete_to_mesh(view.cloud.points, viewpoint=view.cloud.viewpoint)
            grasps = plan_grasps(completion, num=1, seed=seed)
        except GfpGraspError:
            completion, grasps = None, ()
        if completion is not None:
            _way("carried", completion)()  # what is loaded once is loaded
            for method in methods:
                measure(method, completion, grasps, "completed")
        if truth:
            for method in methods:
                if method != "carried":
                    measure(method, mesh, (), "true")
    return rows


def _way(method: str, of: Completion | trimesh.Trimesh) -> Callable[[], CollisionMesh]:
    mesh = of.mesh if isinstance(of, Completion) else of
    if method == "carried":
        assert isinstance(of, Completion)
        return lambda: collision_of(replace(of.shape, mesh=mesh.copy()))
    if method == "hull":
        return lambda: hull(mesh)
    return lambda: decompose(mesh, config=_ENGINES[method])


def _measure(
    mesh: trimesh.Trimesh, way: Callable[[], CollisionMesh], grasps: Sequence[Grasp], seed: int
) -> dict[str, Any]:
    """Fields of a `PartsRow`: run a method and measure its parts, whatever the method says of itself."""
    start = time.perf_counter()
    try:
        found = way()
    except GfpGraspError as error:
        return {"failed": f"{type(error).__name__}: {error}"}
    seconds = time.perf_counter() - start
    rng = np.random.default_rng(seed)
    error_m = union_error_m(found.parts, mesh, count=4000, rng=rng)
    return {
        "made_by": found.made_by,
        "ms": round(1000 * seconds, 2),
        "parts": len(found.parts),
        "vertices": sum(len(part.vertices) for part in found.parts),
        "error_mm": tuple(round(1000 * error, 3) for error in error_m),
        "iou": round(_iou(found.parts, mesh, rng), 4),
        "steps_per_s": held_steps_per_s(found.parts, grasps[0]) if len(grasps) else None,
    }


def held_steps_per_s(parts: tuple[ConvexPart, ...], grasp: Grasp, *, steps: int = 400) -> float:
    """Steps a second of MuJoCo with the jaws of a gripper closed on convex parts.

    Args:
        parts: Convex parts, world frame, above a table at z = 0 or lifted onto it.
        grasp: Grasp at which the jaws close, world frame.
        steps: Number of steps for closing, and of those that are timed.
    """
    world = World([SceneObject.of_parts(parts, _MASS_KG, _FRICTION)])
    handles = Handles.of(world, TARGET)
    handles.place(grasp.T_world_gripper, grasp.width_m + 0.01)
    handles.set_opening(0.0)
    mujoco.mj_step(world.model, world.data, steps)
    start = time.perf_counter()
    mujoco.mj_step(world.model, world.data, steps)
    return round(steps / (time.perf_counter() - start), 1)


def _iou(parts: Sequence[ConvexPart], mesh: trimesh.Trimesh, rng: np.random.Generator) -> float:
    reach = np.concatenate([mesh.bounds, *(part.vertices for part in parts)])
    places = rng.uniform(reach.min(axis=0), reach.max(axis=0), (_INSIDE, 3))
    mine, its = within_parts(places, parts).any(axis=1), mesh.contains(places)
    return float((mine & its).sum() / max((mine | its).sum(), 1))


def _figures(rows: Sequence[PartsRow]) -> dict[str, Any]:
    done = [row for row in rows if row.failed is None]
    figures: dict[str, Any] = {"objects": len(rows), "failed": len(rows) - len(done)}
    if not done:
        return figures
    steps = [row.steps_per_s for row in done if row.steps_per_s is not None]
    error_mm = [row.error_mm[:2] for row in done if row.error_mm is not None]

    def of_all(middle: Callable[..., Any], name: str) -> float:
        return float(middle([getattr(row, name) for row in done]))

    return {
        **figures,
        "ms": round(of_all(np.median, "ms"), 2),
        "parts": round(of_all(np.mean, "parts"), 1),
        "vertices": round(of_all(np.mean, "vertices"), 1),
        "error_mm": np.round(np.median(error_mm, axis=0), 3).tolist(),
        "iou": round(of_all(np.mean, "iou"), 4),
        "steps_per_s": round(float(np.median(steps)), 1) if steps else None,
    }


def _ratios(rows: Sequence[PartsRow]) -> dict[str, float]:
    """Time of CoACD at 0.05 over that of carrying, median over the completed objects of each class."""
    ms = {(row.object, row.method): row.ms for row in rows if row.mesh == "completed" and row.ms is not None}
    category = {row.object: row.category for row in rows}
    ratios: dict[str, list[float]] = {}
    for (name, method), slow in ms.items():
        if method == "coacd_0.05" and (name, "carried") in ms:
            for group in (category[name], "all"):
                ratios.setdefault(group, []).append(slow / ms[name, "carried"])
    return {group: round(float(np.median(found)), 1) for group, found in ratios.items()}
