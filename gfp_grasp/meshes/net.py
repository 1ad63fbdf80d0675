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
        field: (x, y, z), finite, of any unit, negative inside.
        origin: (3,) m, place of the first value.
        cell_m: Distance of two values.

    Returns:
        The surface, every edge with two faces, outward; without faces where nothing is inside.
    """
    field = np.pad(np.asarray(field, dtype=np.float64), 1, constant_values=max(float(np.abs(field).max()), 1.0))
    field = _without_crosses(field)
    inside = (field < 0).ravel()
    # What runs over the end of a row, here and below, belongs to the padding, which is outside: no surface is there.
    strides = _strides(field.shape)
    pattern = np.zeros(inside.size, dtype=np.uint8)
    for c, offset in enumerate(_CORNERS @ strides):
        pattern[: inside.size - offset] |= inside[offset:].view(np.uint8) << np.uint8(c)
    mixed = np.flatnonzero((pattern != 0) & (pattern != 255))
    codes = pattern[mixed]
    two = _SECOND[codes] >= 0
    first = np.cumsum(1 + two) - (1 + two)  # number of the first vertex of each mixed cell
    number = np.full(pattern.size, -1)
    number[mixed] = first
    second = np.full(pattern.size, -1)
    second[mixed] = _SECOND[codes]
    places = np.stack(np.unravel_index(mixed, field.shape), axis=1)
    vertices = _vertices(field.ravel()[mixed[:, None] + _CORNERS @ strides], places, codes, two, first)
    faces = _faces(inside, strides, number, second, vertices)
    return trimesh.Trimesh(np.asarray(origin) + cell_m * (vertices - 1), faces, process=False)


def _strides(shape: tuple[int, ...]) -> np.ndarray:
    """How far apart neighbours along x, y and z are where a grid of this shape is flat."""
    return np.array([shape[1] * shape[2], shape[2], 1])


def _without_crosses(field: np.ndarray) -> np.ndarray:
    """The field with a corner of each square put inside whose inner corners face each other without touching.

    Then no face of a cell is cut twice, and no edge of the surface has four faces.
    """
    flat = field.ravel().copy()
    just = -_JUST * max(float(np.abs(flat[flat < 0]).max(initial=0.0)), 1e-12)
    inside, strides = flat < 0, _strides(field.shape)
    found = True
    while found:
        found = False
        for axis in range(3):
            u, v = np.delete(strides, axis)
            a, b, c, d = (inside[i : len(flat) - u - v + i] for i in (0, u, v, u + v))
            cross = np.flatnonzero((a ^ b) & ~(a ^ d) & ~(b ^ c))
            if not len(cross):
                continue
            found = True
            corners = cross[:, None] + np.array([0, u, v, u + v])
            values = flat[corners]
            chosen = corners[np.arange(len(cross)), np.where(values < 0, np.inf, values).argmin(axis=1)]
            flat[chosen], inside[chosen] = just, True
    return flat.reshape(field.shape)


def _vertices(
    values: np.ndarray, places: np.ndarray, codes: np.ndarray, two: np.ndarray, first: np.ndarray
) -> np.ndarray:
    """(v, 3) in cells: in each of (c, 3) cells with corners (c, 8) the middle of where its sheet cuts its edges."""
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
    inside: np.ndarray, strides: np.ndarray, number: np.ndarray, second: np.ndarray, vertices: np.ndarray
) -> np.ndarray:
    """(f, 3): a square around each edge of the grid that the surface cuts, parted by its shorter diagonal."""
    found = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        # An edge starts at the last of the four cells around it, and goes along the axis.
        edges = np.flatnonzero(inside[: len(inside) - strides[axis]] ^ inside[strides[axis] :])
        outward = inside[edges]
        square = np.empty((len(edges), 4), dtype=np.int64)
        for n, (i, j) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
            cell = edges - (1 - i) * strides[u] - (1 - j) * strides[v]
            corner = (1 - i) << u | (1 - j) << v
            other = second[cell]
            square[:, n] = number[cell] + ((other == corner) | (other == corner | 1 << axis))
        square[~outward] = square[~outward][:, ::-1]
        found.append(square)
    squares = np.concatenate(found)
    a, b, c, d = vertices[squares].transpose(1, 0, 2)
    other = ((b - d) ** 2).sum(axis=1) < ((a - c) ** 2).sum(axis=1)
    squares[other] = np.roll(squares[other], 1, axis=1)
    return np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])
