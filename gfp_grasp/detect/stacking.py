"""Objects that stand on other objects: what meets the lower outline of an object in the picture is what carries it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gfp_grasp.detect.tables import noise_at
from gfp_grasp.types import DepthImage, Detection, SupportPlane

# Multiples of the noise at an object's distance:
_MEETS = 8.0  # surfaces are as near as this where one stands on the other,
_BELOW = 4.0  # what is lower than this below the support is not on it,
_ONE_BODY = 40.0  # and is of one body with what it is as near to as this;
_RAISED = 8.0  # what stands on another object is at least so high above the table,
_LEVEL = 8.0  # and its foot is level to this
_REACH_PX = 4  # below the outline, over which nothing may have come back
_FURTHER_PX = 12  # below the outline, where a body would go on
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
            placed[id(detection)] = replace(detection, support=SupportPlane(detection.up, height_m), proposal=None)
    return tuple(placed.get(id(detection), detection) for detection in detections)


@dataclass(frozen=True, eq=False)
class LowerOutline:
    """What is seen just below the pixels at which an object ends, n of them.

    Attributes:
        by: (n,) number of what is there; 0 for the table and whatever else is no object.
        gap_m: (n,) how far it is from the object in space.
        height_m: (n,) of the object's own point above the support.
        goes_on: (n,) bool, whether a surface near the object goes on below the support there, as a chair's does.
    """

    by: np.ndarray
    gap_m: np.ndarray
    height_m: np.ndarray
    goes_on: np.ndarray


def lower_outline(
    number: int, labels: np.ndarray, points: np.ndarray, view: DepthImage, support: SupportPlane, *, sigma_m: float
) -> LowerOutline:
    """What the lower outline of an object meets in the picture.

    Args:
        number: The object.
        labels: (h, w) int, objects by number.
        points: (h, w, 3) m, NaN where nothing came back.
        view: The picture.
        support: Its normal says where below is.
        sigma_m: The sensor's noise.
    """
    rows, columns = np.nonzero(labels == number)
    own = points[rows, columns]
    middle = np.nanmedian(own, axis=0)
    (x, y), (x_up, y_up) = view.project(np.stack([middle, middle + 0.01 * support.normal]))[0]
    down = np.array([x - x_up, y - y_up])
    down /= max(float(np.abs(down).max()), 1e-9)
    further = points[
        _inside(rows + _FURTHER_PX * down[1], 0, labels), _inside(columns + _FURTHER_PX * down[0], 1, labels)
    ]
    with np.errstate(invalid="ignore"):
        goes_on = support.distances(further) < -_BELOW * sigma_m
        goes_on &= np.linalg.norm(further - own, axis=1) < _ONE_BODY * sigma_m
    by, gaps, heights, below = [], [], [], []
    waiting = np.isfinite(own).all(axis=1)
    for step in range(1, _REACH_PX + 1):
        r, c = np.round(rows + step * down[1]).astype(int), np.round(columns + step * down[0]).astype(int)
        inside = (r >= 0) & (r < labels.shape[0]) & (c >= 0) & (c < labels.shape[1])
        r, c = np.where(inside, r, 0), np.where(inside, c, 0)
        waiting &= inside & (labels[r, c] != number)
        seen = waiting & np.isfinite(points[r, c]).all(axis=1)
        by.append(labels[r[seen], c[seen]])
        gaps.append(np.linalg.norm(points[r[seen], c[seen]] - own[seen], axis=1))
        heights.append(support.distances(own[seen]))
        below.append(goes_on[seen])
        waiting &= ~seen
    return LowerOutline(*(np.concatenate(part) for part in (by, gaps, heights, below)))


def _inside(pixels: np.ndarray, axis: int, labels: np.ndarray) -> np.ndarray:
    """Pixels (n,) as whole numbers within the picture."""
    return np.clip(np.round(pixels).astype(int), 0, labels.shape[axis] - 1)


def meets_below(outline: LowerOutline, noise_m: float) -> np.ndarray:
    """(n,) bool, where an object touches what is seen below it; noise_m is that of the sensor at its distance.

    What goes on below the support touches nothing.
    """
    return (outline.gap_m < _MEETS * noise_m) & ~outline.goes_on


def _foot_m(
    number: int, labels: np.ndarray, points: np.ndarray, view: DepthImage, detection: Detection
) -> float | None:
    """Height of an object's foot along up where other objects carry it; None where the table does."""
    support = detection.support
    assert support is not None
    noise_m = noise_at(detection.cloud.points, view.viewpoint, detection.sensor)
    outline = lower_outline(number, labels, points, view, support, sigma_m=detection.sensor.sigma_m)
    near = meets_below(outline, noise_m)
    carried = near & (outline.by > 0)
    if carried.sum() < _LEAST_PX or carried.sum() < _CARRIED * near.sum():
        return None
    low, foot, high = np.quantile(outline.height_m[carried], (0.2, 0.5, 0.8))
    if foot < _RAISED * noise_m or high - low > _LEVEL * noise_m:
        return None
    return support.height_m + float(foot)
