"""Fewer points that still cover the same surface."""

from __future__ import annotations

import numpy as np


def thin(points: np.ndarray, count: int) -> np.ndarray:
    """At most about count of (n, 3) points, as `thin_index` chooses them."""
    return points[thin_index(points, count)]


def thin_index(points: np.ndarray, count: int) -> np.ndarray:
    """At most about count points, at most one to a cell of a grid, whatever the order they come in.

    Args:
        points: (n, 3) m.
        count: Aimed at; the grid is refined until the number of cells is near it.

    Returns:
        Index (m,) of the points, m <= 1.2 * count, each the nearest to its cell's mean.
    """
    if len(points) <= count:
        return np.arange(len(points))
    origin = points.min(axis=0)
    low, high = 1e-5, float(np.ptp(points, axis=0).max()) + 1e-9
    size, cells = high / np.sqrt(count), np.empty(0)
    for _ in range(18):
        if not low < size < high:
            size = np.sqrt(low * high)
        cells = _cell_ids(points, origin, size)
        num_cells = len(np.unique(cells))
        if count <= num_cells <= 1.2 * count:
            break
        low, high = (low, size) if num_cells < count else (size, high)
        size *= np.sqrt(num_cells / (1.1 * count))  # as a surface has it
    else:
        cells = _cell_ids(points, origin, high)
    _, inverse, counts = np.unique(cells, return_inverse=True, return_counts=True)
    means = np.column_stack([np.bincount(inverse, points[:, axis]) for axis in range(3)]) / counts[:, None]
    # To 10 nm: the two points of a cell are equally near its mean, and rounding must not choose between them.
    distance = np.round(np.linalg.norm(points - means[inverse], axis=1), 8)
    least = np.full(len(counts), np.inf)
    np.minimum.at(least, inverse, distance)
    near = np.flatnonzero(distance == least[inverse])
    x, y, z = points[near].T
    order = near[np.lexsort((z, y, x, inverse[near]))]
    return order[np.searchsorted(inverse[order], np.arange(len(counts)))]


def _cell_ids(points: np.ndarray, origin: np.ndarray, size: float) -> np.ndarray:
    cell = np.floor((points - origin) / size).astype(np.int64)
    return (cell[:, 0] * 2_000_003 + cell[:, 1]) * 2_000_003 + cell[:, 2]


def voxel_grid(points: np.ndarray, voxel_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean point of each occupied cell (c, 3), and the cell of each point (n,)."""
    cells = np.floor((points - points.min(axis=0)) / voxel_m).astype(np.int64)
    extent = cells.max(axis=0) + 1
    keys = (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]
    _, cell_of, counts = np.unique(keys, return_inverse=True, return_counts=True)
    sums = np.column_stack([np.bincount(cell_of, points[:, k]) for k in range(3)])
    return sums / counts[:, None], cell_of
