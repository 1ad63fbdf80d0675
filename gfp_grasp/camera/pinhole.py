"""Pinhole geometry: pixel (u, v) sees direction ((u - cx) / fx, (v - cy) / fy, 1); pixel centres are whole numbers."""

import numpy as np

from gfp_grasp.errors import InvalidOption, InvalidView
from gfp_grasp.transforms import invert_T
from gfp_grasp.types import DepthImage, PointCloud, View


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
    camera = DepthImage(np.zeros((height, width)), K, np.eye(4))
    return camera.unproject(np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1), 1.0)


def camera_points(image: DepthImage) -> np.ndarray:
    """(h, w, 3) float64 m, camera frame, NaN where nothing came back."""
    return image.moved(invert_T(image.T_world_camera)).points()


def cloud_of(view: View, mask: np.ndarray | None = None) -> PointCloud:
    """World-frame cloud of the pixels that came back, with the sensor's place as its viewpoint.

    Args:
        view: A depth picture or a range image.
        mask: (h, w) bool, the pixels to keep; None keeps all.

    Raises:
        InvalidView: The mask is not of the view's size.
    """
    keep = view.free_range_m > 0
    if mask is not None:
        mask = np.asarray(mask, dtype=bool)
        if mask.shape != keep.shape:
            raise InvalidView(f"mask has shape {mask.shape}; the view's {keep.shape} is expected")
        keep = keep & mask
    return PointCloud(view.points()[keep], view.viewpoint)


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


def pixels_of(points: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The pixels of a view that points fall on.

    Args:
        points: (n, 3) m, world.
        view: The view.

    Returns:
        Index (m,) of the points that fall on a pixel, the flat index (m,) of that pixel in (h, w), and the points'
        ranges (m,) m.
    """
    pixels, range_m = view.project(points)
    height, width = view.shape
    with np.errstate(invalid="ignore"):
        column, row = np.rint(pixels).T
        inside = np.flatnonzero((row >= 0) & (row < height) & (column >= 0) & (column < width))
    flat = (row[inside] * width + column[inside]).astype(np.int64)
    return inside, flat, range_m[inside]


def mask_of_points(points: np.ndarray, view: View, *, tolerance_m: float) -> np.ndarray:
    """(h, w) bool: pixels of a view in which points (n, 3) m, world, lie, within a tolerance of the range it saw."""
    _, pixel, range_m = pixels_of(points, view)
    seen = view.free_range_m.ravel()[pixel]
    agrees = (seen > 0) & (np.abs(seen - range_m) < tolerance_m)
    mask = np.zeros(view.free_range_m.size, dtype=bool)
    mask[pixel[agrees]] = True
    return mask.reshape(view.shape)
