"""What was seen: clouds, the support, and one detected object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gfp_grasp.errors import InvalidCloud, InvalidView
from gfp_grasp.types.arrays import checked_matrix, checked_vector, freeze
from gfp_grasp.types.sensor import TABLETOP, SensorProfile
from gfp_grasp.types.views import View


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points of one frame.

    Attributes:
        points: (n, 3) float64 m, world frame, finite.
        viewpoint: (3,) float64 m, where the camera stood, or None.
    """

    points: np.ndarray
    viewpoint: np.ndarray | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise InvalidCloud(f"points have shape {points.shape}; (n, 3) in metres is expected")
        if not np.isfinite(points).all():
            raise InvalidCloud("points are not all finite: drop the rows with NaN first")
        freeze(self, "points", points)
        if self.viewpoint is not None:
            freeze(self, "viewpoint", checked_vector(self.viewpoint, 3, "viewpoint", InvalidCloud))


@dataclass(frozen=True, eq=False)
class OrientedBox:
    """A box: T_world_box (4, 4), origin at its centre; extents (3,) m along its axes."""

    T_world_box: np.ndarray
    extents: np.ndarray

    def __post_init__(self) -> None:
        freeze(self, "T_world_box", checked_matrix(self.T_world_box, (4, 4), "T_world_box", InvalidCloud))
        freeze(self, "extents", checked_vector(self.extents, 3, "extents", InvalidCloud))


@dataclass(frozen=True, eq=False)
class SupportPlane:
    """The plane that objects rest on: points x with normal @ x == height_m; the normal (3,) is unit and points up."""

    normal: np.ndarray
    height_m: float

    def __post_init__(self) -> None:
        normal = checked_vector(self.normal, 3, "normal", InvalidCloud)
        length = float(np.linalg.norm(normal))
        if length < 1e-9:
            raise InvalidCloud("the support normal is zero: give the direction that is up, e.g. (0, 0, 1)")
        freeze(self, "normal", normal / length)
        object.__setattr__(self, "height_m", float(self.height_m))

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Signed distance (n,) m of (n, 3) points, positive above."""
        return points @ self.normal - self.height_m


@dataclass(frozen=True, eq=False)
class Detection:
    """One object in the cloud.

    Attributes:
        cloud: Points of this object only, world frame.
        up: (3,) unit, the support's normal (not the object's axis).
        support: The plane it rests on, or None where it is unknown.
        category: Best class; "" where no class was asked for.
        scores: Probability of each class that is known, sums to one; empty where no class was asked for.
        box: Oriented box of the observed points, its z along up.
        view: All that the sensor saw, for free space, or None.
        mask: (h, w) bool, this object's pixels in the view, or None.
        sensor_sigma_m: Standard deviation of the range noise, as given or estimated.
        sensor: What the sensor is like.
    """

    cloud: PointCloud
    up: np.ndarray
    support: SupportPlane | None
    category: str
    scores: Mapping[str, float]
    box: OrientedBox
    view: View | None = None
    mask: np.ndarray | None = None
    sensor_sigma_m: float = 0.0015
    sensor: SensorProfile = TABLETOP

    def __post_init__(self) -> None:
        freeze(self, "up", checked_vector(self.up, 3, "up", InvalidCloud))
        if self.mask is not None:
            if self.view is None:
                raise InvalidView("a mask came without its view: give both, or neither")
            mask = np.asarray(self.mask, dtype=bool)
            if mask.shape != self.view.shape:
                raise InvalidView(f"mask has shape {mask.shape}, the view {self.view.shape}")
            freeze(self, "mask", mask)
