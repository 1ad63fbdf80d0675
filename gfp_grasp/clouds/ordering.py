"""Points in an order, and thinned to a number, that do not depend on how they came in."""

from __future__ import annotations

import numpy as np

# More points than this say nothing new about one object, and cost time.
MAX_POINTS = 100_000


def order_points(points: np.ndarray, *, seed: int = 0) -> np.ndarray:
    """Points (n, 3), each once, in an order and thinned to a number that do not depend on how they came in.

    A point is kept by a hash of its own coordinates, so the choice is the same for every permutation.
    """
    if len(points) > MAX_POINTS:
        points = _thinned(points, seed)
    points = points[np.lexsort((points[:, 2], points[:, 1], points[:, 0]))]
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
    state = np.uint64(seed % 2**63) * np.uint64(0x9E3779B97F4A7C15)
    with np.errstate(over="ignore"):
        mixed = state + bits[:, 0] * np.uint64(0xBF58476D1CE4E5B9)
        mixed ^= mixed >> np.uint64(31)
        mixed = (mixed + bits[:, 1]) * np.uint64(0x94D049BB133111EB)
        mixed ^= mixed >> np.uint64(29)
        mixed = (mixed + bits[:, 2]) * np.uint64(0xBF58476D1CE4E5B9)
        mixed ^= mixed >> np.uint64(32)
    return mixed
