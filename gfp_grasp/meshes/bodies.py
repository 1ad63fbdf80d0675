"""Closed bodies of one mesh: those that touch are kept apart where joining equal vertices would merge them."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

_SAME_ANGLE = 1e-6  # rad: faces at one edge that are nearer lie on each other


def closed_bodies(vertices: np.ndarray, faces: np.ndarray) -> trimesh.Trimesh | None:
    """The closed bodies that faces with joined vertices make up, each with vertices of its own.

    Where two bodies touch along an edge, four faces meet there; each is paired with the one on the other side of the
    solid between them. A face that is told twice counts once; two that face each other are where two bodies touch.

    Args:
        vertices: (v, 3), equal ones joined.
        faces: (f, 3), outward.

    Returns:
        A mesh in which every edge has two faces, in opposite directions; None where the faces do not make up such.
    """
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    if len(faces) == 0:
        return None
    first = faces.argmin(axis=1)[:, None]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)  # the smallest corner first
    _, kept = np.unique(turned, axis=0, return_index=True)
    faces = faces[np.sort(kept)]
    _, twins = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)
    if (twins > 1).mean() > 0.5:  # both sides of every face: no bodies that touch, but a mesh told inside out as well
        return None
    pairs = _paired_edges(vertices, faces)
    return None if pairs is None else _with_own_vertices(vertices, faces, pairs)


def outward(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The closed mesh with every body facing outward, but for a cavity, which lies within another body."""
    vertices, faces = np.asarray(mesh.vertices), np.array(mesh.faces)
    num, body_of = connected_components(
        coo_array((np.ones(2 * len(faces)), (faces[:, :2].ravel(), faces[:, 1:].ravel())), shape=2 * (len(vertices),)),
        directed=False,
    )
    of_face = body_of[faces[:, 0]]
    corners = vertices[faces]
    volume = np.bincount(of_face, np.linalg.det(corners) / 6, minlength=num)
    if (volume >= 0).all():
        return mesh
    low, high = np.full((num, 3), np.inf), np.full((num, 3), -np.inf)
    np.minimum.at(low, of_face, corners.min(axis=1))
    np.maximum.at(high, of_face, corners.max(axis=1))
    for body in np.flatnonzero(volume < 0):
        around = (low < low[body]).all(axis=1) & (high > high[body]).all(axis=1) & (volume > 0)
        if not around.any():
            faces[of_face == body] = faces[of_face == body][:, ::-1]
    return trimesh.Trimesh(vertices, faces, process=False)


def _paired_edges(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray | None:
    """Half-edges (p, 2) that belong to each other, by their index among the (f, 3); None where one is lone."""
    half = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    forward = half[:, 0] < half[:, 1]
    key = half.min(axis=1) * np.int64(len(vertices)) + half.max(axis=1)
    order = np.lexsort((forward, key))
    _, start, count = np.unique(key[order], return_index=True, return_counts=True)
    num_forward = np.add.reduceat(forward[order], start, dtype=np.int64)
    if (2 * num_forward != count).any():
        return None
    plain = start[count == 2]
    pairs = [np.stack([order[plain], order[plain + 1]], axis=1)]
    for begin, num in zip(start[count > 2], count[count > 2], strict=True):
        around = order[begin : begin + num]
        found = _paired_around(vertices, faces, half, around[: num // 2], around[num // 2 :])
        if found is None:
            return None
        pairs.append(found)
    return np.concatenate(pairs)


def _paired_around(
    vertices: np.ndarray, faces: np.ndarray, half: np.ndarray, backward: np.ndarray, forward: np.ndarray
) -> np.ndarray | None:
    """Each backward half-edge of one edge with the first forward one that follows it around the edge.

    An outward face has its solid behind it: at growing angle where it runs along the edge backward, at falling angle
    where forward.
    """
    start, end = vertices[half[forward[0]]]
    along = (end - start) / max(np.linalg.norm(end - start), 1e-300)
    sides = vertices[faces[np.append(backward, forward) // 3]].sum(axis=1) - start - end - start  # to the third corner
    across = sides - (sides @ along)[:, None] * along
    u = across[0] / max(np.linalg.norm(across[0]), 1e-300)
    angle = np.arctan2(across @ np.cross(along, u), across @ u)
    gap = (angle[None, len(backward) :] - angle[: len(backward), None]) % (2 * np.pi)
    gap = np.where((gap < _SAME_ANGLE) | (gap > 2 * np.pi - _SAME_ANGLE), 2 * np.pi, gap)
    pairs = []
    for _ in backward:
        i, j = np.unravel_index(int(np.argmin(gap)), gap.shape)
        if not gap[i, j] < 2 * np.pi:
            return None
        pairs.append((backward[i], forward[j]))
        gap[i], gap[:, j] = np.inf, np.inf
    return np.array(pairs)


def _with_own_vertices(vertices: np.ndarray, faces: np.ndarray, pairs: np.ndarray) -> trimesh.Trimesh:
    """A mesh whose faces share a vertex only where paired edges lead from one to the other."""
    corner, following = np.arange(3 * len(faces)), np.arange(3 * len(faces)).reshape(-1, 3)[:, [1, 2, 0]].ravel()
    # The half-edge of a corner leads to the next; its partner runs the other way.
    one, other = pairs.T
    rows, columns = np.append(corner[one], following[one]), np.append(following[other], corner[other])
    num, own = connected_components(
        coo_array((np.ones(len(rows)), (rows, columns)), shape=2 * (len(corner),)), directed=False
    )
    places = np.empty((num, 3))
    places[own] = vertices[faces.ravel()]
    return trimesh.Trimesh(places, own.reshape(-1, 3), process=False)
