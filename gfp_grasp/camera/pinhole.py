"""Pinhole geometry: pixel (u, v) sees direction ((u - cx) / fx, (v - cy) / fy, 1); pixel centres are whole numbers."""

import numpy as np
from numpy.typing import ArrayLike

from gfp_grasp.errors import InvalidOption, InvalidView
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import DepthImage, PointCloud


def intrinsics(width: int, height: int, fov_y_deg: float) -> np.ndarray:
    """K (3, 3) px of a camera with square pixels that looks through the middle of its picture.

    Args:
        width: Columns.
        height: Rows.
        fov_y_deg: Full vertical field, from the upper edge of the first row to the lower edge of the last.

    Raises:
        InvalidOption: A size below one, or a field outside (0, 180).
    """
    if width < 1 or height < 1 or not 0 < fov_y_deg < 180:
        raise InvalidOption(f"{width} x {height} px at {fov_y_deg} degrees: sizes >= 1 and 0 < field < 180 are needed")
    focal = 0.5 * height / np.tan(np.radians(fov_y_deg) / 2)
    return np.array([[focal, 0.0, (width - 1) / 2], [0.0, focal, (height - 1) / 2], [0.0, 0.0, 1.0]])


def pixel_rays(K: np.ndarray, width: int, height: int) -> np.ndarray:
    """Directions (h, w, 3) in the camera frame, z = 1: depth times direction is the point."""
    u, v = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    y = (v - K[1, 2]) / K[1, 1]
    x = (u - K[0, 2] - K[0, 1] * y) / K[0, 0]
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def project(points: ArrayLike, K: np.ndarray, T_world_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of world points.

    Args:
        points: (..., 3) m, world frame.
        K: (3, 3) px.
        T_world_camera: (4, 4).

    Returns:
        Pixels (..., 2), u then v, NaN for points that are not in front of the camera; and depths (...) m.
    """
    local = apply_T(invert_T(T_world_camera), np.asarray(points, dtype=np.float64))
    depth = local[..., 2]
    pixels = (local @ K.T)[..., :2] / np.where(depth > 0, depth, np.nan)[..., None]
    return pixels, depth


def camera_points(image: DepthImage) -> np.ndarray:
    """(h, w, 3) float64 m, camera frame, NaN where nothing came back."""
    height, width = image.depth_m.shape
    depth = np.where(image.depth_m > 0, image.depth_m.astype(np.float64), np.nan)
    return pixel_rays(image.K, width, height) * depth[..., None]


def backproject(image: DepthImage) -> np.ndarray:
    """(h, w, 3) float64 m, world frame, NaN where nothing came back."""
    return apply_T(image.T_world_camera, camera_points(image))


def cloud_of(image: DepthImage, mask: np.ndarray | None = None) -> PointCloud:
    """World-frame cloud of the pixels that came back, with the camera's place as its viewpoint.

    Args:
        image: The depth picture.
        mask: (h, w) bool, the pixels to keep; None keeps all.

    Raises:
        InvalidView: The mask is not of the picture's size.
    """
    keep = image.depth_m > 0
    if mask is not None:
        mask = np.asarray(mask, dtype=bool)
        if mask.shape != keep.shape:
            raise InvalidView(f"mask has shape {mask.shape}; the picture's {keep.shape} is expected")
        keep = keep & mask
    return PointCloud(backproject(image)[keep], image.T_world_camera[:3, 3])


def surface_normals(image: DepthImage, *, max_jump_m: float = 0.01) -> np.ndarray:
    """Unit normals (h, w, 3) from neighbouring pixels, camera frame, towards the camera.

    Args:
        image: The depth picture.
        max_jump_m: A neighbour whose depth differs by more lies on another surface and is not used.

    Returns:
        Normals; NaN where a pixel lacks a usable neighbour along its row or its column.
    """
    points = camera_points(image)
    normals = np.cross(_difference(points, 1, max_jump_m), _difference(points, 0, max_jump_m))
    with np.errstate(invalid="ignore"):
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        away = np.einsum("hwc,hwc->hw", normals, points) > 0
    normals[away] *= -1
    return normals


def _difference(points: np.ndarray, axis: int, max_jump_m: float) -> np.ndarray:
    """(h, w, 3) step to the next pixel along an axis: central where both sides are usable, else one-sided."""
    step = np.diff(points, axis=axis)
    step[~(np.abs(step[..., 2]) <= max_jump_m)] = np.nan
    gap = np.full_like(np.take(points, [0], axis=axis), np.nan)
    ahead, behind = np.concatenate([step, gap], axis=axis), np.concatenate([gap, step], axis=axis)
    lone = np.where(np.isnan(ahead), behind, ahead)
    return np.where(np.isnan(ahead) | np.isnan(behind), lone, (ahead + behind) / 2)
