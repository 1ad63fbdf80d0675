"""Tubes that grow out of a body of rings, without a boolean: members of equal counts have equal faces.

A patch of the body's grid is left out at each end of a tube, and the tube begins and ends with the patch's outline.
Its columns crowd about the patches, so that these are as wide as the tube is thick.
"""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.handles import even_path, half_loop
from gfp_grasp.shapes.loft import ring_faces

SEGMENTS = 72
PATCH_ROWS = 3
_PATCH_COLUMNS = 3
_FIRST_COLUMN = 2  # first column of a patch, counted from the middle of the ear
_STEPS = 24


def with_ears(
    body: trimesh.Trimesh,
    first_row: int,
    *,
    half: float,
    reach: float,
    along: float,
    across: float,
    power: float,
    rise: float,
) -> trimesh.Trimesh:
    """A body with two level loops, towards +x and -x.

    Args:
        body: Mesh of `matched` with SEGMENTS vertices in a ring, oval or round, wider along x.
        first_row: Ring below the ears; PATCH_ROWS rings above it is the ring above them.
        half: Half the distance between the two ends of an ear, m.
        reach: How far an ear stands out, m.
        along: Half-thickness in the plane of the ear, m.
        across: Half-thickness along z, m.
        power: How square the ear is: 2 is half an ellipse.
        rise: How much an ear rises for each metre that it stands out.
    """
    grid = np.asarray(body.vertices)[1:-1].reshape(-1, SEGMENTS, 3)
    wide, deep = grid[:, 0, 0], grid[:, SEGMENTS // 4, 1]
    row = first_row + PATCH_ROWS // 2
    at = np.arcsin(np.clip(half / deep[row], 0, 0.9))
    turn = _columns(at, 1.15 * along / deep[row])
    grid = np.stack([wide[:, None] * np.cos(turn), deep[:, None] * np.sin(turn), 0 * turn + grid[:, :1, 2]], axis=2)
    vertices = np.concatenate([body.vertices[:1], grid.reshape(-1, 3), body.vertices[-1:]])
    root = float(wide[row] * np.cos(at))
    middle = float(grid[first_row : first_row + PATCH_ROWS + 1, 0, 2].mean())
    loop = _loop(root, float(wide[row]) - root, half, middle, reach, power, rise)
    tubes, faces = [], [_body_faces(len(grid), first_row)]
    for side in (0, 1):
        tube = _tube(loop, along, across) * ([1, 1, 1] if side == 0 else [-1, -1, 1])
        count = tube.shape[0] * tube.shape[1]
        inner = len(vertices) + side * count + np.arange(count).reshape(tube.shape[:2])
        ends = [_outline(first_row, side * SEGMENTS // 2, end) for end in (-1, 1)]
        faces.append(_between(np.concatenate([ends[:1], inner, ends[1:]])))
        tubes.append(tube.reshape(-1, 3))
    # No face has the vertices within the patches.
    used, renumbered = np.unique(np.concatenate(faces), return_inverse=True)
    return trimesh.Trimesh(np.concatenate([vertices, *tubes])[used], renumbered.reshape(-1, 3), process=False)


def _columns(at: float, spread: float) -> np.ndarray:
    """Angles (SEGMENTS,) of the columns, with a patch from at - spread to at + spread in each quarter."""
    last = _FIRST_COLUMN + _PATCH_COLUMNS
    quarter = np.interp(
        np.arange(SEGMENTS // 4 + 1), [0, _FIRST_COLUMN, last, SEGMENTS // 4], [0, at - spread, at + spread, np.pi / 2]
    )
    half = np.concatenate([quarter, np.pi - quarter[-2::-1]])
    return np.concatenate([half, half[1:-1] + np.pi])


def _loop(root: float, bulge: float, half: float, height: float, reach: float, power: float, rise: float) -> np.ndarray:
    """Centre line (n, 3) m of the ear towards +x, from y = -half to y = half, without its ends."""
    aside, out = half_loop(power, 81)
    path = even_path(np.stack([(reach + bulge) * out, half * aside], axis=1), _STEPS)[1:-1]
    return np.stack([root + path[:, 0], path[:, 2], height + rise * path[:, 0]], axis=1)


def _square() -> np.ndarray:
    """Places (k, 2) of the vertices of a patch's outline within -1 .. 1, turning left."""
    u, v = np.linspace(-1, 1, _PATCH_COLUMNS + 1), np.linspace(-1, 1, PATCH_ROWS + 1)
    sides = [(u[:-1], -1), (1, v[:-1]), (u[:0:-1], 1), (-1, v[:0:-1])]
    return np.concatenate([np.stack(np.broadcast_arrays(*side), axis=1) for side in sides])


def _outline(first_row: int, first_column: int, end: int) -> np.ndarray:
    """Numbers (k,) of the body's vertices around the patch where an ear begins (-1) or ends (1)."""
    u, v = _square().T
    middle = end * (_FIRST_COLUMN + _PATCH_COLUMNS / 2)
    # At its end the tube is seen from behind: what was left is right.
    column = first_column + np.rint(middle - end * u * _PATCH_COLUMNS / 2).astype(int)
    row = first_row + np.rint((v + 1) * PATCH_ROWS / 2).astype(int)
    return 1 + row * SEGMENTS + column % SEGMENTS


def _tube(path: np.ndarray, along: float, across: float) -> np.ndarray:
    """Rings (n, k, 3) m around a path that rises little."""
    tangent = np.gradient(path, axis=0) * [1, 1, 0]
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    aside = np.cross([0.0, 0.0, 1.0], tangent)
    square = _square()
    section = square / (np.abs(square) ** 2.6).sum(axis=1, keepdims=True) ** (1 / 2.6)
    up = np.array([0.0, 0.0, across])
    return path[:, None] + along * section[None, :, :1] * aside[:, None] + section[None, :, 1:] * up


def _between(rings: np.ndarray) -> np.ndarray:
    """Faces between rings (n, k) of vertex numbers that turn left about the way they go."""
    here, there = rings[:-1], np.roll(rings, -1, axis=1)[:-1]
    up, over = rings[1:], np.roll(rings, -1, axis=1)[1:]
    quads = np.stack([here, there, over, up], axis=2).reshape(-1, 4)
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _body_faces(num_rings: int, first_row: int) -> np.ndarray:
    """Faces of the body without the four patches."""
    columns = _FIRST_COLUMN + np.arange(_PATCH_COLUMNS)
    columns = np.concatenate([columns, -1 - columns])
    columns = np.concatenate([columns, columns + SEGMENTS // 2]) % SEGMENTS
    rows = first_row + np.arange(PATCH_ROWS)
    quads = (rows[:, None] * SEGMENTS + columns).ravel()
    gone = SEGMENTS + np.concatenate([quads, quads + (num_rings - 1) * SEGMENTS])
    return np.delete(ring_faces(num_rings, SEGMENTS), gone, axis=0)
