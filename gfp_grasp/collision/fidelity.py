"""How true convex parts are to a mesh: how far their union's surface lies from it, whether its hollow stays open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh
from scipy.spatial import ConvexHull, KDTree, QhullError

from gfp_grasp.collision.parts import PartFaces, area_vectors, diagonal_m, lengths, six_volumes
from gfp_grasp.types import ConvexPart

# Faces on which two parts meet are no surface of the union: a step outward from them ends in the neighbour. The step is
# a share of the diagonal, and bridges the hairline cracks that a deformation opens.
_STEP = 2e-3
_NEIGHBOURS = 8
_MORE_NEIGHBOURS = 64
# With fewer anchors on the parts, the nearest triangle may not be among those of the nearest anchors.
_LEAST_ANCHORS = 2000
_R2 = (0.7548776662466927, 0.5698402909980532)


def union_error_m(
    parts: Sequence[ConvexPart] | PartFaces, mesh: trimesh.Trimesh, *, count: int = 2000, rng: np.random.Generator
) -> tuple[float, float, float]:
    """Two-sided distance between the surface of the parts' union and a mesh.

    Samples lie on both surfaces; each is measured to the triangles of the other whose centroids or samples are nearest,
    so that the spacing of the samples does not count as error, but for a little where triangles are much longer than
    it. Surfaces of parts within other parts are left out.

    Args:
        parts: Convex parts, m, or their faces where they are at hand.
        mesh: In the same frame.
        count: Samples on each surface.
        rng: Source of the samples.

    Returns:
        Mean, 95 % and largest distance, m, over both directions with equal weight.
    """
    step = _STEP * diagonal_m(mesh.vertices)
    faces = parts if isinstance(parts, PartFaces) else PartFaces.of(parts)
    num = max(2 * count, _LEAST_ANCHORS)
    anchors, triangle = _anchors(faces.triangles, faces.areas_m2, num, rng)
    union = _Surface(anchors, faces.triangles[triangle])
    chosen = np.arange(0, num, max(1, num // (3 * count // 2)))  # of which some half are hidden
    inside = faces.within(anchors[chosen] + step * faces.normals[triangle[chosen]])
    inside[faces.owner[triangle[chosen]], np.arange(len(chosen))] = False
    seen = np.logical_not(inside.any(axis=0))
    if not seen.any():  # parts all within each other: nothing can be hidden but by rounding
        seen[:] = True
    of_union = anchors[chosen[seen]]

    triangles = np.asarray(mesh.vertices)[mesh.faces]
    anchors, triangle = _anchors(triangles, lengths(area_vectors(triangles)), count, rng)
    to_mesh = _to_outside(of_union, _Surface(anchors, triangles[triangle]), deep_m=2 * step)
    return _mean_p95_max(to_mesh, _to_union(anchors[:count], union, faces, of_union, step))


def volume_ratios(
    parts: Sequence[ConvexPart] | PartFaces, mesh: trimesh.Trimesh, *, count: int = 4000, rng: np.random.Generator
) -> tuple[float, float]:
    """Volume of the parts over that of the mesh.

    Args:
        parts: Convex parts, m, or their faces where they are at hand.
        mesh: Watertight, in the same frame.
        count: Number of random places at which overlaps are counted.
        rng: Source of these places.

    Returns:
        Ratio of the summed volume, and of the volume of the union (the mean of 1 / overlaps over the places).
    """
    faces = parts if isinstance(parts, PartFaces) else PartFaces.of(parts)
    apex = faces.triangles[faces.bounds[:-1], 0]
    corners = faces.triangles - apex[faces.owner][:, None]
    volume = np.maximum(six_volumes(corners), 0.0)
    chosen = rng.choice(len(volume), count, p=volume / volume.sum())
    weights = rng.dirichlet(np.ones(4), count)[:, 1:]
    places = apex[faces.owner[chosen]] + np.einsum("ni,nij->nj", weights, corners[chosen])
    within = faces.within(places)
    within[faces.owner[chosen], np.arange(count)] = True
    ratio = float(volume.sum() / 6 / mesh.volume)
    return ratio, ratio * float((1 / within.sum(axis=0)).mean())


@dataclass(frozen=True, eq=False)
class _Surface:
    """Places (n, 3) m all over a surface, and the triangle (n, 3, 3) that each lies on."""

    anchors: np.ndarray
    triangles: np.ndarray

    @cached_property
    def tree(self) -> KDTree:
        return KDTree(self.anchors, balanced_tree=False, compact_nodes=False)

    def feet(self, points: np.ndarray, *, count: int = _NEIGHBOURS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Nearest places (n, k, 3) on the triangles of the nearest anchors, distances and anchors (n, k)."""
        k = min(count, len(self.anchors))
        near = np.reshape(self.tree.query(points, k=k)[1], (len(points), k))
        feet = trimesh.triangles.closest_point(self.triangles[near.ravel()], np.repeat(points, k, axis=0))
        feet = feet.reshape(-1, k, 3)
        return feet, lengths((feet - points[:, None]).reshape(-1, 3)).reshape(-1, k), near


