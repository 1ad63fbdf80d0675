"""Convex parts by greedy plane cuts: seconds where CoACD's tree search takes up to a minute, or a fifth of a second.

A vessel's wall is cut into sectors and bands until no piece is more concave than a bound, so that a rim keeps its
thickness and the inside stays hollow. The cuts are exact (manifold3d); only the pieces' hulls add volume.
"""

from __future__ import annotations

import heapq
import time
from dataclasses import dataclass
from itertools import combinations

import manifold3d
import numpy as np
import trimesh
from scipy.spatial import ConvexHull, QhullError

from gfp_grasp.collision.config import CollisionConfig
from gfp_grasp.collision.convex import convex_part
from gfp_grasp.collision.fidelity import union_error_m
from gfp_grasp.collision.levels import merge_tree, merged
from gfp_grasp.collision.parts import diagonal_m, volume_m3
from gfp_grasp.errors import DecompositionFailed, InvalidMesh
from gfp_grasp.meshes import enclosed_m3
from gfp_grasp.types import CollisionMesh, ConvexPart

_LEAST_PIECE_M3 = 1e-11  # a crumb of 0.2 mm
_SIMPLIFIED_M = 1e-4  # detail below this is dropped first: it costs pieces and no finger feels it
_BESIDE_M = 1e-5  # cuts go past a vertex, not through it, where they would leave needles
_NEAR_AXIS_M = 0.002
_LEAST_SHARE = 0.02  # of a piece: smaller slices use up the parts without getting anywhere
_THINNEST_M = 5e-4  # and so do thinner ones
_BALANCE = 0.1  # of two cuts that save alike, the more even one
# Quick cuts: shares of the diagonal, the most parts, and the share of a hull that a plane takes off if it is worth it.
_QUICK_DETAIL, _QUICK_CONCAVITY = 0.008, 0.02
_QUICK_PARTS = 24
_QUICK_GAIN = 0.05
_ON_PLANE_M = 1e-9
_SAMPLES, _QUICK_SAMPLES = 2000, 300  # of the error


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
    if not enclosed_m3(mesh):
        raise InvalidMesh("cut_parts needs a watertight volume: use meshes.make_solid first")
    pieces = _cut(_solid(mesh), mesh.centroid[:2], concavity_m, max_parts)
    return _measured_parts(_convex(pieces), pieces, mesh, started, samples=_SAMPLES)


def quick_parts(mesh: trimesh.Trimesh, *, config: CollisionConfig = CollisionConfig()) -> CollisionMesh:
    """Split a volume by few planes, chosen with less care than those of `cut_parts`, of a surface with less detail.

    Args:
        mesh: Watertight volume, m, z up.
        config: Budget; more than 24 parts are not made. Its tolerance, or else a fiftieth of the diagonal, is the depth
            below the hull up to which vertices and middles of faces of a piece may lie.

    Returns:
        The parts, with their two-sided error to the mesh as it was given. Their `notes` are those of `cut_parts`.

    Raises:
        InvalidMesh: The mesh is not a volume.
        DecompositionFailed: Nothing is left once crumbs are dropped.
    """
    started = time.monotonic()
    if not enclosed_m3(mesh):
        raise InvalidMesh("quick_parts needs a watertight volume: use meshes.make_solid first")
    diagonal = diagonal_m(np.asarray(mesh.vertices))
    most = min(config.max_parts, _QUICK_PARTS)
    concavity_m = config.tolerance_m or _QUICK_CONCAVITY * diagonal
    solid = _solid(mesh, _QUICK_DETAIL * diagonal)
    pieces = _cut(solid, mesh.centroid[:2], concavity_m, most, quick=True)
    parts = _convex(pieces, config.max_vertices_per_part)
    if len(parts) > most:  # so many bodies
        parts = merged(parts, merge_tree(parts), most, max_vertices=config.max_vertices_per_part)
    return _measured_parts(parts, pieces, mesh, started, samples=_QUICK_SAMPLES)


def _convex(pieces: list[_Piece], max_vertices: int | None = None) -> tuple[ConvexPart, ...]:
    hulls = (convex_part(piece.vertices, max_vertices=max_vertices) for piece in pieces)
    parts = tuple(part for part in hulls if part is not None)
    if not parts:
        raise DecompositionFailed("nothing is left of the mesh once crumbs are dropped: is it in metres?")
    return parts


