"""Convex parts from points, kept only where MuJoCo compiles them, and which points lie within them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache
from itertools import product

import manifold3d
import numpy as np
from scipy.spatial import ConvexHull

from gfp_grasp.collision.parts import NEEDLE, area_vectors, lengths, six_volumes
from gfp_grasp.types import CollisionMesh, ConvexPart

# MuJoCo 3.17 refuses a mesh below 1e-15 m3 and a body whose inertia is below 1e-15 kg m2. A crumb of 0.5 mm passes both
# at the density of water, and stops no finger where it is missing.
MIN_VOLUME_M3 = 1e-10
MIN_THICKNESS_M = 1e-4
_WAYS = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
_FOLDED = 1e-9  # of the volume: a face that looks away from the centre by less does so by rounding
_MANY = 4  # directions looked into for each corner that is kept


def convex_part(points: np.ndarray, *, max_vertices: int | None = None) -> ConvexPart | None:
    """Convex hull of (n, 3) points in m, outward; None where it is too flat or small for MuJoCo.

    With max_vertices, at least 4, the hull of so many of its corners.
    """
    kept, _ = convex_parts([points], max_vertices=max_vertices)
    return kept[0] if kept else None


def within_bounds(collision: CollisionMesh, bounds: np.ndarray) -> CollisionMesh:
    """The same with parts that keep to half-spaces (k, 4), unit normal and offset: normal @ x <= offset, m.

    What of a part lies beyond is put into the plane; a part of which nothing solid is left falls away.
    """
    parts: list[ConvexPart] = []
    for part in collision.parts:
        points = part.vertices
        for normal, offset in zip(bounds[:, :3], bounds[:, 3], strict=True):
            beyond = points @ normal - offset
            if beyond.max() > 0.0:
                points = points - np.maximum(beyond, 0.0)[:, None] * normal
        kept = part if points is part.vertices else convex_part(points)
        if kept is not None:
            parts.append(kept)
    return replace(collision, parts=tuple(parts)) if parts else collision


def convex_parts(
    clouds: Iterable[np.ndarray], *, max_vertices: int | None = None
) -> tuple[tuple[ConvexPart, ...], int]:
    """Hulls of many point sets (n, 3) m, and how many of them were dropped as slivers."""
    hulls = []
    for points in clouds:
        centre = points.mean(axis=0)
        corners, faces = _hull(points - centre)
        if max_vertices is not None and len(corners) > max_vertices:
            corners, faces = _hull(fewer_corners(corners, max_vertices))
        hulls.append((corners, faces, centre))
    kept = _sound([hull for hull in hulls if len(hull[0])])
    return kept, len(hulls) - len(kept)


def _sound(hulls: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> tuple[ConvexPart, ...]:
    """The parts of those hulls (corners, faces, centre) that MuJoCo compiles. One pass, because each hull is small."""
    if not hulls:
        return ()
    triangles = np.concatenate([corners[faces] for corners, faces, _ in hulls])
    starts = np.cumsum([0, *(len(faces) for _, faces, _ in hulls[:-1])])
    vectors = area_vectors(triangles)
    from_centre = np.einsum("ni,ni->n", triangles[:, 0], vectors)
    volume = np.add.reduceat(from_centre, starts) / 3
    thin = volume < MIN_THICKNESS_M * np.add.reduceat(lengths(vectors), starts)  # else no width is below the least
    solid = volume >= MIN_VOLUME_M3
    for i in np.flatnonzero(thin & solid):
        solid[i] = _thickness_m(*hulls[int(i)][:2]) >= MIN_THICKNESS_M
    folded = np.minimum.reduceat(from_centre, starts) < -_FOLDED * volume
    return tuple(
        ConvexPart(*_unfolded(corners + centre) if folded[i] else (corners + centre, faces))
        for i, (corners, faces, centre) in enumerate(hulls)
        if solid[i]
    )


def _unfolded(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners and outward faces of the hull as Qhull makes it: Manifold's may fold at a corner almost on an edge."""
    hull = ConvexHull(points)
    used, faces = np.unique(hull.simplices, return_inverse=True)
    corners, faces = points[used], faces.reshape(-1, 3)
    inwards = np.einsum("ni,ni->n", area_vectors(corners[faces]), hull.equations[:, :3]) < 0
    faces[inwards] = faces[inwards][:, ::-1]
    return corners, faces


