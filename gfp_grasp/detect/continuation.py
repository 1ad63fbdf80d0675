"""One thing seen to either side of something that stands before it: a box whose middle is hidden is one box."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.detect.merging import smallest_rectangle
from gfp_grasp.transforms import rotation_between
from gfp_grasp.types import SensorProfile, SupportPlane

# Multiples of the noise at their distance:
_SAME_TOP = 6.0  # the two sides end at heights that agree to this,
_ON_LINE = 4.0  # and their upright faces lie in one plane to this
_HIDES = 6.0  # what hides the middle is nearer than it by more

_MAX_LENGTH = 0.25  # of what is joined; in the sensor's largest
_FACE = 0.6  # share of the points of either side's upright face that lie in the common plane
_UPRIGHT = (0.15, 0.85)  # of the height, between which points are of upright faces
_LEAST_PX = 80
_SAMPLE = 300
_HYPOTHESES = 150
_HIDDEN = 0.9  # share of the pixels between the two sides at which something hides the middle


def join_behind(
    labels: np.ndarray,
    points: np.ndarray,
    depth: np.ndarray,
    support: SupportPlane,
    *,
    sensor: SensorProfile,
    noise_growth: np.ndarray,
) -> np.ndarray:
    """Labels (h, w) in which the two sides of one thing behind another have one number.

    Two are joined where they end at one height, where upright faces of both lie in one plane, and where all that is
    seen between them stands before that plane.

    Args:
        labels: (h, w) int, 0 for none.
        points: (h, w, 3) m.
        depth: (h, w) m, distance from the camera; 0 where nothing came back.
        support: The plane below.
        sensor: Its noise and sizes are the units of all thresholds.
        noise_growth: (h, w), how many times the sensor's noise a return has.
    """
    R = rotation_between(support.normal, (0.0, 0.0, 1.0))
    sides = {}
    for k in np.unique(labels[labels > 0]).tolist():
        rows, columns = np.nonzero(labels == k)
        if len(rows) >= _LEAST_PX:
            step = -(-len(rows) // _SAMPLE)
            own = points[rows, columns] @ R.T - (0.0, 0.0, support.height_m)
            top_m = float(np.quantile(own[:, 2], 0.98))
            sides[k] = (rows[::step], columns[::step], own[::step], top_m)
    joined = labels.copy()
    for a, b in combinations(sides, 2):
        (rows_a, columns_a, own_a, top_a), (rows_b, columns_b, own_b, top_b) = sides[a], sides[b]
        growth = max(float(np.median(noise_growth[side])) for side in ((rows_a, columns_a), (rows_b, columns_b)))
        sigma_m = sensor.sigma_m * growth
        if abs(top_a - top_b) > _SAME_TOP * sigma_m:
            continue
        _, low, high = smallest_rectangle(np.vstack([own_a[:, :2], own_b[:, :2]]))
        if float((high - low).max()) > _MAX_LENGTH * sensor.largest_m:
            continue
        top_m = min(top_a, top_b)
        if _one_face(_upright(own_a, top_m), _upright(own_b, top_m), _ON_LINE * sigma_m) and _is_hidden(
            depth, labels, (a, b), (rows_a, columns_a), (rows_b, columns_b), _HIDES * sigma_m
        ):
            joined[joined == joined[rows_b[0], columns_b[0]]] = joined[rows_a[0], columns_a[0]]
    return joined


def _upright(level: np.ndarray, top_m: float) -> np.ndarray:
    """Ground (n, 2) of those points that are neither of the foot nor of the top."""
    low, high = (share * top_m for share in _UPRIGHT)
    return level[(level[:, 2] > low) & (level[:, 2] < high), :2]


def _one_face(a: np.ndarray, b: np.ndarray, near_m: float) -> bool:
    """Whether a line on the ground through a point of either side (n, 2) holds most of both sides."""
    if min(len(a), len(b)) < 20:
        return False
    rng = np.random.default_rng(0)
    first, second = a[rng.integers(len(a), size=_HYPOTHESES)], b[rng.integers(len(b), size=_HYPOTHESES)]
    along = second - first
    length = np.linalg.norm(along, axis=1)
    usable = length > 4 * near_m
    if not usable.any():
        return False
    normals = np.column_stack([-along[:, 1], along[:, 0]])[usable] / length[usable, None]
    offsets = np.einsum("ni,ni->n", normals, first[usable])
    shares = [(np.abs(side @ normals.T - offsets) < near_m).mean(axis=0) for side in (a, b)]
    return bool(np.minimum(*shares).max() >= _FACE)


def _is_hidden(
    depth: np.ndarray,
    labels: np.ndarray,
    names: Iterable[int],
    a: tuple[np.ndarray, np.ndarray],
    b: tuple[np.ndarray, np.ndarray],
    nearer_m: float,
) -> bool:
    """Whether what is seen between two sides, from pixel to pixel, is nearer than they are."""
    pixels_a, pixels_b = np.column_stack(a), np.column_stack(b)
    distances, index = KDTree(pixels_b).query(pixels_a)
    nearest = int(np.argmin(distances))
    first, second = pixels_a[nearest], pixels_b[np.atleast_1d(index)[nearest]]
    count = int(np.abs(second - first).max())
    if count < 2:
        return False  # they touch, and are told apart for another reason
    share = np.arange(1, count) / count
    path = np.round(first + share[:, None] * (second - first)).astype(int)
    there = depth[path[:, 0], path[:, 1]]
    between = ~np.isin(labels[path[:, 0], path[:, 1]], list(names)) & (there > 0)
    if not between.any():
        return False
    # The inverse depth of a straight line in space is linear along its picture.
    expected = 1 / ((1 - share) / depth[tuple(first)] + share / depth[tuple(second)])
    return bool((there[between] < expected[between] - nearer_m).mean() >= _HIDDEN)