def _anchors(
    triangles: np.ndarray, areas: np.ndarray, count: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Samples by area, which large triangles have many of, then all centroids; and their triangles."""
    # Even steps through the area, and an R2 sequence within each triangle: a gap between independent draws would let a
    # point miss the triangle it lies on. Source: https://extremelearning.com.au/unreasonable-effectiveness-of-quasirandom-sequences
    steps, total = np.arange(count), np.cumsum(areas)
    index = np.minimum(np.searchsorted(total, (steps + rng.random()) / count * total[-1]), len(areas) - 1)
    u, v = ((rng.random() + steps * ratio) % 1 for ratio in _R2)
    u, v = np.sqrt(u)[:, None], v[:, None]
    a, b, c = (triangles[:, i] for i in range(3))
    samples = (1 - u) * a[index] + u * (1 - v) * b[index] + u * v * c[index]
    return np.concatenate([samples, (a + b + c) / 3]), np.concatenate([index, np.arange(len(areas))])


def _to_outside(points: np.ndarray, surface: _Surface, *, deep_m: float) -> np.ndarray:
    """Distances (m,) to a closed surface of those of the points that are not deeper within it than deep_m.

    Faces in there are cracks between parts, which nothing can reach; a hole in the union shows from the other side.
    """
    feet, distance, near = surface.feet(points)
    best = distance.argmin(axis=1)
    rows = np.arange(len(points))
    away = np.einsum("ni,ni->n", points - feet[rows, best], area_vectors(surface.triangles[near[rows, best]]))
    distance = distance[rows, best]
    outside = ~((away < 0) & (distance > deep_m))
    return distance[outside] if outside.any() else distance


def _to_union(points: np.ndarray, union: _Surface, faces: PartFaces, of_union: np.ndarray, step: float) -> np.ndarray:
    """Distances (n,) to the surface of a union of parts, where a foot within another part is none."""
    feet, distance, _ = union.feet(points)
    nearest = np.take_along_axis(feet, distance.argmin(axis=1)[:, None, None], axis=1)[:, 0]
    found = distance.min(axis=1)
    hidden = np.flatnonzero(faces.within(nearest, margin_m=-step).any(axis=0))
    for count in (_NEIGHBOURS, _MORE_NEIGHBOURS):
        if not len(hidden):
            return found
        feet, distance, _ = union.feet(points[hidden], count=count)
        unseen = faces.within(feet.reshape(-1, 3), margin_m=-step).any(axis=0).reshape(distance.shape)
        found[hidden] = np.where(unseen, np.inf, distance).min(axis=1)
        hidden = hidden[np.isinf(found[hidden])]
    found[hidden] = KDTree(of_union).query(points[hidden])[0]
    return found


def _mean_p95_max(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    mean = (a.mean() + b.mean()) / 2
    p95 = max(np.percentile(a, 95), np.percentile(b, 95))
    return float(mean), float(p95), float(max(a.max(), b.max()))


_DRAWN = 6000
LEAST_BALL = 1 / 40  # of the diagonal, 5 mm of a mesh of 0.2 m: what no larger ball fits into is a dent
_AROUND = 1.5  # vertices within this many radii hold the centre of a ball in place
_HOLDERS = 64


def widest_gap(mesh: trimesh.Trimesh, *, seed: int = 0) -> np.ndarray | None:
    """Centre of a large ball outside a mesh whose centre lies within the mesh's convex hull, as in a cup.

    Args:
        mesh: Watertight, m.
        seed: Chooses the places that are tried.

    Returns:
        (3,) m; None where no ball has a radius of more than a fortieth of the mesh's diagonal.
    """
    rng = np.random.default_rng(seed)
    try:
        planes = ConvexHull(mesh.vertices).equations
    except QhullError:
        return None
    surface = KDTree(np.concatenate([mesh.vertices, mesh.triangles_center]))
    best, radius, least = mesh.bounds.mean(axis=0), 0.0, LEAST_BALL * diagonal_m(mesh.vertices)
    low, high = mesh.bounds
    for _ in range(3):  # around the best place of those before
        places = rng.uniform(low, high, (_DRAWN, 3))
        distance = surface.query(places)[0]
        wider = np.flatnonzero(distance > radius)
        wider = wider[np.argsort(-distance[wider], kind="stable")]
        # The widest alone counts, and it is soon found: a few are looked at, then ever more.
        for some in np.split(wider, [50, 250, 1250]):
            some = some[(places[some] @ planes[:, :3].T + planes[:, 3]).max(axis=1, initial=-np.inf) < 0]
            some = some[~mesh.contains(places[some])] if len(some) else some
            if len(some):
                best, radius = places[some[0]], float(distance[some[0]])
                break
        low, high = best - max(radius, least), best + max(radius, least)
    return best if radius > least else None


def barycentric_hold(point: np.ndarray, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices around a point, and the weights with which the point follows them.

    Returns:
        Indices (n,) and weights (n,), which sum to one.
    """
    distance = np.linalg.norm(vertices - point, axis=1)
    near = np.flatnonzero(distance < _AROUND * distance.min())
    if len(near) < _HOLDERS:
        near = np.argsort(distance)[:_HOLDERS]
    here = np.vstack([vertices[near].T, np.ones(len(near))])
    return near, np.linalg.lstsq(here, np.append(point, 1.0), rcond=None)[0]


def ball_radii_m(centre: np.ndarray, mesh: trimesh.Trimesh, parts: PartFaces) -> tuple[float, float]:
    """Radius, m, of the largest ball around a centre (3,) m that a mesh leaves free, and that its parts leave free."""
    free = _clearance_m(centre, np.asarray(mesh.vertices)[mesh.faces])
    return free, 0.0 if parts.within(centre[None]).any() else _clearance_m(centre, parts.triangles)


def _clearance_m(point: np.ndarray, triangles: np.ndarray) -> float:
    # A triangle lies within the ball around its centroid that reaches its farthest corner.
    middle = (triangles[:, 0] + triangles[:, 1] + triangles[:, 2]) / 3
    arms = triangles - middle[:, None]
    reach = np.sqrt(np.einsum("nij,nij->ni", arms, arms).max(axis=1))
    distance = lengths(middle - point)
    near = triangles[distance - reach <= distance.min()]
    feet = trimesh.triangles.closest_point(near, np.broadcast_to(point, (len(near), 3)))
    return float(lengths(feet - point).min())
