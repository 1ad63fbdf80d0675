"""Convex parts from points, kept only where MuJoCo compiles them, and which points lie within them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import manifold3d
import numpy as np

from gfp_grasp.collision.budget import fewer_corners
from gfp_grasp.types import ConvexPart

# MuJoCo 3.17 refuses a mesh below 1e-15 m3 and a body whose inertia is below 1e-15 kg m2. A crumb of 0.5 mm passes both
# at the density of water, and stops no finger where it is missing.
MIN_VOLUME_M3 = 1e-10
MIN_THICKNESS_M = 1e-4
_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]


def convex_part(points: np.ndarray, *, max_vertices: int | None = None) -> ConvexPart | None:
    """Convex hull of (n, 3) points in m, outward; None where it is too flat or small for MuJoCo.

    With max_vertices, at least 4, the hull of so many of its corners.
    """
    centre = points.mean(axis=0)
    corners, faces = _hull(points - centre)
    if max_vertices is not None and len(corners) > max_vertices:
        corners, faces = _hull(fewer_corners(corners, max_vertices))
    if len(corners) < 4:
        return None
    a, b, c = (corners[faces[:, i]] for i in range(3))
    across = _cross(b - a, c - a)
    areas2 = np.linalg.norm(across, axis=1)
    volume = float((a * across).sum()) / 6
    if volume < MIN_VOLUME_M3:
        return None
    if volume < MIN_THICKNESS_M * areas2.sum() / 2:  # else no width is below the least
        solid = areas2 > 1e-9 * areas2.max()  # the direction of a needle is rounding only
        normals = across[solid] / areas2[solid, None]
        depths = (normals * a[solid]).sum(axis=1)[:, None] - normals @ corners.T
        if depths.max(axis=1).min() < MIN_THICKNESS_M:
            return None
    return ConvexPart(corners + centre, faces)


def _hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 3) and faces (f, 3) int, outward, of the hull of (m, 3) points; none where they are flat."""
    if len(points) < 4:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    # Manifold's takes half the time of Qhull's, on few points.
    mesh = manifold3d.Manifold.hull_points(np.ascontiguousarray(points, dtype=np.float64)).to_mesh64()
    return np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, dtype=np.int64)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products (n, 3); numpy's own takes thrice as long on so few."""
    return a[:, _NEXT] * b[:, _AFTER] - a[:, _AFTER] * b[:, _NEXT]


def convex_parts(
    clouds: Iterable[np.ndarray], *, max_vertices: int | None = None
) -> tuple[tuple[ConvexPart, ...], int]:
    """Hulls of many point sets, and how many were dropped as slivers."""
    hulls = [convex_part(points, max_vertices=max_vertices) for points in clouds]
    kept = tuple(part for part in hulls if part is not None)
    return kept, len(hulls) - len(kept)


@dataclass(frozen=True, eq=False)
class Halfspaces:
    """The planes of p convex parts, to be asked many times.

    Attributes:
        low: (p, 3) m, lower corner of the box of each part.
        high: (p, 3) m, its upper corner.
        normals: (q, 3) unit, outward, of all faces.
        offsets: (q,) m.
        bounds: (p + 1,) where the faces of each part begin.
    """

    low: np.ndarray
    high: np.ndarray
    normals: np.ndarray
    offsets: np.ndarray
    bounds: np.ndarray

    @staticmethod
    def of(parts: Sequence[ConvexPart]) -> Halfspaces:
        """Those of at least one part."""
        low, high = (np.stack([end(part.vertices, axis=0) for part in parts]) for end in (np.min, np.max))
        return Halfspaces(low, high, *_planes(parts))

    def within(self, points: np.ndarray, *, margin_m: float = 0.0) -> np.ndarray:
        """Which points (n, 3) m lie within which parts, (n, p) bool; `within_parts` tells of the margin."""
        near = np.ones((len(points), len(self.low)), dtype=bool)
        for axis in range(3):  # one axis after the other: a reduction over a last axis of three is slow
            near &= points[:, axis, None] >= self.low[:, axis] - margin_m
            near &= points[:, axis, None] <= self.high[:, axis] + margin_m
        for part in np.flatnonzero(near.any(axis=0)):
            asked = np.flatnonzero(near[:, part])
            near[asked, part] = self.height(points[asked], int(part)) <= margin_m
        return near

    def height(self, points: np.ndarray, part: int) -> np.ndarray:
        """Height (n,) m of points (n, 3) over the plane of a part that they are farthest out of; negative within."""
        own = slice(self.bounds[part], self.bounds[part + 1])
        return (points @ self.normals[own].T - self.offsets[own]).max(axis=1)


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
    return Halfspaces.of(parts).within(points, margin_m=margin_m)


def volume_m3(part: ConvexPart) -> float:
    """Volume of a convex part."""
    return float(six_volumes((part.vertices - part.vertices[0])[part.faces]).sum()) / 6


def six_volumes(corners: np.ndarray) -> np.ndarray:
    """Determinants (n,) of (n, 3, 3): six times the volume of the tetrahedron over the origin."""
    return np.einsum("ni,ni->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))


def _planes(parts: Sequence[ConvexPart]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit outward normals (q, 3) and offsets (q,) m of all faces, and where those of each part begin (p + 1,)."""
    triangles = np.concatenate([part.vertices[part.faces] for part in parts])
    owner = np.repeat(np.arange(len(parts)), [len(part.faces) for part in parts])
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(across, axis=1)
    longest = np.zeros(len(parts))
    np.maximum.at(longest, owner, length)
    solid = length > 1e-9 * longest[owner]  # the direction of a needle is rounding only
    normals = across[solid] / length[solid, None]
    bounds = np.searchsorted(owner[solid], np.arange(len(parts) + 1))
    return normals, np.einsum("ij,ij->i", normals, triangles[solid, 0]), bounds
