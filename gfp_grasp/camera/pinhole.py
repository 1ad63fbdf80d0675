"""Pinhole geometry: pixel (u, v) sees direction ((u - cx) / fx, (v - cy) / fy, 1); pixel centres are whole numbers."""

import numpy as np
from numpy.typing import ArrayLike

from gfp_grasp.errors import InvalidOption, InvalidView, TooFewPoints
from gfp_grasp.transforms import invert_T, look_at
from gfp_grasp.types import DepthImage, PointCloud, View, pixels_of

# Real drivers round or register their points: the captures at hand stay below 0.1 px. A wrong layout is off by many.
LARGEST_RESIDUAL_PX = 1.0
FEWEST_POINTS = 50


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


def mask_of_points(points: np.ndarray, view: View, *, tolerance_m: float) -> np.ndarray:
    """(h, w) bool: pixels of a view in which points (n, 3) m, world, lie, within a tolerance of the range it saw."""
    _, pixel, _, range_m = pixels_of(points, view)
    seen = view.free_range_m.ravel()[pixel]
    agrees = (seen > 0) & (np.abs(seen - range_m) < tolerance_m)
    mask = np.zeros(view.free_range_m.size, dtype=bool)
    mask[pixel[agrees]] = True
    return mask.reshape(view.shape)


def sample_viewpoint(
    rng: np.random.Generator,
    *,
    elevation_deg: tuple[float, float] = (20.0, 60.0),
    distance_m: float = 0.6,
    target: ArrayLike = (0.0, 0.0, 0.05),
) -> np.ndarray:
    """T_world_camera (4, 4) of a level camera that looks at the target from any side.

    Args:
        rng: Source of chance.
        elevation_deg: Lowest and highest angle above the horizon, uniform between them.
        distance_m: From the camera's centre to the target.
        target: (3,) m, world frame.

    Raises:
        InvalidOption: A distance that is not positive, or angles that are not -90 <= low <= high <= 90.
    """
    low, high = elevation_deg
    if not (-90 <= low <= high <= 90 and distance_m > 0):
        raise InvalidOption(
            f"elevation {elevation_deg} degrees at {distance_m} m: -90 <= low <= high <= 90, distance > 0"
        )
    elevation, azimuth = np.radians(rng.uniform(low, high)), rng.uniform(0, 2 * np.pi)
    outward = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    return look_at(np.asarray(target) + distance_m * np.array(outward), target)


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
