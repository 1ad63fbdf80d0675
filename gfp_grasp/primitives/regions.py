"""Regions of a primitive (outside, inside and a handle), its symmetry, and the same body without a part."""

from __future__ import annotations

import math

import numpy as np
import trimesh

from gfp_grasp.errors import BuildFailed
from gfp_grasp.meshes import crossing_faces, vertex_normals
from gfp_grasp.primitives.surface import Surface
from gfp_grasp.transforms import rotation_about
from gfp_grasp.types import BODY_REGIONS, INSIDE, OUTSIDE, Symmetry

_UP = np.array([0.0, 0.0, 1.0])
# Rays per vertex that look for a way out to the side or downwards.
_NUM_DIRECTIONS = 64
# What stands out of the body by more than this share of the diagonal is a handle.
_STAND_OUT = 0.012
# Turns that tell a body of revolution from one of any small order.
_ODD_TURNS = np.radians([17.0, 37.0, 61.0])
_ORDERS = (6, 5, 4, 3, 2)
# The farthest 2 % of a surface may be this many times farther away than the mean.
_FAR = 4.0


def label_regions(mesh: trimesh.Trimesh) -> tuple[np.ndarray, tuple[str, ...]]:
    """Regions of an upright mesh, whose handle, if it has one, points towards +x.

    A vertex is inside where no ray that leaves it sideways or downwards gets away: it is reached through the opening
    only. On a mesh with a hole through it, the handle is what lies outside of the mirror image of the body's other
    side.

    Returns:
        (v,) uint8, index of each vertex's region, and the names of the regions.
    """
    regions = np.full(len(mesh.vertices), OUTSIDE, dtype=np.uint8)
    regions[enclosed(mesh)] = INSIDE
    if mesh.euler_number > 0:
        return regions, BODY_REGIONS
    regions[_stands_out(mesh, regions)] = len(BODY_REGIONS)
    return regions, (*BODY_REGIONS, "handle") if regions.max() >= len(BODY_REGIONS) else BODY_REGIONS


def enclosed(mesh: trimesh.Trimesh) -> np.ndarray:
    """(v,) bool: vertices from which no ray gets away sideways or downwards."""
    diagonal = float(np.linalg.norm(mesh.extents))
    normals = vertex_normals(mesh.vertices, mesh.faces)
    index = np.arange(_NUM_DIRECTIONS)
    azimuth, height = (
        index * np.pi * (3 - math.sqrt(5)),
        -0.6 * index / _NUM_DIRECTIONS,
    )  # a golden spiral, level to down
    level = np.sqrt(1 - height**2)
    directions = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height], axis=1)
    # A floor that faces up looks along itself: its rays start a little above it.
    ahead = normals @ directions.T > -0.02
    vertex, which = np.nonzero(ahead)
    start = np.asarray(mesh.vertices)[vertex] + 1e-3 * diagonal * normals[vertex]
    blocked = mesh.ray.intersects_any(start, directions[which])
    free = np.bincount(vertex, ~blocked, minlength=len(normals)) > 0
    return ~free & ahead.any(axis=1)


def _stands_out(mesh: trimesh.Trimesh, regions: np.ndarray) -> np.ndarray:
    vertices = np.asarray(mesh.vertices)
    diagonal = float(np.linalg.norm(mesh.extents))
    radius = np.linalg.norm(vertices[:, :2], axis=1)
    candidates = np.flatnonzero((vertices[:, 0] > 0) & (regions != INSIDE) & (radius > 0.02 * diagonal))
    mirrored = vertices[candidates] * [-1, 1, 0]
    start = vertices[candidates] * [0, 0, 1]
    locations, rays, _ = mesh.ray.intersects_location(start, mirrored / radius[candidates, None], multiple_hits=True)
    body = np.zeros(len(candidates))
    np.maximum.at(body, rays, np.linalg.norm(locations[:, :2], axis=1))
    out = np.zeros(len(vertices), dtype=bool)
    out[candidates[radius[candidates] > body + _STAND_OUT * diagonal]] = True
    return _largest_piece(out, mesh.edges_unique)


