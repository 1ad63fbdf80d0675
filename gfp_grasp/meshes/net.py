"""The zero level of a field on a grid as a watertight mesh: one vertex in each cell that the surface passes through.

Dual to marching cubes, after S. Gibson, Constrained Elastic Surface Nets, 1998.
"""

from __future__ import annotations

import numpy as np
import trimesh

_EDGES = np.array([(c, c | 1 << a) for a in range(3) for c in range(8) if not c >> a & 1])  # corner c is at c's bits
_CORNERS = np.array([(c & 1, c >> 1 & 1, c >> 2) for c in range(8)])
# Two corners that face each other across the cube, alone inside or alone outside: two sheets pass through the cell.
_FAR = {1 << c | 1 << 7 - c: c ^ 7 for c in range(4)}
_SECOND = np.full(256, -1)  # the corner that the second sheet cuts off
for _pattern, _corner in _FAR.items():
    _SECOND[_pattern] = _SECOND[255 - _pattern] = _corner
_JUST = 1e-3  # of the field's smallest step: what a corner is put inside by


def surface_net(field: np.ndarray, *, origin: np.ndarray, cell_m: float) -> trimesh.Trimesh:
    """Watertight surface around where a field is negative.

    Where four sheets of it would meet in one edge, at two inner corners of a square that face each other, they are
    joined: thin walls stay whole. Beyond the grid is outside.

    Args:
        field: (x, y, z), of any unit, negative inside.
        origin: (3,) m, place of the first value.
        cell_m: Distance of two values.

    Returns:
        The surface, every edge with two faces, outward; without faces where nothing is inside.
    """
    field = np.pad(np.asarray(field, dtype=np.float64), 1, constant_values=max(float(np.abs(field).max()), 1.0))
    field = _without_crosses(field)
    inside = field < 0
    pattern = np.zeros(np.array(field.shape) - 1, dtype=np.uint8)
    for c, (i, j, k) in enumerate(_CORNERS):
        ends = np.array([i, j, k]) + pattern.shape
        pattern |= inside[i : ends[0], j : ends[1], k : ends[2]].astype(np.uint8) << c
    mixed = np.flatnonzero((pattern != 0) & (pattern != 255))
    codes = pattern.ravel()[mixed]
    two = _SECOND[codes] >= 0
    first = np.cumsum(1 + two) - (1 + two)  # number of the first vertex of each mixed cell
    number = np.full(pattern.size, -1)
    number[mixed] = first
    second = np.full(pattern.size, -1)
    second[mixed] = _SECOND[codes]
    places = np.stack(np.unravel_index(mixed, pattern.shape), axis=1)
    vertices = _vertices(field, places, codes, two, first)
    faces = _faces(field, inside, number, second, vertices)
    return trimesh.Trimesh(np.asarray(origin) + cell_m * (vertices - 1), faces, process=False)


def _without_crosses(field: np.ndarray) -> np.ndarray:
    """The field with a corner of each square put inside whose inner corners face each other without touching.

    Then no face of a cell is cut twice, and no edge of the surface has four faces.
    """
    field = field.copy()
    just = -_JUST * max(float(np.abs(field[field < 0]).max(initial=0.0)), 1e-12)
    while True:
        inside, found = field < 0, False
        for axis in range(3):
            u, v = np.eye(3, dtype=int)[[a for a in range(3) if a != axis]]
            x, y, z = np.array(field.shape) - u - v
            a, b, c, d = (
                inside[i : i + x, j : j + y, k : k + z] for i, j, k in ((0, 0, 0), tuple(u), tuple(v), tuple(u + v))
            )
            cross = np.argwhere((a == d) & (b == c) & (a != b))
            if not len(cross):
                continue
            found = True
            corners = cross[:, None] + np.stack([0 * u, u, v, u + v])
            values = field[tuple(np.moveaxis(corners, -1, 0))]
            chosen = corners[np.arange(len(cross)), np.where(values < 0, np.inf, values).argmin(axis=1)]
            field[tuple(chosen.T)] = just
            inside = field < 0
        if not found:
            return field


def _vertices(
    field: np.ndarray, places: np.ndarray, codes: np.ndarray, two: np.ndarray, first: np.ndarray
) -> np.ndarray:
    """(v, 3) in cells: in each of (c, 3) cells the middle of where its sheet cuts the cell's edges."""
    corners = places[:, None] + _CORNERS
    values = field[tuple(np.moveaxis(corners, -1, 0))]
    start, end = values[:, _EDGES[:, 0]], values[:, _EDGES[:, 1]]
    cut = (start < 0) != (end < 0)
    share = np.where(cut, start / np.where(cut, start - end, 1.0), 0.0)[..., None]
    crossings = _CORNERS[_EDGES[:, 0]] + share * (_CORNERS[_EDGES[:, 1]] - _CORNERS[_EDGES[:, 0]])
    of_second = cut & (_EDGES[None] == _SECOND[codes][:, None, None]).any(axis=2)
    vertices = np.empty((int(two.sum()) + len(places), 3))
    for own, rows, at in ((cut & ~of_second, slice(None), first), (of_second, two, first[two] + 1)):
        weight = own[rows, :, None]
        vertices[at] = places[rows] + (weight * crossings[rows]).sum(axis=1) / weight.sum(axis=1)
    return vertices


def _faces(
    field: np.ndarray, inside: np.ndarray, number: np.ndarray, second: np.ndarray, vertices: np.ndarray
) -> np.ndarray:
    """(f, 3): a square around each edge of the grid that the surface cuts, parted by its shorter diagonal."""
    shape = np.array(field.shape) - 1
    strides = np.array([shape[1] * shape[2], shape[2], 1])
    found = []
    for axis in range(3):
        u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
        ends = [slice(1, None) if a != axis else slice(None) for a in range(3)]
        near = inside[tuple(s if a != axis else slice(None, -1) for a, s in enumerate(ends))]
        far = inside[tuple(s if a != axis else slice(1, None) for a, s in enumerate(ends))]
        edges = np.argwhere(near != far)
        outward = near[tuple(edges.T)]
        # The edge starts at field[edges + u + v]; around it lie the cells from edges to edges + u + v.
        square = np.empty((len(edges), 4), dtype=np.int64)
        for n, (i, j) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
            cell = (edges + i * u + j * v) @ strides
            corner = (np.array([1 << a for a in range(3)]) * ((1 - i) * u + (1 - j) * v)).sum()
            other = second[cell]
            square[:, n] = number[cell] + ((other == corner) | (other == corner | 1 << axis))
        square[~outward] = square[~outward][:, ::-1]
        found.append(square)
    squares = np.concatenate(found)
    a, b, c, d = vertices[squares].transpose(1, 0, 2)
    other = ((b - d) ** 2).sum(axis=1) < ((a - c) ** 2).sum(axis=1)
    squares[other] = np.roll(squares[other], 1, axis=1)
    return np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
