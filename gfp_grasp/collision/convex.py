"""Convex parts from points, kept only where MuJoCo compiles them, and which points lie within them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gfp_grasp.types import ConvexPart

# MuJoCo 3.17 refuses a mesh below 1e-15 m3 and a body whose inertia is below 1e-15 kg m2. A crumb of 0.5 mm passes both
# at the density of water, and stops no finger where it is missing.
MIN_VOLUME_M3 = 1e-10
MIN_THICKNESS_M = 1e-4


def convex_part(points: np.ndarray) -> ConvexPart | None:
    """Convex hull of (n, 3) points in m, outward; None where it is too flat or small for MuJoCo."""
    if len(points) < 4:
        return None
    centre = points.mean(0)
    local = points - centre
    try:
        hull = ConvexHull(local)
    except QhullError:  # fewer than four points that are not in one plane
        return None
    corners = local[hull.vertices]
    depths = corners @ hull.equations[:, :3].T + hull.equations[:, 3]
    thickness = -depths.min(0).max(initial=-np.inf)
    if hull.volume < MIN_VOLUME_M3 or thickness < MIN_THICKNESS_M:
        return None
    return ConvexPart(points[hull.vertices], _outward(local, hull))


def convex_parts(clouds: Iterable[np.ndarray]) -> tuple[tuple[ConvexPart, ...], int]:
    """Hulls of many point sets, and how many were dropped as slivers."""
    hulls = [convex_part(points) for points in clouds]
    kept = tuple(part for part in hulls if part is not None)
    return kept, len(hulls) - len(kept)


def within_parts(points: np.ndarray, parts: Sequence[ConvexPart], *, margin_m: float = 0.0) -> np.ndarray:
    """Which points lie within which parts.

    Args:
        points: (n, 3) m.
        parts: p convex parts.
        margin_m: How far beyond every plane of a part still counts; negative for how deep a point must lie.

    Returns:
        (n, p) bool.
    """
    within = np.zeros((len(points), len(parts)), dtype=bool)
    if not parts:
        return within
    low, high = (np.stack([end(part.vertices, axis=0) for part in parts]) for end in (np.min, np.max))
    near_box = np.all((points[:, None] >= low - margin_m) & (points[:, None] <= high + margin_m), axis=2)
    normals, offsets, bounds = _planes(parts)
    for index in np.flatnonzero(near_box.any(axis=0)):
        near, own = np.flatnonzero(near_box[:, index]), slice(bounds[index], bounds[index + 1])
        within[near, index] = (points[near] @ normals[own].T - offsets[own]).max(axis=1) <= margin_m
    return within


def volume_m3(part: ConvexPart) -> float:
    """Volume of a convex part."""
    triangles = part.vertices[part.faces] - part.vertices.mean(0)
    return float(np.linalg.det(triangles).sum() / 6)


def _outward(points: np.ndarray, hull: ConvexHull) -> np.ndarray:
    """Faces (q, 3) of a hull around the origin, numbered by its corners, wound so that their normals point outward."""
    faces = hull.simplices
    inward = np.linalg.det(points[faces]) < 0
    faces = np.where(inward[:, None], faces[:, ::-1], faces)
    number = np.empty(len(points), dtype=np.int64)
    number[hull.vertices] = np.arange(len(hull.vertices))
    return number[faces]


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