def _largest_piece(chosen: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Those of the chosen vertices (v,) bool that are in their largest connected piece."""
    inside = edges[chosen[edges].all(axis=1)]
    pieces = trimesh.graph.connected_components(inside, nodes=np.flatnonzero(chosen))
    result = np.zeros_like(chosen)
    if len(pieces):
        result[max(pieces, key=len)] = True
    return result


def detect_symmetry(
    meshes: list[trimesh.Trimesh], rng: np.random.Generator, *, tolerance: float = 0.012, share: float = 0.9
) -> Symmetry:
    """The highest symmetry about the z axis that most members of a class have.

    Args:
        meshes: Members in the primitive's frame; one is enough.
        rng: Draws the samples that are turned.
        tolerance: Mean distance of the turned surface from the surface, as a share of the diagonal.
        share: Share of the members that must have it.

    Returns:
        Axis z; order inf, 6 to 2, or 1; normal of a vertical mirror plane, (0, 1, 0) where that one fits, or None.
    """
    surfaces = [Surface(mesh, rng, count=4000) for mesh in meshes]
    limits = np.array([tolerance * np.linalg.norm(mesh.extents) for mesh in meshes])

    def fitting(moves: list[np.ndarray]) -> float:
        error = np.array([max(_moved_distance(surface, move) for move in moves) for surface in surfaces])
        return float((error <= limits).mean())

    order: float = 1
    if fitting([rotation_about(_UP, turn) for turn in _ODD_TURNS]) >= share:
        order = math.inf
    else:
        # A rounded square nearly fits itself after a fifth of a turn; after a quarter it fits better.
        found = {n: fitting([rotation_about(_UP, 2 * np.pi / n)]) for n in _ORDERS}
        best = max(found.values())
        order = next((n for n in _ORDERS if found[n] == best), 1) if best >= share else 1
    for angle in np.radians([90.0, 0.0, 45.0, 135.0, 30.0, 60.0, 120.0, 150.0]):
        normal = np.array([np.cos(angle), np.sin(angle), 0.0])
        if fitting([np.eye(3) - 2 * np.outer(normal, normal)]) >= share:
            return Symmetry(_UP, order, np.round(normal, 12))
    return Symmetry(_UP, order, None)


def _moved_distance(surface: Surface, move: np.ndarray) -> float:
    """Mean distance of the moved surface from itself; a small part that moves far, a handle, counts as much."""
    points = surface.points[::4] @ move.T
    closest = surface.closest(points, surface.normals[::4] @ move.T, normal_weight_m=0.002)[0]
    distance = np.linalg.norm(closest - points, axis=1)
    return float(max(distance.mean(), np.percentile(distance, 98) / _FAR))


_MAX_GROWTH = 5


def without_part(vertices: np.ndarray, faces: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cut a part off.

    Args:
        vertices: (v, 3) m.
        faces: (f, 3), closed.
        part: (v,) bool, the vertices of the part.

    Returns:
        Index of the vertices that stay (w,), and the faces (g, 3) over them: watertight, outward, without crossings.

    Raises:
        BuildFailed: No cut near the part leaves simple holes that triangles close cleanly.
    """
    for _ in range(_MAX_GROWTH + 1):
        faces_left = faces[~part[faces].any(axis=1)]
        loops = _loops(faces_left)
        if loops is not None:
            body = np.vstack([faces_left, *[_fill(vertices, loop) for loop in loops]])
            kept, inverse = np.unique(body, return_inverse=True)
            body = inverse.reshape(-1, 3)
            mesh = trimesh.Trimesh(vertices[kept], body, process=False)
            if mesh.is_volume and mesh.body_count == 1 and not len(crossing_faces(vertices[kept], body)):
                return kept, body
        part = part.copy()
        part[faces[part[faces].any(axis=1)]] = True  # one ring wider, and again
    raise BuildFailed("the part cannot be cut off cleanly: on the mean mesh it is attached too near to the rim or base")


def _loops(faces: np.ndarray) -> list[list[int]] | None:
    """Boundary loops, each in the order in which its edges run in the faces; None where loops touch."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there = set(map(tuple, sides.tolist()))
    free = [(a, b) for a, b in there if (b, a) not in there]
    following = dict(free)
    if len(following) != len(free):
        return None
    loops = []
    while following:
        start, vertex = following.popitem()
        loop = [start]
        while vertex != start:
            loop.append(vertex)
            vertex = following.pop(vertex)
        loops.append(loop)
    return sorted(loops)


def _fill(vertices: np.ndarray, loop: list[int]) -> np.ndarray:
    """Triangles (n - 2, 3) of least area over a loop (Barequet and Sharir, CAGD 12, 1995), outward."""
    loop = loop[::-1]  # a hole is closed against the sense of its faces
    points = vertices[loop]
    count = len(loop)
    cost = np.zeros((count, count))
    middle = np.zeros((count, count), dtype=int)
    for span in range(2, count):
        for i in range(count - span):
            k = i + span
            j = np.arange(i + 1, k)
            area = np.linalg.norm(np.cross(points[j] - points[i], points[k] - points[i]), axis=1)
            total = cost[i, j] + cost[j, k] + area
            best = int(total.argmin())
            cost[i, k], middle[i, k] = total[best], j[best]
    triangles, open_spans = [], [(0, count - 1)]
    while open_spans:
        i, k = open_spans.pop()
        if k - i < 2:
            continue
        j = int(middle[i, k])
        triangles.append((loop[i], loop[j], loop[k]))
        open_spans += [(i, j), (j, k)]
    return np.array(triangles, dtype=np.int64)
