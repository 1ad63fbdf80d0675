"""Depth pictures of 120 x 90 pixels by a camera at the origin, for answers known by hand."""

import numpy as np

from gfp_grasp import camera
from gfp_grasp.types import DepthImage

WIDTH, HEIGHT = 120, 90
K = camera.intrinsics(WIDTH, HEIGHT, 35.0)


def image_of(depth: np.ndarray, K: np.ndarray = K) -> DepthImage:
    """A picture of depths (h, w) m."""
    return DepthImage(depth, K, np.eye(4))
