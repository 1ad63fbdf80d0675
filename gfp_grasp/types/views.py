"""What a sensor saw from one place: a depth picture, or the ranges of a spinning LiDAR.

Pixels are (column, row), pixel centres at whole numbers. A view measures distance in its own way, its range: along the
optical axis for a depth picture, from the sensor for a range image.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from gfp_grasp.errors import InvalidView
from gfp_grasp.transforms import apply_T, invert_T, is_rotation
from gfp_grasp.types.arrays import checked_matrix, checked_numbers, freeze
from gfp_grasp.units import unit_advice

_FARTHEST_M = 50.0  # depth cameras end at 10 m; a picture in millimetres begins at 100
_NEAREST_M, _LIKELY_M = 0.1, 10.0  # between these, what is in another unit is thought to be
_FARTHEST_RANGE_M = 500.0  # LiDARs end at 250 m


class View(Protocol):
    """What one sensor saw from one place."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        ...

    @property
    def viewpoint(self) -> np.ndarray:
        """(3,) m, world, where the sensor stood."""
        ...

    @property
    def free_range_m(self) -> np.ndarray:
        """(h, w) m, range up to which the ray of each pixel is free; 0 where nothing came back, which says nothing."""
        ...

    @property
    def step_rad(self) -> float:
        """Angle between the rays of neighbouring pixels, the finer of rows and columns."""
        ...

    def project(self, points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (..., 2) and ranges (...) m of world points (..., 3) m; NaN pixels for what no pixel can see."""
        ...

    def unproject(self, pixels: ArrayLike, range_m: ArrayLike) -> np.ndarray:
        """World points (..., 3) m that are seen in pixels (..., 2) at ranges (...) m: the inverse of `project`."""
        ...

    def points(self) -> np.ndarray:
        """(h, w, 3) m, world, NaN where nothing came back."""
        ...

    def moved(self, T: np.ndarray) -> Self:
        """The same view in another frame, T_new_old (4, 4)."""
        ...


@dataclass(frozen=True, eq=False)
class DepthImage:
    """A `View`: one depth picture of a pinhole camera.

    Attributes:
        depth_m: (h, w) float32 m along the optical axis; 0 where nothing came back.
        K: (3, 3) float64 px, pinhole intrinsics; nine numbers, row by row, are taken too.
        T_world_camera: (4, 4) float64, pose of the OpenCV camera frame.
    """

    depth_m: np.ndarray
    K: np.ndarray
    T_world_camera: np.ndarray

    def __post_init__(self) -> None:
        depth = _checked_ranges(self.depth_m, "depth_m", _FARTHEST_M)
        freeze(self, "depth_m", depth)
        K = checked_numbers(self.K, "K", InvalidView)
        K = checked_matrix(K.reshape(3, 3) if K.shape == (9,) else K, (3, 3), "K", InvalidView)
        if not np.array_equal(K[2], (0.0, 0.0, 1.0)):
            turned = ", K is transposed" if np.array_equal(K[:, 2], (0.0, 0.0, 1.0)) else ""
            raise InvalidView(f"the last row of K is {K[2].tolist()}{turned}; (0, 0, 1) is expected")
        if K[0, 0] <= 0 or K[1, 1] <= 0:
            raise InvalidView(f"focal lengths are {K[0, 0]}, {K[1, 1]} px; both must be positive")
        freeze(self, "K", K)
        freeze(self, "T_world_camera", _checked_pose(self.T_world_camera, "T_world_camera"))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.depth_m.shape[0], self.depth_m.shape[1]

    @property
    def viewpoint(self) -> np.ndarray:
        """(3,) m, world, where the camera stood."""
        return self.T_world_camera[:3, 3]

    @property
    def free_range_m(self) -> np.ndarray:
        """(h, w) m, depth up to which each pixel's ray is free; 0 where nothing came back."""
        return self.depth_m

    @property
    def step_rad(self) -> float:
        """Angle between neighbouring pixels in the middle of the picture."""
        return 1.0 / max(self.K[0, 0], self.K[1, 1])

    @cached_property
    def _world_to_pixels(self) -> np.ndarray:
        """(3, 4): homogeneous world points to (column * depth, row * depth, depth)."""
        return self.K @ invert_T(self.T_world_camera)[:3]

    def project(self, points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (..., 2) and depths (...) m of world points (..., 3) m; NaN pixels for what is behind the camera."""
        points = np.asarray(points, dtype=np.float64)
        # Rows and columns each lie in one piece, which halves the time of what follows.
        scaled = self._world_to_pixels[:, :3] @ points.reshape(-1, 3).T + self._world_to_pixels[:, 3:]
        depth = scaled[2]
        pixels = scaled[:2] / np.where(depth > 0, depth, np.nan)
        return pixels.T.reshape(*points.shape[:-1], 2), depth.reshape(points.shape[:-1])

    def unproject(self, pixels: ArrayLike, range_m: ArrayLike) -> np.ndarray:
        """World points (..., 3) m that are seen in pixels (..., 2) at depths (...) m."""
        column, row = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
        y = (row - self.K[1, 2]) / self.K[1, 1]
        x = (column - self.K[0, 2] - self.K[0, 1] * y) / self.K[0, 0]
        rays = np.stack([x, y, np.ones_like(x)], axis=-1)
        return apply_T(self.T_world_camera, rays * np.asarray(range_m, dtype=np.float64)[..., None])

    def points(self) -> np.ndarray:
        """(h, w, 3) m, world, NaN where nothing came back."""
        return self.unproject(_all_pixels(self.shape), np.where(self.depth_m > 0, self.depth_m, np.nan))

    def moved(self, T: np.ndarray) -> DepthImage:
        """The same picture in another frame, T_new_old (4, 4)."""
        return _with_pose(self, "T_world_camera", T @ self.T_world_camera)


@dataclass(frozen=True, eq=False)
class RangeImage:
    """A `View`: one turn of a spinning LiDAR, rings by azimuth.

    Attributes:
        range_m: (h, w) float32 m from the sensor; 0 where nothing came back. Row 0 is the highest ring.
        elevation_rad: (h,) of each ring above the sensor's xy plane, descending.
        azimuth_rad: Azimuth of column 0, counter-clockwise from the sensor's x axis; the columns go once round,
            clockwise, as seen from above.
        T_world_sensor: (4, 4), the sensor's frame: x forward, y left, z up.
    """

    range_m: np.ndarray
    elevation_rad: np.ndarray
    azimuth_rad: float
    T_world_sensor: np.ndarray

    def __post_init__(self) -> None:
        ranges = _checked_ranges(self.range_m, "range_m", _FARTHEST_RANGE_M)
        freeze(self, "range_m", ranges)
        elevation = checked_numbers(self.elevation_rad, "elevation_rad", InvalidView)
        if elevation.shape != (len(ranges),) or not (np.diff(elevation) < 0).all():
            raise InvalidView(
                f"elevation_rad has shape {elevation.shape}; one angle for each of {len(ranges)} rings, from the "
                "highest down, is expected"
            )
        freeze(self, "elevation_rad", elevation)
        object.__setattr__(self, "azimuth_rad", float(self.azimuth_rad))
        freeze(self, "T_world_sensor", _checked_pose(self.T_world_sensor, "T_world_sensor"))

    @property
    def shape(self) -> tuple[int, int]:
        """Rings and columns."""
        return self.range_m.shape[0], self.range_m.shape[1]

    @property
    def viewpoint(self) -> np.ndarray:
        """(3,) m, world, where the sensor stood."""
        return self.T_world_sensor[:3, 3]

    @property
    def free_range_m(self) -> np.ndarray:
        """(h, w) m, distance up to which each ray is free; 0 where nothing came back."""
        return self.range_m

    @property
    def step_rad(self) -> float:
        """Angle between neighbouring columns or rings, the finer of both."""
        rings = np.diff(self.elevation_rad)
        return float(min(2 * np.pi / self.shape[1], np.abs(rings).min() if len(rings) else np.inf))

    def project(self, points: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (..., 2) and distances (...) m of world points (..., 3) m.

        A column between the last and the first is beyond the last; pixels are NaN above and below all rings by more
        than half the distance to the next.
        """
        local = apply_T(invert_T(self.T_world_sensor), points)
        distance = np.linalg.norm(local, axis=-1)
        width = self.shape[1]
        column = (self.azimuth_rad - np.arctan2(local[..., 1], local[..., 0])) / (2 * np.pi) * width % width
        column = np.where(column >= width - 0.5, column - width, column)  # the first column's pixel reaches back
        with np.errstate(invalid="ignore", divide="ignore"):
            elevation = np.arcsin(np.clip(local[..., 2] / distance, -1.0, 1.0))
        row = np.interp(-elevation, -self._edges, np.arange(len(self._edges)) - 1.0, left=np.nan, right=np.nan)
        row = np.where((row >= -0.5) & (row < self.shape[0] - 0.5), row, np.nan)
        return np.stack([np.where(np.isnan(row), np.nan, column), row], axis=-1), distance

    @cached_property
    def _edges(self) -> np.ndarray:
        """(h + 2,) the rings' elevations, and one more above and below at the distance of the nearest two."""
        rings = self.elevation_rad
        first = rings[0] - rings[1] if len(rings) > 1 else 0.01
        last = rings[-2] - rings[-1] if len(rings) > 1 else 0.01
        return np.concatenate([[rings[0] + first], rings, [rings[-1] - last]])

    def unproject(self, pixels: ArrayLike, range_m: ArrayLike) -> np.ndarray:
        """World points (..., 3) m that are seen in pixels (..., 2) at distances (...) m."""
        column, row = np.moveaxis(np.asarray(pixels, dtype=np.float64), -1, 0)
        azimuth = self.azimuth_rad - column / self.shape[1] * 2 * np.pi
        elevation = np.interp(row + 1.0, np.arange(len(self._edges)), self._edges)
        level = np.cos(elevation)
        rays = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)
        return apply_T(self.T_world_sensor, rays * np.asarray(range_m, dtype=np.float64)[..., None])

    def points(self) -> np.ndarray:
        """(h, w, 3) m, world, NaN where nothing came back."""
        return self.unproject(_all_pixels(self.shape), np.where(self.range_m > 0, self.range_m, np.nan))

    def moved(self, T: np.ndarray) -> RangeImage:
        """The same scan in another frame, T_new_old (4, 4)."""
        return _with_pose(self, "T_world_sensor", T @ self.T_world_sensor)


_V = TypeVar("_V", DepthImage, RangeImage)


def _checked_ranges(value: np.ndarray, name: str, farthest_m: float) -> np.ndarray:
    """(h, w) float32 m, 0 where the value is no distance."""
    with np.errstate(over="ignore"):
        ranges = checked_numbers(value, name, InvalidView).astype(np.float32)
    if ranges.ndim != 2 or ranges.size == 0:
        raise InvalidView(f"{name} has shape {ranges.shape}; an (h, w) picture in metres is expected")
    ranges = np.where(np.isfinite(ranges) & (ranges > 0), ranges, np.float32(0))
    far = float(np.median(ranges[ranges > 0])) if ranges.any() else 0.0
    if far > farthest_m:
        advice = unit_advice(far, least_m=_NEAREST_M, most_m=_LIKELY_M)
        raise InvalidView(f"{name} has a median of {far:.4g} and metres are expected: {advice}")
    return ranges


def _checked_pose(value: np.ndarray, name: str) -> np.ndarray:
    T = checked_matrix(value, (4, 4), name, InvalidView)
    if not is_rotation(T[:3, :3]):
        raise InvalidView(f"{name} is no rigid motion: a rotation without scale or mirror is expected")
    return T


def _all_pixels(shape: tuple[int, int]) -> np.ndarray:
    """(h, w, 2) column and row of every pixel."""
    row, column = np.indices(shape)
    return np.stack([column, row], axis=-1)


def _with_pose(view: _V, name: str, T: np.ndarray) -> _V:
    """A copy with another pose, for which the picture need not be checked again."""
    other = copy.copy(view)
    other.__dict__.pop("_world_to_pixels", None)  # was computed from the pose before
    freeze(other, name, T)
    return other


def pixels_of(points: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The pixels of a view that points fall on.

    Args:
        points: (n, 3) m, world.
        view: The view.

    Returns:
        Index (m,) of the points that fall on a pixel, the flat index (m,) of that pixel in (h, w), where exactly they
        fall (m, 2), column and row, and the points' ranges (m,) m.
    """
    pixels, range_m = view.project(points)
    height, width = view.shape
    with np.errstate(invalid="ignore"):
        column, row = np.rint(pixels).T
        inside = np.flatnonzero((row >= 0) & (row < height) & (column >= 0) & (column < width))
    flat = (row[inside] * width + column[inside]).astype(np.int64)
    return inside, flat, pixels[inside], range_m[inside]
