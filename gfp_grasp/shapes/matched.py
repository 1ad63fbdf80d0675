"""Profiles whose members correspond: each piece between two landmarks has a fixed number of rings.

Meshes of equal counts have equal faces. A primitive built from them needs no non-rigid fit: the n-th vertex of one is
the n-th vertex of all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from gfp_grasp.shapes.loft import arc_length, around

# Share of the steps that crowds towards the ends of a piece, where edges are rounded.
_CROWDED = 0.6


def matched(
    pieces: Sequence[np.ndarray], counts: Sequence[int], *, segments: int = 48, flutes: tuple[int, float] = (0, 0.0)
) -> trimesh.Trimesh:
    """Closed mesh through the pieces of a profile, from the axis to the axis.

    Args:
        pieces: Rows (n, 4) as `loft.rows` makes them, each beginning where the one before ends, outside first.
        counts: Rings of each piece; its last ring is the next piece's first and counts once.
        segments: Vertices of a ring.
        flutes: Number of waves around and their relative depth.
    """
    rings = [stepped(piece, count + 1)[1:] for piece, count in zip(pieces, counts, strict=True)]
    return around(np.concatenate([pieces[0][:1], *rings]), segments=segments, flutes=flutes)


def stepped(curve: np.ndarray, count: int) -> np.ndarray:
    """The rows (n, 4) at `count` steps along their length, somewhat closer towards both ends."""
    length = arc_length(curve[:, :3])
    even = np.linspace(0, 1, count)
    at = ((1 - _CROWDED) * even + _CROWDED * (1 - np.cos(np.pi * even)) / 2) * length[-1]
    return np.stack([np.interp(at, length, column) for column in curve.T], axis=1)


def space_discs(body: trimesh.Trimesh, num_rings: int, *, segments: int, floor: bool) -> None:
    """Rings of the flat underside, and of the floor, farther apart where they are wider: even ones would be needles.

    Args:
        body: Mesh of `matched`, whose vertices are moved.
        num_rings: Number of rings of the underside, and of the floor.
        segments: Vertices of a ring.
        floor: Whether the last rings are a floor.
    """
    grid = np.array(body.vertices[1:-1]).reshape(-1, segments, 3)
    share = np.geomspace(1.0, 0.03, num_rings)[:, None, None]
    grid[:num_rings, :, :2] = grid[num_rings - 1, :, :2] * share[::-1]
    if floor:
        grid[-num_rings:, :, :2] = grid[-num_rings, :, :2] * share
    body.vertices = np.concatenate([body.vertices[:1], grid.reshape(-1, 3), body.vertices[-1:]])


def cut(curve: np.ndarray, landmarks: ArrayLike) -> list[np.ndarray]:
    """The curve in pieces that end at its vertices nearest to the landmarks.

    Args:
        curve: (n, d) m.
        landmarks: (k, d) m, in the order in which the curve passes them.

    Returns:
        k + 1 pieces, each with at least two vertices; the last vertex of one is the first of the next.
    """
    pieces, start = [], 0
    landmarks = np.asarray(landmarks, dtype=np.float64)
    for number, landmark in enumerate(landmarks):
        # Room for a vertex of each landmark that is still to come.
        end = len(curve) - (len(landmarks) - number)
        near = start + 1 + int(np.linalg.norm(curve[start + 1 : end] - landmark, axis=1).argmin())
        pieces.append(curve[start : near + 1])
        start = near
    return [*pieces, curve[start:]]
