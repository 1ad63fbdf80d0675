"""Tubes that grow out of a body of rings, without a boolean: members of equal counts have equal faces.

A tube begins or ends with the outline of a patch of the body's grid. Columns crowd about the patches, so that these are
as wide as the tube.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from gfp_grasp.shapes.handles import LongHandle, even_path, half_loop
from gfp_grasp.shapes.patches import between, numbered, of_used, outline, section_of, with_closed_tube, without

SEGMENTS = 72
PATCH_ROWS = 3
# Columns of a patch: an ear is about as thick as it is wide, a long handle is wider.
_EAR_COLUMNS, _HANDLE_COLUMNS = 3, 6
_FIRST_COLUMN = 2  # first column of an ear's patch, counted from the middle of the ear
_STEPS = 24
# Shares of a long handle's length within which the outline of its patch becomes its own section, and its rings lean.
_FILLET, _LEANING = 0.15, 0.5


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
    grid = _grid(body)
    row = first_row + PATCH_ROWS // 2
    wide, deep = float(grid[row, 0, 0]), float(grid[row, SEGMENTS // 4, 1])
    at = np.arcsin(np.clip(half / deep, 0, 0.9))
    spread, first, last = 1.15 * along / deep, _FIRST_COLUMN, _FIRST_COLUMN + _EAR_COLUMNS
    quarter = np.interp(
        np.arange(SEGMENTS // 4 + 1), [0, first, last, SEGMENTS // 4], [0, at - spread, at + spread, np.pi / 2]
    )
    vertices = _respaced(body, np.concatenate([quarter, np.pi - quarter[-2::-1]]))
    root = wide * np.cos(at)
    middle = float(grid[first_row : first_row + PATCH_ROWS + 1, 0, 2].mean())
    loop = _loop(root, wide - root, half, middle, reach, power, rise)
    level = np.gradient(loop, axis=0) * [1, 1, 0]
    tube = _tube(loop, level, along, across, section_of(_patch(first_row, 0, _EAR_COLUMNS), 2.6))
    # Columns in the middle of the patches where the ears begin and end.
    middles = np.array([-1, 1]) * (first + last) / 2
    patches = [_patch(first_row, column, _EAR_COLUMNS) for column in (*middles, *(middles + SEGMENTS / 2))]
    faces = [without(body.faces, *patches)]
    for begin, end, turn in ((*patches[:2], [1, 1, 1]), (*patches[2:], [-1, -1, 1])):
        # Seen from behind, as where a tube ends, what was left is right.
        ends = outline(begin), outline(end[:, ::-1])
        faces.append(between(np.stack([ends[0], *numbered(len(vertices), tube), ends[1]])))
        vertices = np.concatenate([vertices, (tube * turn).reshape(-1, 3)])
    return of_used(vertices, faces)


def with_long_handle(
    body: trimesh.Trimesh, counts: Sequence[int], handle: LongHandle, *, power: float = 2.0
) -> trimesh.Trimesh:
    """A body with one handle towards +x.

    Args:
        body: Mesh of `matched` with SEGMENTS vertices in a ring.
        counts: Its rings: of the underside, of the side below, at (PATCH_ROWS) and above the handle, of the rim, of the
            inner side and of the floor.
        handle: Leaves the body in the middle of the rings that are at it.
        power: Exponent of the body's superellipse sections.
    """
    foot, first_row, _, _, rim, floor, _ = np.cumsum(counts) - 1
    middle = _grid(body)[first_row : first_row + PATCH_ROWS + 1].mean(axis=0)
    aside = handle.across[0] / middle[SEGMENTS // 4, 1]
    spread = float(np.arctan2(aside, (1 - aside**power) ** (1 / power)))
    # Narrow columns would be needles on the discs.
    crowd = np.interp(np.arange(sum(counts) - 1), [foot, first_row, rim, floor], [0, 1, 1, 0])
    vertices = _respaced(body, _crowded(spread, crowd), power)
    path = middle[0] + handle.path
    tangent = np.gradient(path, axis=0)
    patch = _patch(first_row, 0, _HANDLE_COLUMNS)
    tube = _tube(path, tangent, handle.across, handle.along, section_of(patch, handle.power))
    tube += _towards(vertices[outline(patch)] - tube[0], handle.path[:, 0] / handle.path[-1, 0], tangent)
    return with_closed_tube(vertices, body.faces, patch, tube[1:], path[-1])


def _grid(body: trimesh.Trimesh) -> np.ndarray:
    """Rings (r, SEGMENTS, 3) m of the body."""
    return np.asarray(body.vertices)[1:-1].reshape(-1, SEGMENTS, 3)


def _towards(root: np.ndarray, share: np.ndarray, tangent: np.ndarray) -> np.ndarray:
    """What (n, k, 3) moves the rings of a long handle so that the first of them is the outline of its patch.

    Args:
        root: (k, 3) m, from the first ring to the outline.
        share: (n,), where the rings are, 0 to 1.
        tangent: (n, 3) of any length.
    """
    # On a leaning side, rings lean at first: their vertices slide along the handle, which keeps its section.
    slide = root[:, :1] * (tangent / tangent[:, :1])[:, None]
    lean, fillet = (np.clip(1 - share / end, 0, 1)[:, None, None] ** 2 for end in (_LEANING, _FILLET))
    return lean * slide + fillet * (root - slide[0])


def _crowded(spread: float, crowd: np.ndarray) -> np.ndarray:
    """Angles (r, SEGMENTS / 2 + 1) of columns that crowd about a long handle.

    They do so within the eighths beside it: the corners of a square body are at the same column whatever the handle.

    Args:
        spread: Angle of the edge of the handle's patch.
        crowd: (r,), 0 for a ring of even columns, 1 for one whose columns are as wide as the patch.
    """
    column, eighth = np.arange(SEGMENTS // 2 + 1), SEGMENTS // 8
    even = column * 2 * np.pi / SEGMENTS
    narrow = np.interp(column, [0, _HANDLE_COLUMNS // 2, eighth], [0, spread, np.pi / 4])
    return even + crowd[:, None] * np.where(column < eighth, narrow - even, 0)


def _respaced(body: trimesh.Trimesh, half: np.ndarray, power: float = 2.0) -> np.ndarray:
    """Vertices of the body with other columns.

    Args:
        body: With superellipses for rings.
        half: (SEGMENTS / 2 + 1,), or so many for each ring, angles of the columns from 0 to pi; the other half mirrors
            them. They are measured after the body is made as deep as it is wide.
        power: Exponent of the superellipses.
    """
    grid = _grid(body)
    turn = np.concatenate([half, 2 * np.pi - half[..., -2:0:-1]], axis=-1)
    cos, sin = np.cos(turn), np.sin(turn)
    reach = (np.abs(cos) ** power + np.abs(sin) ** power) ** (-1 / power)
    wide, deep = grid[:, :1, 0], grid[:, SEGMENTS // 4, 1, None]
    grid = np.stack([wide * reach * cos, deep * reach * sin, 0 * turn + grid[:, :1, 2]], axis=2)
    return np.concatenate([body.vertices[:1], grid.reshape(-1, 3), body.vertices[-1:]])


def _loop(root: float, bulge: float, half: float, height: float, reach: float, power: float, rise: float) -> np.ndarray:
    """Centre line (n, 3) m of the ear towards +x, from y = -half to y = half, without its ends."""
    aside, out = half_loop(power, 81)
    path = even_path(np.stack([(reach + bulge) * out, half * aside], axis=1), _STEPS)[1:-1]
    return np.stack([root + path[:, 0], path[:, 2], height + rise * path[:, 0]], axis=1)


def _patch(first_row: int, middle: float, num_columns: int) -> np.ndarray:
    """The patch (PATCH_ROWS + 1, num_columns + 1) of the body about a column."""
    column = np.rint(middle + np.linspace(-1, 1, num_columns + 1) * num_columns / 2).astype(int)
    row = first_row + np.arange(PATCH_ROWS + 1)
    return 1 + row[:, None] * SEGMENTS + column % SEGMENTS


def _tube(path: np.ndarray, tangent: np.ndarray, aside: ArrayLike, up: ArrayLike, section: np.ndarray) -> np.ndarray:
    """Rings (n, k, 3) m around a path.

    Args:
        path: (n, 3) m.
        tangent: (n, 3) of any length, not upright; sections are at a right angle to it.
        aside: (n,) m or number, half-width of the section on the level.
        up: (n,) m or number, half-width the other way.
        section: (k, 2) within -1 .. 1, aside and up, turning left.
    """
    to_side = np.cross([0.0, 0.0, 1.0], tangent)
    upward = np.cross(tangent, to_side)
    axes = np.stack([to_side, upward], axis=1) / np.linalg.norm([to_side, upward], axis=2).T[:, :, None]
    half = np.stack(np.broadcast_arrays(aside, up, path[:, 0])[:2], axis=1)
    return path[:, None] + np.einsum("kc,ncd->nkd", section, half[:, :, None] * axes)
