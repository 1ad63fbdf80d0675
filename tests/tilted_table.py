"""Detections on a table that is not level, and points of the world as the level view of one has them."""

import numpy as np

from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_between
from gfp_grasp.types import Detection, LevelView, OrientedBox, PointCloud

UP = np.array([0.35, -0.2, 1.0]) / np.linalg.norm([0.35, -0.2, 1.0])  # of a table that is not level


def in_level_frame(view: LevelView, points: np.ndarray) -> np.ndarray:
    """World points in the frame of a level view."""
    return apply_T(invert_T(view.T_world_level), points)


def tilted_detection(points, viewpoint=None, **changes) -> Detection:
    """A detection of points, of which no support is known."""
    box = OrientedBox(make_T(None, points.mean(axis=0)), np.ptp(points, axis=0))
    given = {"up": UP, "support": None, "category": "wedge", "scores": {}, "box": box, "sensor_sigma_m": 0.0021}
    return Detection(cloud=PointCloud(points, viewpoint), **{**given, **changes})


def tilted_block(count: int = 3000) -> np.ndarray:
    """Points in a block that stands along UP, its lowest at a height of 0.2 m."""
    points = np.random.default_rng(0).uniform((0.5, 0.1, 0.2), (0.58, 0.23, 0.5), (count, 3))
    points[:10, 2] = 0.2
    return points @ rotation_between((0, 0, 1), UP).T