def _measured_parts(
    parts: tuple[ConvexPart, ...], pieces: list[_Piece], mesh: trimesh.Trimesh, started: float, *, samples: int
) -> CollisionMesh:
    error_m = union_error_m(parts, mesh, count=samples, rng=np.random.default_rng(0))
    ratio = sum(volume_m3(part) for part in parts) / enclosed_m3(mesh)
    notes = {"concavity_m": max(piece.concavity_m for piece in pieces), "volume_ratio": float(ratio)}
    return CollisionMesh(parts, error_m, "cuts", time.monotonic() - started, notes)


_Plane = tuple[np.ndarray, float]  # normal (3,), and the distance from the origin along it


@dataclass(frozen=True, eq=False)
class _Piece:
    """A connected piece: edges (e, 2), what its hull adds, how concave it is, and its deepest vertex below the hull."""

    solid: manifold3d.Manifold
    vertices: np.ndarray
    edges: np.ndarray
    added_m3: float
    concavity_m: float
    deepest: np.ndarray


def _cut(
    solid: manifold3d.Manifold, axis: np.ndarray, concavity_m: float, max_parts: int, *, quick: bool = False
) -> list[_Piece]:
    """Pieces of a solid. The next to be cut is the most concave one; quick, that whose hull adds most."""
    done: list[_Piece] = []
    heap: list[tuple[float, int, _Piece]] = []
    number = 0
    waiting = _pieces(solid, quick)
    while True:
        for piece in waiting:
            if piece.concavity_m <= concavity_m:
                done.append(piece)
            else:
                number += 1  # breaks ties in the order of making: the same mesh gives the same parts
                heapq.heappush(heap, (-piece.added_m3 if quick else -piece.concavity_m, number, piece))
        if not heap or len(heap) + len(done) >= max_parts:
            return done + [piece for _, _, piece in heap]
        piece = heapq.heappop(heap)[2]
        waiting = _best_cut(piece, axis, quick)
        if not waiting:
            done.append(piece)


def _best_cut(piece: _Piece, axis: np.ndarray, quick: bool) -> list[_Piece]:
    """Pieces on both sides of the plane that leaves the least hull volume; empty where no plane cuts.

    Quick takes the first plane of `_ranked` that cuts.
    """
    best, least = None, np.inf
    planes = [(normal, offset) for normal, offset in _planes(piece, axis) if _parts(piece, normal, offset)]
    for normal, offset in _ranked(piece, planes) if quick else planes:
        halves = piece.solid.split_by_plane(tuple(normal), float(offset))
        volumes = [half.volume() for half in halves]
        if min(volumes) <= max(_LEAST_PIECE_M3, _LEAST_SHARE * sum(volumes)):
            continue
        if quick:
            best = halves
            break
        hulls = sum(part.hull().volume() for half in halves for part in half.decompose())
        cost = hulls * (1 + _BALANCE * abs(volumes[0] - volumes[1]) / sum(volumes))
        if cost < least:
            best, least = halves, cost
    return [] if best is None else [part for half in best for part in _pieces(half, quick)]


def _ranked(piece: _Piece, planes: list[_Plane]) -> list[_Plane]:
    """Planes by the summed hull volume of what is on their two sides, the least first.

    No single plane takes anything off a ring: each half is as convex or concave as the whole. Two planes do, and so
    where none is worth it alone the best two through the middle come first, the one across the longer side at the head.
    """
    left_m3 = [_sides_m3(piece, *plane) for plane in planes]
    ranked = [planes[i] for i in np.argsort(left_m3, kind="stable")]
    worth_m3 = (1 - _QUICK_GAIN) * _hull_m3(piece.vertices)
    if not planes or min(left_m3) < worth_m3:
        return ranked
    low, high = piece.vertices.min(axis=0), piece.vertices.max(axis=0)
    middles = [(normal, float(normal @ (low + high) / 2)) for normal in np.eye(3)[np.argsort(low - high)]]
    middles = [plane for plane in middles if _parts(piece, *plane)]
    pairs = list(combinations(range(len(middles)), 2))
    pairs_m3 = [_quarters_m3(piece, middles[i], middles[j]) for i, j in pairs]
    if not pairs or min(pairs_m3) >= worth_m3:
        return ranked
    first, second = pairs[int(np.argmin(pairs_m3))]
    return [middles[first], middles[second], *ranked]


