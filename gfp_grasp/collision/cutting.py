"""Convex parts of a true object by greedy plane cuts: seconds where CoACD's tree search takes up to a minute.

A vessel's wall is cut into sectors and bands until no piece is more concave than a bound, so that a rim keeps its
thickness and the inside stays hollow. The cuts are exact (manifold3d); only the pieces' hulls add volume.
"""

from __future__ import annotations

import heapq
import time
from dataclasses import dataclass

import manifold3d
import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from gfp_grasp.collision.convex import convex_part
from gfp_grasp.collision.fidelity import union_error_m
from gfp_grasp.errors import DecompositionFailed, InvalidMesh
from gfp_grasp.types import CollisionMesh

_LEAST_PIECE_M3 = 1e-11  # a crumb of 0.2 mm
_SIMPLIFIED_M = 1e-4  # detail below this is dropped first: it costs pieces and no finger feels it
_BESIDE_M = 1e-5  # cuts go past a vertex, not through it, where they would leave needles
_NEAR_AXIS_M = 0.002
_LEAST_SHARE = 0.02  # of a piece: smaller slices use up the parts without getting anywhere
_THINNEST_M = 5e-4  # and so do thinner ones
_BALANCE = 0.1  # of two cuts that save alike, the more even one


def cut_parts(mesh: trimesh.Trimesh, *, concavity_m: float = 0.001, max_parts: int = 96) -> CollisionMesh:
    """Split a volume by planes. The most concave piece is cut next, by the plane that shrinks its hulls the most.

    Args:
        mesh: Watertight volume, m, z up.
        concavity_m: A piece is left alone when its vertices lie no deeper than this below its hull and no gap wider
            than about this lies within it.
        max_parts: Most parts; cutting stops there.

    Returns:
        The parts. Their `notes` hold concavity_m, the largest that is left, and volume_ratio, the summed volume of the
        parts over that of the mesh.

    Raises:
        InvalidMesh: The mesh is not a volume.
        DecompositionFailed: Nothing is left once crumbs are dropped.
    """
    started = time.monotonic()
    if not mesh.is_volume:
        raise InvalidMesh("cut_parts needs a watertight volume: use meshes.make_solid first")
    pieces = _cut(_solid(mesh), mesh.centroid[:2], concavity_m, max_parts)
    parts = tuple(part for piece in pieces if (part := convex_part(piece.vertices)) is not None)
    if not parts:
        raise DecompositionFailed("nothing is left of the mesh once crumbs are dropped: is it in metres?")
    seconds = time.monotonic() - started
    error_m = union_error_m(parts, mesh, rng=np.random.default_rng(0))
    ratio = sum(part.to_trimesh().volume for part in parts) / mesh.volume
    notes = {"concavity_m": max(piece.concavity_m for piece in pieces), "volume_ratio": float(ratio)}
    return CollisionMesh(parts, error_m, "cuts", seconds, notes)


@dataclass(frozen=True, eq=False)
class _Piece:
    """A connected piece: how concave it is, m, and its deepest vertex (3,) below the hull."""

    solid: manifold3d.Manifold
    vertices: np.ndarray
    concavity_m: float
    deepest: np.ndarray


def _cut(solid: manifold3d.Manifold, axis: np.ndarray, concavity_m: float, max_parts: int) -> list[_Piece]:
    done: list[_Piece] = []
    heap: list[tuple[float, int, _Piece]] = []
    number = 0
    waiting = _pieces(solid)
    while True:
        for piece in waiting:
            if piece.concavity_m <= concavity_m:
                done.append(piece)
            else:
                number += 1  # breaks ties in the order of making: the same mesh gives the same parts
                heapq.heappush(heap, (-piece.concavity_m, number, piece))
        if not heap or len(heap) + len(done) >= max_parts:
            return done + [piece for _, _, piece in heap]
        piece = heapq.heappop(heap)[2]
        waiting = _best_cut(piece, axis)
        if not waiting:
            done.append(piece)


def _best_cut(piece: _Piece, axis: np.ndarray) -> list[_Piece]:
    """Pieces on both sides of the plane that leaves the least hull volume; empty where no plane cuts."""
    best, least = None, np.inf
    for normal, offset in _planes(piece, axis):
        along = piece.vertices @ normal - offset
        if not along.min() < -_THINNEST_M < _THINNEST_M < along.max():
            continue
        halves = piece.solid.split_by_plane(tuple(normal), float(offset))
        volumes = [half.volume() for half in halves]
        if min(volumes) <= max(_LEAST_PIECE_M3, _LEAST_SHARE * sum(volumes)):
            continue
        hulls = sum(part.hull().volume() for half in halves for part in half.decompose())
        cost = hulls * (1 + _BALANCE * abs(volumes[0] - volumes[1]) / sum(volumes))
        if cost < least:
            best, least = halves, cost
    return [] if best is None else [part for half in best for part in _pieces(half)]


def _planes(piece: _Piece, axis: np.ndarray) -> list[tuple[np.ndarray, float]]:
    """Candidate planes (normal, offset): through the object's axis, level, around it, and square to x and y."""
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    deep, up = piece.deepest, np.array([0.0, 0.0, 1.0])
    planes = [(up, deep[2] - _BESIDE_M), (up, deep[2] + _BESIDE_M), (up, (low[2] + high[2]) / 2)]
    for point in (piece.vertices.mean(axis=0)[:2], deep[:2]):
        outward = point - axis
        reach = float(np.linalg.norm(outward))
        if reach > _NEAR_AXIS_M:
            around = np.array([-outward[1], outward[0], 0.0]) / reach
            planes.append((around, float(around[:2] @ axis)))
    outward = np.append(deep[:2] - axis, 0.0)
    reach = float(np.linalg.norm(outward))
    if reach > _NEAR_AXIS_M:
        planes.append((outward / reach, float(outward @ deep / reach - _BESIDE_M)))
    for side in np.eye(3)[:2]:
        planes += [(side, float(side @ deep)), (side, float(side @ (low + high) / 2))]
    return planes


def _pieces(solid: manifold3d.Manifold) -> list[_Piece]:
    return [_measured(part) for part in solid.decompose() if part.volume() > _LEAST_PIECE_M3]


def _measured(solid: manifold3d.Manifold) -> _Piece:
    vertices = np.asarray(solid.to_mesh().vert_properties, dtype=np.float64)[:, :3]
    try:
        hull = ConvexHull(vertices)
    except QhullError:  # flat: its hull is dropped later
        return _Piece(solid, vertices, 0.0, vertices[0])
    depth = -(vertices @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    deepest = int(np.argmax(depth))
    # A ring or a bow whose vertices all lie on its hull is found by what it leaves empty, however thin it is: the share
    # of the hull times the width, which for a chord over a thin arc is about its height.
    empty = max(1 - solid.volume() / hull.volume, 0.0)
    gap = empty * float(np.sort(np.ptp(vertices, axis=0))[1]) / 6
    return _Piece(solid, vertices, max(float(depth[deepest]), gap), vertices[deepest])


def _solid(mesh: trimesh.Trimesh) -> manifold3d.Manifold:
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.faces, dtype=np.uint32)
    whole = manifold3d.Manifold(manifold3d.Mesh(vert_properties=vertices, tri_verts=faces))
    if whole.is_empty():
        raise InvalidMesh(f"the mesh is no manifold volume to cut ({whole.status()}): repair it with meshes.make_solid")
    simple = whole.simplify(_SIMPLIFIED_M)
    return whole if simple.is_empty() else simple
