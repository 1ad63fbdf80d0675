"""Solids with flat sides and rounded edges, with vertices all over their sides so that they can be bent."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import ArrayLike

_ARC_STEPS = 3  # grid lines of a rounded edge, up to half of its turn
_LINES = 11  # grid lines of a side between its rounded edges
_CLOSE_M = 1e-9  # what rounding errors may move a grid line


def block(size: ArrayLike, rounding: float) -> trimesh.Trimesh:
    """A block that stands on z = 0 about the axis x = y = 0, edges and corners rounded.

    Args:
        size: (3,) m.
        rounding: Radius of edges and corners, m.
    """
    half = np.asarray(size, dtype=np.float64) / 2
    rounding = min(rounding, 0.49 * float(half.min()))
    mesh = lattice(*(_lines(h, rounding) for h in half))
    inner = np.clip(mesh.vertices, rounding - half, half - rounding)
    offset = mesh.vertices - inner
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    mesh.vertices = inner + rounding * offset / length + [0, 0, half[2]]
    return mesh


def lattice(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> trimesh.Trimesh:
    """Surface of the box from the first to the last of the rising coordinates, m, with grid lines at all of them."""
    counts = np.array([len(x), len(y), len(z)])
    index = np.stack(np.meshgrid(*(np.arange(n) for n in counts), indexing="ij"), axis=-1)
    on_surface = ((index == 0) | (index == counts - 1)).any(axis=-1)
    number = np.full(counts, -1)
    number[on_surface] = np.arange(on_surface.sum())
    vertices = np.stack([np.asarray(c)[index[on_surface][:, i]] for i, c in enumerate((x, y, z))], axis=1)
    faces = []
    for axis in range(3):
        for end in (0, -1):
            side = np.take(number, end, axis=axis)
            quads = np.stack([side[:-1, :-1], side[1:, :-1], side[1:, 1:], side[:-1, 1:]], axis=-1).reshape(-1, 4)
            # The side of an odd axis turns the other way round, and so does a lower one.
            quads = quads if (axis == 1) != (end == -1) else quads[:, ::-1]
            faces += [quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]
    return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)


def patch_of(mesh: trimesh.Trimesh, low: ArrayLike, high: ArrayLike) -> np.ndarray:
    """The vertices of a lattice within a rectangle of the side at its largest x, y or z.

    Args:
        mesh: Made by `lattice` or `block`, and not bent yet.
        low: (3,) m, smallest coordinates of the rectangle.
        high: (3,) m, its largest ones; the one across the side is that of `low`.

    Returns:
        (r, c) numbers of vertices; seen from outside, the columns go to the right and the rows up.
    """
    low, high = np.asarray(low), np.asarray(high)
    within = (mesh.vertices > low - _CLOSE_M) & (mesh.vertices < high + _CLOSE_M)
    numbers = np.flatnonzero(within.all(axis=1))
    across = int((high - low).argmin())
    right, up = (mesh.vertices[numbers, (across + turn) % 3].round(9) for turn in (1, 2))
    return numbers[np.lexsort((right, up))].reshape(len(np.unique(up)), -1)


def _lines(half: float, rounding: float) -> np.ndarray:
    """Coordinates from -half to half, with those of even angles within the rounding."""
    arc = half - rounding + rounding * np.tan(np.linspace(0, np.pi / 4, _ARC_STEPS + 1))[1:]
    middle = np.linspace(rounding - half, half - rounding, _LINES)
    return np.concatenate([-arc[::-1], middle, arc])
