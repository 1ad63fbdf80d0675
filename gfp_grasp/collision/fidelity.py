"""How far the surface of a union of convex parts lies from a mesh."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.collision.convex import Halfspaces, six_volumes
from gfp_grasp.types import ConvexPart

# Faces on which two parts meet are no surface of the union. They are told by a step outward that lands in the
# neighbour; it is a share of the diagonal, and bridges the hairline cracks that carrying opens.
_STEP = 2e-3
_NEIGHBOURS = 8
# Fewer on the parts, and the triangle that is nearest may not be among those of the nearest anchors.
_LEAST_ANCHORS = 2000
_R2 = (0.7548776662466927, 0.5698402909980532)


def union_error_m(
    parts: Sequence[ConvexPart],
    mesh: trimesh.Trimesh,
    *,
    count: int = 2000,
    rng: np.random.Generator,
    planes: Halfspaces | None = None,
) -> tuple[float, float, float]:
    """Two-sided distance between the surface of the parts' union and a mesh.

    Samples lie on both surfaces; each is measured to the triangles of the other whose centroids or samples are nearest,
    so that the spacing of the samples does not count as error, but for a little where triangles are much longer than
    it. Surfaces of parts within other parts are left out.

    Args:
        parts: Convex parts, m.
        mesh: In the same frame.
        count: Samples on each surface.
        rng: Source of the samples.
        planes: Of the parts, where they are at hand.

    Returns:
        Mean, 95 % and largest distance, m, over both directions with equal weight.
    """
    step = _STEP * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    part_triangles = np.concatenate([part.vertices[part.faces] for part in parts])
    owner = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])
    anchors, triangle, sampled = _anchors(part_triangles, max(2 * count, _LEAST_ANCHORS), rng)
    planes = planes or Halfspaces.of(parts)
    inside = planes.within(anchors + step * _normals(part_triangles)[triangle])
    inside[np.arange(len(anchors)), owner[triangle]] = False
    seen = np.logical_not(inside.any(axis=1))
    if not seen[sampled].any():  # parts all within each other: nothing can be hidden but by rounding
        seen[:] = True
    of_union = anchors[seen & sampled]
    of_union = of_union[:: max(1, len(of_union) // (2 * count))]
    anchors, union_triangles = anchors[seen], part_triangles[triangle[seen]]

    mesh_triangles = np.asarray(mesh.triangles)
    mesh_anchors, triangle, sampled = _anchors(mesh_triangles, count, rng)
    of_mesh = mesh_anchors[sampled]
    to_mesh = _to_outside(of_union, mesh_anchors, mesh_triangles[triangle], deep_m=2 * step)
    feet, distance, _ = _feet(of_mesh, anchors, union_triangles)
    nearest = np.take_along_axis(feet, distance.argmin(axis=1)[:, None, None], axis=1)[:, 0]
    # A foot on the hidden stretch of a triangle is no surface: another foot that is, or the nearest anchor, stands in.
    hidden = np.flatnonzero(planes.within(nearest, margin_m=-step).any(axis=1))
    if len(hidden):
        unseen = planes.within(feet[hidden].reshape(-1, 3), margin_m=-step).any(axis=1).reshape(len(hidden), -1)
        to_anchor = KDTree(anchors).query(of_mesh[hidden])[0]
        distance[hidden] = np.where(unseen, to_anchor[:, None], np.minimum(distance[hidden], to_anchor[:, None]))
    to_union = distance.min(axis=1)
    return _mean_p95_max(to_mesh, to_union)


def volume_ratios(
    parts: Sequence[ConvexPart],
    mesh: trimesh.Trimesh,
    *,
    count: int = 4000,
    rng: np.random.Generator,
    planes: Halfspaces | None = None,
) -> tuple[float, float]:
    """Volume of the parts over the mesh's: their sum, and their union (by the mean of 1 / overlaps of count places)."""
    corners = np.concatenate([(part.vertices - part.vertices[0])[part.faces] for part in parts])
    sizes = np.array([len(part.faces) for part in parts])
    owner, apex = np.repeat(np.arange(len(parts)), sizes), np.stack([part.vertices[0] for part in parts])
    volume = np.maximum(six_volumes(corners), 0.0)
    chosen = rng.choice(len(volume), count, p=volume / volume.sum())
    weights = rng.dirichlet(np.ones(4), count)[:, 1:]
    places = apex[owner[chosen]] + np.einsum("ni,nij->nj", weights, corners[chosen])
    within = (planes or Halfspaces.of(parts)).within(places)
    within[np.arange(count), owner[chosen]] = True
    ratio = float(volume.sum() / 6 / mesh.volume)
    return ratio, ratio * float((1 / within.sum(axis=1)).mean())


def _anchors(triangles: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples by area, which large triangles have many of, then all centroids; their triangles; which are samples."""
    points, index = _samples(triangles, count, rng)
    anchors = np.concatenate([points, triangles.mean(axis=1)])
    owner = np.concatenate([index, np.arange(len(triangles))])
    return anchors, owner, np.arange(len(anchors)) < count


def _samples(triangles: np.ndarray, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    area = np.linalg.norm(_cross(triangles), axis=1)
    # Even steps through the area, and an R2 sequence within each triangle: a gap between independent draws would let a
    # point miss the triangle it lies on. Source: https://extremelearning.com.au/unreasonable-effectiveness-of-quasirandom-sequences
    steps = np.arange(count)
    index = np.minimum(np.searchsorted(np.cumsum(area), (steps + rng.random()) / count * area.sum()), len(area) - 1)
    u, v = ((rng.random() + steps * ratio) % 1 for ratio in _R2)
    u, v = np.sqrt(u)[:, None], v[:, None]
    a, b, c = (triangles[index, i] for i in range(3))
    return (1 - u) * a + u * (1 - v) * b + u * v * c, index


def _to_outside(points: np.ndarray, anchors: np.ndarray, triangles: np.ndarray, *, deep_m: float) -> np.ndarray:
    """Distances (m,) to a closed surface of those of the points that are not deeper within it than deep_m.

    Faces in there are cracks between parts, which nothing can reach; a hole in the union shows from the other side.
    """
    feet, distance, near = _feet(points, anchors, triangles)
    best = distance.argmin(axis=1)
    rows = np.arange(len(points))
    away = np.einsum("ni,ni->n", points - feet[rows, best], _normals(triangles[near[rows, best]]))
    distance = distance[rows, best]
    outside = ~((away < 0) & (distance > deep_m))
    return distance[outside] if outside.any() else distance


def _feet(points: np.ndarray, anchors: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nearest places (n, k, 3) to points on the triangles of their nearest anchors, distances and anchors (n, k)."""
    k = min(_NEIGHBOURS, len(anchors))
    near = np.reshape(KDTree(anchors).query(points, k=k)[1], (len(points), k))
    feet = trimesh.triangles.closest_point(triangles[near.ravel()], np.repeat(points, k, axis=0)).reshape(-1, k, 3)
    return feet, np.linalg.norm(feet - points[:, None], axis=2), near


def _cross(triangles: np.ndarray) -> np.ndarray:
    return np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])


def _normals(triangles: np.ndarray) -> np.ndarray:
    across = _cross(triangles)
    return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)


def _mean_p95_max(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    mean = (a.mean() + b.mean()) / 2
    p95 = max(np.percentile(a, 95), np.percentile(b, 95))
    return float(mean), float(p95), float(max(a.max(), b.max()))
