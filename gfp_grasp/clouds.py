"""Bare points: their order, fewer of them that cover the same surface, and normals from their neighbourhoods."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

# More points than this say nothing new about one object, and cost time.
MAX_POINTS = 100_000


def order_points(points: np.ndarray, *, seed: int = 0) -> np.ndarray:
    """Points (n, 3), each once, in an order and thinned to a number that do not depend on how they came in.

    A point is kept by a hash of its own coordinates, so the choice is the same for every permutation.
    """
    if len(points) > MAX_POINTS:
        points = _thinned(points, seed)
    order = np.argsort(points[:, 0])
    x = points[order, 0]
    if (x[1:] == x[:-1]).any():  # the other coordinates decide, which takes four times as long
        order = np.lexsort((points[:, 2], points[:, 1], points[:, 0]))
    points = points[order]
    return points[np.append(True, (points[1:] != points[:-1]).any(axis=1))]


def distinct_points(points: np.ndarray) -> np.ndarray:
    """Each of (n, 3) points once, in the order of first appearance."""
    first = np.unique(_hashes(points, 0), return_index=True)[1]
    return points if len(first) == len(points) else points[np.sort(first)]


def _thinned(points: np.ndarray, seed: int) -> np.ndarray:
    hashes = _hashes(points, seed)
    kept = points[hashes < _share(len(points))]
    if len(distinct_points(kept)) > 0.5 * MAX_POINTS:
        return kept
    hashes, first = np.unique(hashes, return_index=True)  # many are copies, which a hash keeps or drops together
    return points[first[hashes < _share(len(first))]]


def _share(count: int) -> np.uint64:
    """The hash below which MAX_POINTS of so many points lie, more or less."""
    return np.uint64(min(int(MAX_POINTS / count * 2**64), 2**64 - 1))


def _hashes(points: np.ndarray, seed: int) -> np.ndarray:
    """(n,) uint64 of the coordinates alone."""
    bits = np.ascontiguousarray(points + 0.0).view(np.uint64)
    # splitmix64's constants; the seed moves the stream.
    with np.errstate(over="ignore"):
        state = np.uint64(seed % 2**63) * np.uint64(0x9E3779B97F4A7C15)
        mixed = state + bits[:, 0] * np.uint64(0xBF58476D1CE4E5B9)
        mixed ^= mixed >> np.uint64(31)
        mixed = (mixed + bits[:, 1]) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(29)
        mixed = (mixed + bits[:, 2]) * np.uint64(0xBF58476D1CE4E5B9)
        mixed ^= mixed >> np.uint64(32)
    return mixed


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


def local_axes(cloud: np.ndarray, at: np.ndarray, *, num_neighbours: int) -> tuple[np.ndarray, np.ndarray]:
    """Principal axes of the nearest points of a cloud.

    Args:
        cloud: (n, 3) m.
        at: (m, 3) m, where to look.
        num_neighbours: Points of a neighbourhood; all of them where the cloud has fewer.

    Returns:
        Sums of squares (m, 3) m^2 along the axes, smallest first, about the neighbourhood's mean; and the axes
        (m, 3, 3) as columns, of which the first is the normal of a flat neighbourhood.
    """
    neighbours = cloud[KDTree(cloud).query(at, k=min(num_neighbours, len(cloud)))[1]]
    centred = neighbours - neighbours.mean(axis=1, keepdims=True)
    return np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred))


def estimate_normals(
    cloud: np.ndarray, at: np.ndarray, viewpoint: np.ndarray | None, *, num_neighbours: int = 16
) -> np.ndarray:
    """Unit normals of a cloud.

    Args:
        cloud: (n, 3) m.
        at: (m, 3) m, where normals are wanted.
        viewpoint: (3,) m, which the normals face; None leaves their sign open.
        num_neighbours: Points of a neighbourhood.

    Returns:
        (m, 3).
    """
    normals = local_axes(cloud, at, num_neighbours=num_neighbours)[1][:, :, 0]
    if viewpoint is not None:
        away = np.einsum("ni,ni->n", normals, viewpoint - at) < 0
        normals = np.where(away[:, None], -normals, normals)
    return normals
