"""Bench of what must not change: `gfp-grasp bench stability`.

The same call twice gives the same bits; a cloud that was moved rigidly about up gives the moved answer.
"""

from __future__ import annotations

import warnings
from functools import partial
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.bench.views import view_object
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.errors import InvalidOption
from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes import ObjectSource, load_objects
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about


def bench_stability(
    objects: str = "all",
    *,
    motions: int = 200,
    limit: int = 20,
    seed: int = 0,
    workers: int = 1,
    progress=None,
) -> dict[str, Any]:
    """Complete each object twice, and after rigid motions about up.

    Args:
        objects: Procedural families with commas between or "all", or a folder of meshes.
        motions: Number of motions in all, shared out over the objects.
        limit: Most objects in all.
        seed: Seed of views and motions.
        workers: Number of processes.
        progress: Wraps the stream of objects.

    Returns:
        {"objects", "same_bits": whether every repeated call gave the same vertices, "motions", "moved_mm": median,
        95 % and largest over the motions of the mean surface distance between the moved answer and the answer to the
        moved cloud, "share_within_1_mm"}.
    """
    if motions < 1 or limit < 1:
        raise InvalidOption(f"{motions} motions of {limit} objects; at least one of each is expected")
    known = PrimitiveLibrary.shipped().categories
    sources = [s for s in load_objects(objects, limit=limit) if s.category in known]
    jobs = [(source, len(range(i, motions, len(sources))), i) for i, source in enumerate(sources)]
    answers = pmap(partial(_stability, seed=seed), jobs, workers=workers, progress=progress)
    moved_mm = np.concatenate([moved for _, moved in answers])
    return {
        "objects": len(sources),
        "same_bits": all(same for same, _ in answers),
        "motions": len(moved_mm),
        "moved_mm": [round(float(q), 4) for q in (*np.quantile(moved_mm, [0.5, 0.95]), moved_mm.max())],
        "share_within_1_mm": round(float((moved_mm < 1.0).mean()), 4),
    }


def _stability(job: tuple[ObjectSource, int, int], *, seed: int) -> tuple[bool, np.ndarray]:
    source, motions, number = job
    rng = np.random.default_rng([seed, number])
    cloud = view_object(source.load_mesh(), rng).cloud
    assert cloud.viewpoint is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        first, again = (complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint).mesh for _ in range(2))
        moved_mm = []
        for _ in range(motions):
            T = make_T(rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)), rng.uniform(-2, 2, 3))
            points, place = apply_T(T, cloud.points), apply_T(T, cloud.viewpoint)
            back = complete_to_mesh(points, viewpoint=place).mesh.copy()
            back.apply_transform(invert_T(T))
            moved_mm.append(1000 * _apart_m(first, back))
    return bool(np.array_equal(first.vertices, again.vertices)), np.array(moved_mm)


def _apart_m(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    """Mean distance of the vertices of each from the surface of the other."""

    def one_way(points: np.ndarray, mesh: trimesh.Trimesh) -> float:
        return float(trimesh.proximity.closest_point(mesh, points)[1].mean())

    return 0.5 * (one_way(np.asarray(a.vertices), b) + one_way(np.asarray(b.vertices), a))