def _sides_m3(piece: _Piece, normal: np.ndarray, offset: float) -> float:
    """Summed volume of the hulls of what is on either side of a plane."""
    along = piece.vertices @ normal - offset
    section = _section(piece, along)
    return sum(_hull_m3(np.concatenate([piece.vertices[side], section])) for side in (along >= 0, along <= 0))


def _quarters_m3(piece: _Piece, first: _Plane, second: _Plane) -> float:
    """Summed volume of the hulls of what is on either side of two planes."""
    sections = [_section(piece, piece.vertices @ normal - offset) for normal, offset in (first, second)]
    points = np.concatenate([piece.vertices, *sections])
    along = [points @ normal - offset for normal, offset in (first, second)]
    within = [[sign * height >= -_ON_PLANE_M for sign in (1, -1)] for height in along]
    return sum(_hull_m3(points[one & other]) for one in within[0] for other in within[1])


def _section(piece: _Piece, along: np.ndarray) -> np.ndarray:
    """(n, 3) points where edges of a piece cross a plane, from the signed distances (v,) of its vertices to it."""
    start, end = along[piece.edges].T
    crossing = start * end < 0
    start, end = start[crossing, None], end[crossing, None]
    first, last = piece.vertices[piece.edges[crossing]].transpose(1, 0, 2)
    return first + start / (start - end) * (last - first)


def _hull_m3(points: np.ndarray) -> float:
    return manifold3d.Manifold.hull_points(points).volume() if len(points) > 3 else 0.0


def _parts(piece: _Piece, normal: np.ndarray, offset: float) -> bool:
    """Whether enough of a piece lies on both sides of a plane."""
    along = piece.vertices @ normal - offset
    return bool(along.min() < -_THINNEST_M < _THINNEST_M < along.max())


def _planes(piece: _Piece, axis: np.ndarray) -> list[_Plane]:
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


def _pieces(solid: manifold3d.Manifold, quick: bool) -> list[_Piece]:
    return [_measured(part, middles=quick) for part in solid.decompose() if part.volume() > _LEAST_PIECE_M3]


def _measured(solid: manifold3d.Manifold, *, middles: bool = False) -> _Piece:
    """A piece, as concave as its deepest vertex, or as the deepest middle of a face where those count too."""
    mesh = solid.to_mesh()
    vertices = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3]
    edges = np.concatenate([mesh.tri_verts[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    edges = edges[edges[:, 0] < edges[:, 1]]  # each stands in two faces, once in either direction
    try:
        hull = ConvexHull(vertices)
    except QhullError:  # flat: its hull is dropped later
        return _Piece(solid, vertices, edges, 0.0, 0.0, vertices[0])
    depth = _depth_m(vertices, hull)
    deepest = int(np.argmax(depth))
    # A ring or a bow whose vertices all lie on its hull is found by what it leaves empty, however thin it is: the share
    # of the hull times the width, which for a chord over a thin arc is about its height.
    empty = max(1 - solid.volume() / hull.volume, 0.0)
    gap = empty * float(np.sort(np.ptp(vertices, axis=0))[1]) / 6
    deep_m = max(float(depth[deepest]), gap)
    if middles:
        deep_m = max(deep_m, float(_depth_m(vertices[mesh.tri_verts].mean(axis=1), hull).max()))
    return _Piece(solid, vertices, edges, hull.volume - solid.volume(), deep_m, vertices[deepest])


def _depth_m(points: np.ndarray, hull: ConvexHull) -> np.ndarray:
    """How far (n,) points (n, 3) lie below the nearest side of a hull."""
    return -(points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)


def _solid(mesh: trimesh.Trimesh, detail_m: float = _SIMPLIFIED_M) -> manifold3d.Manifold:
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float32), np.asarray(mesh.faces, dtype=np.uint32)
    whole = manifold3d.Manifold(manifold3d.Mesh(vert_properties=vertices, tri_verts=faces))
    if whole.is_empty():
        raise InvalidMesh(f"the mesh is no manifold volume to cut ({whole.status()}): repair it with meshes.make_solid")
    simple = whole.simplify(detail_m)
    return whole if simple.is_empty() else simple
