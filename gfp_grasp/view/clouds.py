"""The whole scene's points, told apart by what they belong to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gfp_grasp.camera import backproject
from gfp_grasp.complete import Completion
from gfp_grasp.types import DepthImage

# Labels of points beside the numbers of objects.
SUPPORT, OTHER = -1, -2
# More would hide the surfaces under them, and make a browser slow; a picture of 640 by 480 is thinned to every tenth.
MAX_POINTS = 30_000
# Walls and floors farther from the objects' middle than this are left out.
REACH_M = 0.7
# Points this close to the support belong to it; at least three sigmas of the sensor.
_SUPPORT_M = 0.004


def scene_cloud(
    image: DepthImage, completions: Sequence[Completion], *, max_points: int = MAX_POINTS
) -> tuple[np.ndarray, np.ndarray]:
    """Points near the objects, every so many of them.

    Args:
        image: The depth picture.
        completions: Of its objects; without any, all points are kept and belong to nothing.
        max_points: At most so many.

    Returns:
        Points (n, 3) m, world frame, and labels (n,) int: the number of the object in whose cluster the point is,
        SUPPORT, or OTHER.
    """
    points = backproject(image).reshape(-1, 3)
    labels = _labels(points, image, completions)
    keep = np.isfinite(points).all(axis=1)
    if completions:
        middle = np.mean([completion.mesh.bounds.mean(axis=0) for completion in completions], axis=0)
        keep &= np.linalg.norm(points - middle, axis=1) < REACH_M
    kept = np.flatnonzero(keep)
    kept = kept[:: max(1, -(-len(kept) // max_points))]
    return points[kept], labels[kept]


def _labels(points: np.ndarray, image: DepthImage, completions: Sequence[Completion]) -> np.ndarray:
    labels = np.full(len(points), OTHER)
    if completions and (support := completions[0].detection.support) is not None:
        near_m = max(_SUPPORT_M, 3 * completions[0].detection.sensor_sigma_m)
        labels[np.abs(support.distances(points)) < near_m] = SUPPORT  # of a point that is NaN this is false
    for number, completion in enumerate(completions):
        mask = completion.detection.mask
        if mask is not None and mask.shape == image.depth_m.shape:
            labels[mask.reshape(-1)] = number
    return labels
