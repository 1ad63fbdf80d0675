"""Convex parts from points, kept only where MuJoCo compiles them, and which points lie within them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product

import manifold3d
import numpy as np
from scipy.spatial import ConvexHull

from gfp_grasp.collision.budget import fewer_corners
from gfp_grasp.types import ConvexPart

# MuJoCo 3.17 refuses a mesh below 1e-15 m3 and a body whose inertia is below 1e-15 kg m2. A crumb of 0.5 mm passes both
# at the density of water, and stops no finger where it is missing.
MIN_VOLUME_M3 = 1e-10
MIN_THICKNESS_M = 1e-4
_NEEDLE = 1e-9  # of the largest face of its part: a face so small has no direction but rounding
_WAYS = np.array([way for way in product((-1.0, 0.0, 1.0), repeat=3) if any(way)])
_FOLDED = 1e-9  # of the volume: a face that looks away from the centre by less does so by rounding
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]


def convex_part(points: np.ndarray, *, max_vertices: int | None = None) -> ConvexPart | None:
    """Convex hull of (n, 3) points in m, outward; None where it is too flat or small for MuJoCo.

    With max_vertices, at least 4, the hull of so many of its corners.
    """
    kept, _ = convex_parts([points], max_vertices=max_vertices)
    return kept[0] if kept else None


def convex_parts(
    clouds: Iterable[np.ndarray], *, max_vertices: int | None = None
) -> tuple[tuple[ConvexPart, ...], int]:
    """Hulls of many point sets, and how many were dropped as slivers."""
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
    """Of hulls (corners, faces, centre), those that MuJoCo compiles; all at once, as each of them is small."""
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
    broad = areas > _NEEDLE * areas.max()
    normals = vectors[broad] / areas[broad, None]
    return normals, np.einsum("ni,ni->n", normals, triangles[broad, 0])


def needed_corners(points: np.ndarray, tolerance_m: float) -> np.ndarray:
    """Which few of (n, 3) points in m have a hull that all others are in, or out of by at most a tolerance.

    Returns:
        Index (k,), ascending; all of them where they are flat or less than MuJoCo takes.
    """
    centred = points - points.mean(axis=0)
    kept = np.unique((centred @ _WAYS.T).argmax(axis=0))
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


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products (n, 3); numpy's own takes thrice as long on so few."""
    return a[:, _NEXT] * b[:, _AFTER] - a[:, _AFTER] * b[:, _NEXT]


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Lengths (n,) of (n, 3); numpy's own take thrice as long."""
    return np.sqrt(np.einsum("ni,ni->n", vectors, vectors))


@dataclass(frozen=True, eq=False)
class PartFaces:
    """All faces of p convex parts, to be asked many times.

    Attributes:
        triangles: (f, 3, 3) m.
        owner: (f,) part of each.
        normals: (f, 3) outward, of length 1, or shorter for needles, whose direction is rounding only.
        areas_m2: (f,).
        planes: (f, 4) what a place (x, y, z, 1), m, is multiplied with for its height over each.
        bounds: (p + 1,) where the faces of each part begin.
        low: (p, 3) m, lower corner of the box of each part.
        high: (p, 3) m, its upper corner.
    """

    triangles: np.ndarray
    owner: np.ndarray
    normals: np.ndarray
    areas_m2: np.ndarray
    planes: np.ndarray
    bounds: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @staticmethod
    def of(parts: Sequence[ConvexPart]) -> PartFaces:
        """Those of at least one part."""
        sizes = [len(part.faces) for part in parts]
        bounds = np.concatenate([[0], np.cumsum(sizes)])
        starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
        vertices = np.concatenate([part.vertices for part in parts])
        faces = np.concatenate([part.faces for part in parts]) + np.repeat(starts, sizes)[:, None]
        low, high = (end.reduceat(vertices, starts, axis=0) for end in (np.minimum, np.maximum))
        triangles = vertices[faces]
        owner = np.repeat(np.arange(len(parts)), sizes)
        vectors = area_vectors(triangles)
        areas = lengths(vectors)
        needle = areas <= _NEEDLE * np.maximum.reduceat(areas, bounds[:-1])[owner]
        normals = vectors / np.where(needle, np.inf, areas)[:, None]
        offsets = np.einsum("ni,ni->n", normals, triangles[:, 0])
        offsets[needle] = np.inf  # nothing is above it
        planes = np.column_stack([normals, -offsets])
        return PartFaces(triangles, owner, normals, areas, planes, bounds, low, high)

    def within(self, points: np.ndarray, *, margin_m: float = 0.0) -> np.ndarray:
        """Which points (n, 3) m lie within which parts, (p, n) bool; `within_parts` tells of the margin."""
        places = _homogeneous(points)
        near = np.ones((len(self.low), len(points)), dtype=bool)
        for axis in range(3):  # a reduction over an axis of three is slow
            near &= places[axis] >= self.low[:, axis, None] - margin_m
            near &= places[axis] <= self.high[:, axis, None] + margin_m
        for part in np.flatnonzero(near.any(axis=1)):
            asked = np.flatnonzero(near[part])
            near[part, asked] = self._height(places[:, asked], int(part)) <= margin_m
        return near

    def height(self, points: np.ndarray, part: int) -> np.ndarray:
        """Height (n,) m of points (n, 3) over the plane of a part that they are farthest out of; negative within."""
        return self._height(_homogeneous(points), part)

    def _height(self, places: np.ndarray, part: int) -> np.ndarray:
        # In four dimensions with the offset: a product over three takes eight times as long.
        return (self.planes[self.bounds[part] : self.bounds[part + 1]] @ places).max(axis=0)


def _homogeneous(points: np.ndarray) -> np.ndarray:
    return np.vstack([points.T, np.ones(len(points))])


def within_parts(points: np.ndarray, parts: Sequence[ConvexPart], *, margin_m: float = 0.0) -> np.ndarray:
    """Which points lie within which parts.

    Args:
        points: (n, 3) m.
        parts: p convex parts.
        margin_m: How far beyond every plane of a part still counts; negative for how deep a point must lie.

    Returns:
        (n, p) bool.
    """
    if not parts:
        return np.zeros((len(points), 0), dtype=bool)
    return PartFaces.of(parts).within(points, margin_m=margin_m).T


def volume_m3(part: ConvexPart) -> float:
    """Volume of a convex part."""
    return float(six_volumes((part.vertices - part.vertices[0])[part.faces]).sum()) / 6


def six_volumes(corners: np.ndarray) -> np.ndarray:
    """Determinants (n,) of (n, 3, 3): six times the volume of the tetrahedron over the origin."""
    return np.einsum("ni,ni->n", corners[:, 0], cross(corners[:, 1], corners[:, 2]))


def area_vectors(triangles: np.ndarray) -> np.ndarray:
    """Normals (n, 3) of triangles (n, 3, 3), as long as the area, m2."""
    return cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]) / 2
