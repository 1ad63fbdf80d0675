"""Organised points, as a structured-light or stereo driver gives them, made into a depth picture with its K."""

import numpy as np
from numpy.typing import ArrayLike

from gfp_grasp.errors import InvalidView, TooFewPoints
from gfp_grasp.types import DepthImage

# Real drivers round or register their points: the captures at hand stay below 0.1 px. A wrong layout is off by many.
LARGEST_RESIDUAL_PX = 1.0
FEWEST_POINTS = 50


def view_from_points(points_cam: ArrayLike, *, T_world_camera: ArrayLike | None = None) -> DepthImage:
    """Depth picture of organised camera-frame points; its K is fitted to them by least squares.

    Args:
        points_cam: (h, w, 3) m, x right, y down, z forward; NaN or zero where nothing came back.
        T_world_camera: (4, 4) pose of the camera; None puts the world's frame into the camera.

    Returns:
        The picture. Backprojecting it gives the points again, within the residual.

    Raises:
        InvalidView: Not (h, w, 3), or no pinhole camera sees these points in these pixels within 1 px.
        TooFewPoints: Fewer than 50 points, or too close together to tell focal length from centre.
    """
    points = np.asarray(points_cam, dtype=np.float64)
    if points.ndim != 3 or points.shape[2] != 3:
        raise InvalidView(f"organised points have shape {points.shape}; (h, w, 3) in metres is expected")
    seen = np.isfinite(points).all(axis=2) & (points[..., 2] > 0)
    if seen.sum() < FEWEST_POINTS:
        raise TooFewPoints(
            f"{seen.sum()} organised points lie in front of the camera; {FEWEST_POINTS} are needed to fit K"
        )
    v, u = np.nonzero(seen)
    x, y, z = points[seen].T
    K = np.eye(3)
    K[0, 0], K[0, 2] = _fit_axis(x / z, u, "column")
    K[1, 1], K[1, 2] = _fit_axis(y / z, v, "row")
    depth = np.where(seen, points[..., 2], 0.0)
    return DepthImage(depth, K, np.eye(4) if T_world_camera is None else np.asarray(T_world_camera))


def _fit_axis(slope: np.ndarray, pixel: np.ndarray, name: str) -> tuple[float, float]:
    """Focal length and centre, px, of pixel = focal * slope + centre."""
    if np.ptp(slope) < 1e-3 or np.ptp(pixel) < 2:
        raise TooFewPoints(f"the organised points span too little along the {name}s to fit K: give depth and K instead")
    focal, centre = np.polyfit(slope, pixel, 1)
    residual = float(np.sqrt(np.mean((focal * slope + centre - pixel) ** 2)))
    if focal <= 0 or residual > LARGEST_RESIDUAL_PX:
        raise InvalidView(
            f"no pinhole camera fits the organised points: along the {name}s the focal length is {focal:.1f} px, the "
            f"residual {residual:.2f} px; at most {LARGEST_RESIDUAL_PX} is expected. Are they (row, column, xyz), in "
            "the camera's own frame, x right, y down, z forward, neither cropped nor turned?"
        )
    return float(focal), float(centre)