def _thickness_m(corners: np.ndarray, faces: np.ndarray) -> float:
    normals, offsets = _planes(corners[faces])
    return float((offsets[:, None] - normals @ corners.T).max(axis=1).min())


def _planes(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (k, 3) and offsets (k,) m of those triangles that are no needles."""
    vectors = area_vectors(triangles)
    areas = lengths(vectors)
    broad = areas > NEEDLE * areas.max()
    normals = vectors[broad] / areas[broad, None]
    return normals, np.einsum("ni,ni->n", normals, triangles[broad, 0])


def farthest_corners(points: np.ndarray) -> np.ndarray:
    """Which of (n, 3) points lie farthest along the ways to the middles of a cube's sides, edges and corners.

    Returns:
        Indices (k,), ascending, k at most 26.
    """
    return np.unique((points @ _WAYS.T).argmax(axis=0))


def needed_corners(points: np.ndarray, tolerance_m: float) -> np.ndarray:
    """A few of (n, 3) points in m whose hull holds all others, or misses them by at most a tolerance.

    Returns:
        Indices (k,), ascending; those of all points where their hull is flat or smaller than MuJoCo accepts.
    """
    centred = points - points.mean(axis=0)
    kept = farthest_corners(centred)
    while True:
        corners, faces = _hull(centred[kept])
        triangles = corners[faces]
        if six_volumes(triangles).sum() <= 6 * MIN_VOLUME_M3:
            return np.arange(len(points))
        normals, offsets = _planes(triangles)
        heights = normals @ centred.T - offsets[:, None]
        beyond = heights.max(axis=0)
        farthest = np.unique(heights.argmax(axis=1))
        farthest = np.setdiff1d(farthest[beyond[farthest] > tolerance_m], kept)
        if not len(farthest):
            return kept
        # A few at once: each of them brings others in.
        farthest = farthest[np.argsort(-beyond[farthest], kind="stable")][: 1 + len(farthest) // 4]
        kept = np.union1d(kept, farthest)


def _hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 3) and faces (f, 3) int, outward, of the hull of (m, 3) points; none where they are flat."""
    if len(points) < 4:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    # Manifold's takes half the time of Qhull's, on few points.
    mesh = manifold3d.Manifold.hull_points(np.ascontiguousarray(points, dtype=np.float64)).to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64)


def fewer_corners(corners: np.ndarray, count: int) -> np.ndarray:
    """A given number of corners that keep much of a hull's volume.

    Args:
        corners: (n, 3) m, all corners of the hull, not in one plane.
        count: Number of corners to keep; at least 4, less than n.

    Returns:
        (count, 3) m, the corners that are kept, in their order.
    """
    centred = corners - corners.mean(axis=0)
    # First come the corners that are farthest in evenly spread directions. Several directions may share a corner; then
    # come those that are farthest in most of many directions, where the hull bends most.
    chosen = list(dict.fromkeys((_directions(count) @ centred.T).argmax(axis=1).tolist()))
    many = np.bincount((_directions(_MANY * count) @ centred.T).argmax(axis=1), minlength=len(corners))
    many[chosen] = -1
    chosen += np.argsort(-many, kind="stable")[: count - len(chosen)].tolist()
    own = centred[chosen] - centred[chosen].mean(axis=0)
    if np.linalg.matrix_rank(own) < 3:
        chosen[-1] = _farthest_from_flat(centred, chosen[:-1])
    return corners[sorted(chosen)]


def _farthest_from_flat(points: np.ndarray, chosen: list[int]) -> int:
    """The point that is farthest from the line or plane of those chosen."""
    own = points[chosen] - points[chosen].mean(axis=0)
    _, spread, axes = np.linalg.svd(own, full_matrices=True)
    flat = axes[np.append(spread, np.zeros(3 - len(spread))) <= 1e-9 * max(float(spread.max(initial=0)), 1e-12)]
    flat = flat if len(flat) else axes[-1:]
    distance = np.linalg.norm((points - points[chosen].mean(axis=0)) @ flat.T, axis=1)
    distance[chosen] = -np.inf
    return int(distance.argmax())


@cache
def _directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors, spread evenly: a Fibonacci spiral."""
    height = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - height**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])
