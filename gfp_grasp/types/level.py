"""One object as the stages after detection see it: level, ordered, thinned, with normals and its silhouette."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gfp_grasp.types.arrays import freeze
from gfp_grasp.types.observation import PointCloud
from gfp_grasp.types.sensor import SensorProfile
from gfp_grasp.types.views import View

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
        pixels, range_m = self.view.project(points)
        height, width = self.free_range_m.shape
        with np.errstate(invalid="ignore"):
            column, row = np.rint(pixels).T
            inside = np.flatnonzero((row >= 0) & (row < height) & (column >= 0) & (column < width))
        flat = (row[inside] * width + column[inside]).astype(np.int64)
        violating = range_m[inside] + self.margin_m < self.free_range_m.ravel()[flat]
        offset = self.offset_px.reshape(2, -1)[:, flat[violating]]
        moved = offset.any(axis=0)
        index = inside[violating][moved]
        there = self.view.unproject(pixels[index] + offset[::-1, moved].T, range_m[index])
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
        if len(self.points) <= count:
            return self
        drawn = np.sort(np.random.default_rng(0).permutation(len(self.points))[:count])
        return replace(self, points=self.points[drawn], normals=self.normals[drawn])
