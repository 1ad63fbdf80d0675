"""Objects that stand on other objects: what meets the lower outline of an object in the picture is what carries it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gfp_grasp.detect.tables import noise_growth
from gfp_grasp.types import DepthImage, Detection, SupportPlane

# Multiples of the noise at an object's distance:
_MEETS = 8.0  # surfaces are as near as this where one stands on the other,
_RAISED = 8.0  # what stands on another object is at least so high above the table,
_LEVEL = 8.0  # and its foot is level to this
_REACH_PX = 4  # below the outline, over which nothing may have come back
_LEAST_PX = 10  # of an outline that must meet something
_CARRIED = 0.7  # of that outline, by other objects


def on_each_other(detections: Sequence[Detection]) -> tuple[Detection, ...]:
    """Detections of one picture, those that stand on another one with the plane of their own foot as support.

    An object stands on others where most of its lower outline meets their surface and hardly any meets the table, and
    where that outline is level. Detections without a depth picture, a mask or a support stay as they are.
    """
    masked = [d for d in detections if isinstance(d.view, DepthImage) and d.mask is not None and d.support is not None]
    if len(masked) < 2:
        return tuple(detections)
    view = masked[0].view
    assert isinstance(view, DepthImage)
    labels = np.zeros(view.shape, dtype=np.int32)
    for number, detection in enumerate(masked, start=1):
        labels[detection.mask] = number
    points = view.points()
    placed = {}
    for number, detection in enumerate(masked, start=1):
        height_m = _foot_m(number, labels, points, view, detection)
        if height_m is not None:
            placed[id(detection)] = replace(detection, support=SupportPlane(detection.up, height_m))
    return tuple(placed.get(id(detection), detection) for detection in detections)


def _foot_m(
    number: int, labels: np.ndarray, points: np.ndarray, view: DepthImage, detection: Detection
) -> float | None:
    """Height of an object's foot along up where other objects carry it; None where the table does."""
    support = detection.support
    assert support is not None
    rows, columns = np.nonzero(labels == number)
    own = points[rows, columns]
    middle = np.median(own, axis=0)
    noise_m = detection.sensor.sigma_m * float(noise_growth(np.asarray(np.linalg.norm(middle - view.viewpoint))))
    (x, y), (x_up, y_up) = view.project(np.stack([middle, middle + 0.01 * support.normal]))[0]
    down = np.array([x - x_up, y - y_up])
    if np.linalg.norm(down) < 1e-9:
        return None
    down /= np.abs(down).max()
    met, heights = [], []
    waiting = np.ones(len(rows), dtype=bool)
    for step in range(1, _REACH_PX + 1):
        r, c = np.round(rows + step * down[1]).astype(int), np.round(columns + step * down[0]).astype(int)
        inside = (r >= 0) & (r < labels.shape[0]) & (c >= 0) & (c < labels.shape[1])
        r, c = np.where(inside, r, 0), np.where(inside, c, 0)
        waiting &= inside & (labels[r, c] != number)
        seen = waiting & np.isfinite(points[r, c]).all(axis=1)
        gap_m = np.linalg.norm(points[r[seen], c[seen]] - own[seen], axis=1)
        near = gap_m < _MEETS * noise_m
        met.append(labels[r[seen], c[seen]][near])
        heights.append(support.distances(own[seen])[near])
        waiting &= ~seen
    by, height = np.concatenate(met), np.concatenate(heights)
    carried = by > 0
    if carried.sum() < _LEAST_PX or carried.mean() < _CARRIED:
        return None
    low, foot, high = np.quantile(height[carried], (0.2, 0.5, 0.8))
    if foot < _RAISED * noise_m or high - low > _LEVEL * noise_m:
        return None
    return support.height_m + float(foot)
