"""What was seen: clouds, the support, one detected object, and the level view of it that later stages take."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gfp_grasp.errors import InvalidCloud, InvalidView
from gfp_grasp.types.arrays import checked_matrix, checked_vector, freeze
from gfp_grasp.types.sensors import TABLETOP, SensorProfile
from gfp_grasp.types.views import View, pixels_of


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
class Proposal:
    """What one look at an object says of its pose and size, before anything is fitted.

    Attributes:
        box: The object's box along its own axes: z up as it is used, x to its front or its handle; world frame.
        rests: Probability of each way in which it may rest, see `gfp_grasp.types.RESTS`.
        sure_of_front: 0 where nothing is known of x, as for a body of revolution, to 1.
        classes: The classes that what looked has learnt from: of others it does not know which way their x is.
        embedding: (c,) unit vector that is compared with the prototypes of primitives.
    """

    box: OrientedBox
    rests: Mapping[str, float]
    sure_of_front: float
    classes: tuple[str, ...]
    embedding: np.ndarray

    def moved(self, T: np.ndarray) -> Proposal:
        """The same in another frame, T_new_old (4, 4)."""
        return replace(self, box=OrientedBox(T @ self.box.T_world_box, self.box.extents))


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
        proposal: What one look at the points proposes, or None where nobody has looked.
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
    proposal: Proposal | None = None

    def __post_init__(self) -> None:
        freeze(self, "up", checked_vector(self.up, 3, "up", InvalidCloud))
        if self.mask is not None:
            if self.view is None:
                raise InvalidView("a mask came without its view: give both, or neither")
            mask = np.asarray(self.mask, dtype=bool)
            if mask.shape != self.view.shape:
                raise InvalidView(f"mask has shape {mask.shape}, the view {self.view.shape}")
            freeze(self, "mask", mask)


UP = np.array([0.0, 0.0, 1.0])
UP.setflags(write=False)


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Where an object was seen in a view, and where it cannot be.

    Attributes:
        view: Which pixel sees which point.
        free_range_m: (h, w) m, range up to which each ray is free: infinity where no part of the object can be, 0
            where the view says nothing, as on the object's own pixels.
        certain: The view is a real one: pixels outside of the mask saw something farther. Else it is guessed from the
            points, and what lacks may be hidden by something.
        offset_px: (2, h, w) px (row, column) from each pixel to the nearest pixel of the object.
        margin_m: A surface may lie this far in front of a return before the ray to the return contradicts it.
    """

    view: View
    free_range_m: np.ndarray
    certain: bool
    offset_px: np.ndarray
    margin_m: float

    def pixel_of(self, points: np.ndarray) -> np.ndarray:
        """Pixels (n, 2), column and row, at which points (n, 3) m are seen; NaN for what no pixel can see."""
        return self.view.project(points)[0]

    def free_space_violation(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points that lie where the view says that there is nothing, and the way back.

        Args:
            points: (n, 3) m.

        Returns:
            Index (t,) of the points in free space, and the displacement (t, 3) m that brings each onto the ray of the
            nearest pixel of the object, at the same range.
        """
        seen, flat, pixels, range_m = pixels_of(points, self.view)
        violating = range_m + self.margin_m < self.free_range_m.ravel()[flat]
        offset = self.offset_px.reshape(2, -1)[:, flat[violating]]
        outside = offset.any(axis=0)
        moved = np.flatnonzero(violating)[outside]
        index = seen[moved]
        there = self.view.unproject(pixels[moved] + offset[::-1, outside].T, range_m[moved])
        return index, there - points[index]


@dataclass(frozen=True, eq=False)
class LevelView:
    """One object's observation in its level frame: z along the support's normal, x towards the viewer.

    The origin lies on the support below the middle of what was seen; where no support was seen, in that middle.

    Attributes:
        T_world_level: (4, 4).
        cloud: All points, ordered, and the viewpoint.
        dense_points: (m, 3) m, about 1000, spread evenly over what was seen.
        dense_normals: (m, 3) unit, towards the viewpoint where there is one.
        points: (n, 3) m, about 400 of the dense ones.
        normals: (n, 3) unit.
        floor_m: Height that the object's lowest point has, as far as known.
        floor_sigma_m: How sure that is, for a surface that ends above it and one that ends below it.
        floor_seen: Whether a support was seen; else an occluder may hide how much farther down the object goes.
        silhouette: None without a viewpoint.
        sensor: What the sensor is like.
        sigma_m: Standard deviation of the points' noise.
        cut: (3,) unit: normal of the plane through the viewpoint beyond which something hides the object; None where
            all of its outline is seen.
        proposal: Pose and box that one look proposes, in the level frame, or None.
    """

    T_world_level: np.ndarray
    cloud: PointCloud
    dense_points: np.ndarray
    dense_normals: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    floor_m: float
    floor_sigma_m: tuple[float, float]
    floor_seen: bool
    silhouette: Silhouette | None
    sensor: SensorProfile
    sigma_m: float
    cut: np.ndarray | None = None
    proposal: Proposal | None = None

    def __post_init__(self) -> None:
        for name in ("T_world_level", "dense_points", "dense_normals", "points", "normals"):
            freeze(self, name, getattr(self, name))

    @property
    def up(self) -> np.ndarray:
        """(3,) the support's normal: z."""
        return UP

    @property
    def viewpoint(self) -> np.ndarray | None:
        """(3,) m, where the sensor stood, or None."""
        return self.cloud.viewpoint

    @property
    def oriented(self) -> bool:
        """Whether the sign of the normals means anything."""
        return self.cloud.viewpoint is not None

    def few(self, count: int) -> LevelView:
        """The same with at most count of its points, always the same ones, drawn without order."""
        return self if len(self.points) <= count else _drawn(self, count)


@lru_cache(maxsize=8)  # a fit asks for the same few sizes again and again
def _drawn(view: LevelView, count: int) -> LevelView:
    drawn = np.sort(np.random.default_rng(0).permutation(len(view.points))[:count])
    return replace(view, points=view.points[drawn], normals=view.normals[drawn])
