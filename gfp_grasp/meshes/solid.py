"""Making a closed solid of an open or multi-piece mesh."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import manifold3d
import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.errors import InvalidMesh
from gfp_grasp.meshes.bodies import closed_bodies, outward
from gfp_grasp.meshes.grid import NUM_CELLS, remeshed
from gfp_grasp.meshes.load import check_mesh
from gfp_grasp.meshes.simplify import MOST_FACES, MOST_MOVED, simplified
from gfp_grasp.meshes.surface import crossing_faces, sample_surface

# Vertices nearer than this share of the diagonal are one.
_SAME = 1e-6
# A hole larger than this share of its piece's area is an opening, such as the mouth of a cup, and stays one.
_LARGEST_HOLE = 0.06
# A repair that moves the surface further than this share of the diagonal has lost a part of it.
_LOST = 0.02
_NUM_CHECKS = 8_000
_NUM_NEAR = 8
_NUM_EXACT = 250
_NUM_PATCHINGS = 8


@dataclass(frozen=True, eq=False)
class Repair:
    """What became of a mesh.

    Attributes:
        solid: A watertight volume without crossing faces.
        error_m: Largest distance from the given surface, where it is outermost or open to the outside, to the solid's
            surface, m; 0 where nothing but joining and orienting was needed.
        how: The step that succeeded.
    """

    solid: trimesh.Trimesh
    error_m: float
    how: Literal["joined", "united", "patched", "remeshed"]


def make_solid(mesh: trimesh.Trimesh, *, time_limit_s: float | None = None) -> tuple[trimesh.Trimesh, float]:
    """The solid of `repair_mesh` and its error_m."""
    repair = repair_mesh(mesh, time_limit_s=time_limit_s)
    return repair.solid, repair.error_m


def repair_mesh(mesh: trimesh.Trimesh, *, time_limit_s: float | None = None) -> Repair:
    """Make a watertight volume without crossing faces out of any mesh.

    A mesh of more than 100 000 faces is simplified first, where that moves its surface by at most 1/500 of its
    diagonal. Tried in turn, the first that succeeds is taken: joining and orienting, where bodies that touch are
    united; filling holes and uniting the pieces; cutting out where the surface crosses itself and filling that;
    remeshing, in which a sheet becomes a thin wall and what is sealed becomes solid.

    Args:
        mesh: Triangles in any state that `check_mesh` lets pass.
        time_limit_s: When so many seconds are over, remeshing, which takes some 10 s, is tried next; None for no limit.

    Raises:
        InvalidMesh: Not a usable mesh, or nothing of any volume came of it.
    """
    until = np.inf if time_limit_s is None else time.monotonic() + time_limit_s
    given = joined = _joined(check_mesh(mesh))
    nothing = InvalidMesh(
        f"no solid could be made of the mesh of {len(mesh.faces)} faces: is it more than stray triangles?"
    )
    if len(joined.faces) == 0:  # all of them needles that joining has closed
        raise nothing
    if len(joined.faces) > MOST_FACES:
        joined = _simplified(joined)
    if _is_solid(joined):
        merged = _united(joined, until) if _touch(joined) else None  # engines cut apart what only touches
        if merged is not None and _is_solid(merged):
            return Repair(merged, _error_m(given, merged, depth=0.0), "united")
        return Repair(joined, 0.0 if joined is given else _error_m(given, joined, depth=0.0), "joined")
    repairs: tuple[tuple[Literal["united", "patched"], Callable], ...] = (("united", _united), ("patched", _patched))
    for how, repair in repairs:
        solid = repair(joined, until)
        if solid is None or not _is_solid(solid):
            continue
        error = _error_m(given, solid, depth=0.0)
        if error <= _LOST * float(np.linalg.norm(joined.extents)):
            return Repair(solid, error, how)
    solid = remeshed(joined)
    if not _is_solid(solid):
        raise nothing
    return Repair(solid, _error_m(given, solid, depth=2 * float(joined.extents.max()) / NUM_CELLS), "remeshed")


def _simplified(joined: trimesh.Trimesh) -> trimesh.Trimesh:
    """Far fewer faces where that stays within the bound, small holes filled; else the same mesh."""
    fewer = simplified(joined if joined.is_watertight else _filled(joined) or joined)
    bound_m = MOST_MOVED * float(np.linalg.norm(joined.extents))
    return fewer if _error_m(joined, fewer, depth=np.inf) <= bound_m else joined


def _touch(mesh: trimesh.Trimesh) -> bool:
    """Whether bodies have vertices in the same places."""
    return len(np.unique(mesh.vertices, axis=0)) < len(mesh.vertices)


def _is_solid(mesh: trimesh.Trimesh) -> bool:
    return bool(mesh.is_volume) and len(crossing_faces(mesh.vertices, mesh.faces)) == 0


def _joined(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A copy with vertices joined, faces oriented alike, and those without area or told twice left out."""
    vertices, faces = np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces)
    used = vertices[faces.ravel()]
    tolerance = _SAME * float(np.linalg.norm(used.max(axis=0) - used.min(axis=0)))
    if not mesh.is_watertight:
        near = KDTree(vertices).query_pairs(tolerance, output_type="ndarray")
        representative = np.arange(len(vertices))
        # Pairs in descending order, so that each vertex ends at the lowest of its neighbours.
        near = near[np.argsort(-near[:, 0])]
        representative[near[:, 1]] = near[:, 0]
        faces = representative[representative[faces]]
        bodies = closed_bodies(vertices, faces)
        if bodies is not None:
            return outward(bodies)
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    joined = trimesh.Trimesh(vertices, faces[np.sort(first)], process=False)
    joined.remove_unreferenced_vertices()
    if not joined.is_winding_consistent:
        trimesh.repair.fix_winding(joined)
    return outward(joined) if joined.is_watertight and joined.is_winding_consistent else joined


def _united(mesh: trimesh.Trimesh, until: float) -> trimesh.Trimesh | None:
    """Union of the pieces, each with its small holes filled; None where a piece stays open, or time is up."""
    solids = []
    for piece in mesh.split(only_watertight=False):
        if time.monotonic() > until:
            return None
        closed = _filled(piece)
        if closed is None:
            return None
        vertices = np.array(closed.vertices, dtype=np.float64, order="C")
        solid = manifold3d.Manifold(manifold3d.Mesh64(vertices, np.array(closed.faces, dtype=np.uint64, order="C")))
        if solid.status() != manifold3d.Error.NoError:
            return None
        solids.append(solid)
    raw = manifold3d.Manifold.batch_boolean(solids, manifold3d.OpType.Add).to_mesh64()
    faces = np.asarray(raw.tri_verts).astype(np.int64)
    if len(faces) == 0:
        return None
    return trimesh.Trimesh(np.asarray(raw.vert_properties)[:, :3], faces, process=False)


def _patched(mesh: trimesh.Trimesh, until: float) -> trimesh.Trimesh | None:
    """The mesh with its crossing faces, and ever more around them, replaced by fans; None where crossings stay."""
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    for _ in range(_NUM_PATCHINGS):
        if time.monotonic() > until:
            return None
        crossing = np.unique(crossing_faces(vertices, faces))
        if len(crossing) == 0 or len(crossing) > _LARGEST_HOLE * len(faces):
            return None
        touched = np.isin(faces, faces[crossing]).any(axis=1)
        closed = _filled(trimesh.Trimesh(vertices, faces[~touched], process=False))
        if closed is None:
            return None
        vertices, faces = np.array(closed.vertices), np.array(closed.faces)
        if _is_solid(closed):
            closed.remove_unreferenced_vertices()
            return closed
    return None


def _filled(piece: trimesh.Trimesh) -> trimesh.Trimesh | None:
    """The piece with a fan over each of its small holes, facing outward; None where it stays open, or is empty."""
    if len(piece.faces) == 0 or not piece.is_winding_consistent:
        return None
    vertices, faces = np.array(piece.vertices), np.array(piece.faces)
    for loop in _loops(faces):
        middle = vertices[loop].mean(axis=0)
        spokes = vertices[loop] - middle
        area = np.linalg.norm(np.cross(spokes, np.roll(spokes, -1, axis=0)), axis=1).sum() / 2
        if area > _LARGEST_HOLE * piece.area:
            return None
        fan = np.stack([np.roll(loop, -1), loop, np.full(len(loop), len(vertices))], axis=1)
        vertices, faces = np.concatenate([vertices, middle[None]]), np.concatenate([faces, fan])
    closed = trimesh.Trimesh(vertices, faces, process=False)
    if not closed.is_watertight:
        return None
    if closed.volume < 0:
        closed.invert()
    return closed


def _loops(faces: np.ndarray) -> list[np.ndarray]:
    """Border loops, each in the direction of its faces' edges; where borders touch in a vertex, they part there."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    key, back = edges[:, 0] * (faces.max() + 1) + edges[:, 1], edges[:, 1] * (faces.max() + 1) + edges[:, 0]
    following: dict[int, list[int]] = {}
    for start, end in edges[~np.isin(key, back)].tolist():
        following.setdefault(start, []).append(end)
    loops = []
    for start in following:
        path = [start]
        while following.get(path[-1]):
            here = following[path[-1]].pop()
            if here in path:
                loops.append(np.array(path[path.index(here) :]))
                del path[path.index(here) + 1 :]
            else:
                path.append(here)
    return loops


def _error_m(given: trimesh.Trimesh, solid: trimesh.Trimesh, *, depth: float) -> float:
    """Largest distance m of the given surface to the solid's; what lies deeper inside than `depth` was meant to go."""
    rng = np.random.default_rng(0)
    points = sample_surface(given, _NUM_CHECKS, rng)[0]
    dense, _, face = sample_surface(solid, 20 * _NUM_CHECKS, rng)
    dense, face = np.concatenate([dense, solid.triangles_center]), np.append(face, np.arange(len(solid.faces)))
    nearest = face[np.asarray(KDTree(dense).query(points, k=_NUM_NEAR)[1])]
    feet = trimesh.triangles.closest_point(solid.triangles[nearest.ravel()], np.repeat(points, _NUM_NEAR, axis=0))
    distance = np.linalg.norm(feet.reshape(-1, _NUM_NEAR, 3) - points[:, None], axis=2).min(axis=1)
    kept = (distance <= depth) | ~solid.contains(points)
    points, distance = points[kept], distance[kept]
    # These are upper bounds, which rest on the faces that the samples found: the worst are looked at again, exactly,
    # until none that is left could be worse.
    order, largest = np.argsort(-distance), 0.0
    for start in range(0, len(order), _NUM_EXACT):
        chunk = order[start : start + _NUM_EXACT]
        if distance[chunk[0]] <= largest:
            break
        largest = max(largest, float(trimesh.proximity.closest_point(solid, points[chunk])[1].max()))
    return largest
