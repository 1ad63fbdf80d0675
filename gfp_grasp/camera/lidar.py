"""Scans of a spinning multi-beam LiDAR, of bare meshes: rings by azimuth, noise, lost returns.

`render.scan_scene` scans a MuJoCo scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.camera.cast import cast_rays, checked_mesh, table_depth
from gfp_grasp.errors import InvalidOption
from gfp_grasp.transforms import make_T
from gfp_grasp.types import RangeImage, pixels_of


@dataclass(frozen=True)
class LidarModel:
    """A spinning LiDAR and its noise.

    Attributes:
        elevation_deg: How high each ring looks above the sensor's xy plane, from the highest down.
        columns: Shots of each ring in one turn.
        height_m: Height above the road that it is mounted at.
        sigma_m: Standard deviation of a range.
        lost_share: Share of the returns that do not come back.
        nearest_m: Nothing nearer comes back.
        farthest_m: Nothing farther comes back.
    """

    elevation_deg: tuple[float, ...]
    columns: int
    height_m: float = 1.73
    sigma_m: float = 0.0
    lost_share: float = 0.0
    nearest_m: float = 0.9
    farthest_m: float = 120.0

    def __post_init__(self) -> None:
        if not self.elevation_deg or not (np.diff(self.elevation_deg) < 0).all() or self.columns < 4:
            raise InvalidOption(
                f"{len(self.elevation_deg)} rings and {self.columns} columns; rings from the highest down and at least "
                "4 columns are expected"
            )
        if self.sigma_m < 0 or not 0 <= self.lost_share < 1 or not 0 <= self.nearest_m < self.farthest_m:
            raise InvalidOption(
                f"sigma_m {self.sigma_m}, lost_share {self.lost_share}, nearest_m {self.nearest_m}, farthest_m "
                f"{self.farthest_m}: zero or more, a share below 1, and nearest below farthest are expected"
            )

    def rays(self, columns: np.ndarray | None = None) -> np.ndarray:
        """(h, w, 3) unit directions in the sensor's frame, x forward, y left, z up; column 0 looks backwards.

        Args:
            columns: Numbers (w,) of the columns; None takes all.
        """
        columns = np.arange(self.columns) if columns is None else columns
        azimuth = _AZIMUTH_RAD - 2 * np.pi * columns / self.columns
        elevation = np.deg2rad(self.elevation_deg)[:, None]
        level = np.cos(elevation)
        return np.stack(
            np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)), axis=-1
        )

    def returned(self, range_m: np.ndarray, rng: np.random.Generator | None) -> np.ndarray:
        """Ranges (...) m as the sensor tells them; 0 where nothing comes back. None leaves noise and losses out."""
        kept = np.ones(range_m.shape, dtype=bool)
        if rng is not None:
            range_m = range_m + self.sigma_m * rng.standard_normal(range_m.shape)
            kept = rng.random(range_m.shape) >= self.lost_share
        return np.where(kept & (range_m >= self.nearest_m) & (range_m <= self.farthest_m), range_m, 0.0)


_AZIMUTH_RAD = np.pi
# Velodyne HDL-64E: two blocks of 32 lasers, a third of a degree apart above, half a degree below (its manual, 2008);
# at ten turns a second a shot is 0.1728 degrees from the next.
HDL_64 = LidarModel(
    elevation_deg=(*np.linspace(2.0, -8.33, 32).tolist(), *np.linspace(-8.83, -24.33, 32).tolist()),
    columns=2083,
    sigma_m=0.02,
    lost_share=0.05,
)


def scan_meshes(
    meshes: Sequence[trimesh.Trimesh],
    *,
    T_world_sensor: np.ndarray,
    lidar: LidarModel = HDL_64,
    ground_m: float | None = None,
    rng: np.random.Generator | None = None,
) -> tuple[RangeImage, np.ndarray]:
    """One turn among meshes, and a level ground under them.

    Args:
        meshes: World frame, m; open meshes are seen from both sides.
        T_world_sensor: (4, 4).
        lidar: Rings, shots and noise.
        ground_m: z of the ground; None leaves it out.
        rng: Draws noise and lost returns; None leaves both out.

    Returns:
        The scan, and index (h, w) int32 of the mesh that each shot met: len(meshes) is the ground, -1 nothing.

    Raises:
        InvalidMesh: A vertex is not finite or a face index points outside.
    """
    directions = lidar.rays() @ T_world_sensor[:3, :3].T
    flat = directions.reshape(-1, 3)
    origin = T_world_sensor[:3, 3]
    range_m, _, index = cast_rays([checked_mesh(mesh, i) for i, mesh in enumerate(meshes)], origin, flat)
    if ground_m is not None:
        to_ground = table_depth(flat, make_T(None, -origin), ground_m)
        under = to_ground < range_m
        range_m, index = np.where(under, to_ground, range_m), np.where(under, len(meshes), index)
    return scan_of_hits(range_m, index, lidar, T_world_sensor, rng)


def range_image(
    points: np.ndarray, *, lidar: LidarModel = HDL_64, T_world_sensor: np.ndarray | None = None
) -> RangeImage:
    """A scan that is a list of points, as a picture: of the points in one pixel the nearest is kept.

    Args:
        points: (n, 3) m, world frame; what lies outside of the rings is left out.
        lidar: The scanner's rings and shots.
        T_world_sensor: (4, 4); None has the sensor at the origin, as KITTI's scans have it.
    """
    shape = len(lidar.elevation_deg), lidar.columns
    T = np.eye(4) if T_world_sensor is None else T_world_sensor
    empty = RangeImage(np.zeros(shape), np.deg2rad(lidar.elevation_deg), _AZIMUTH_RAD, T)
    _, flat, _, range_m = pixels_of(points, empty)
    nearest = np.full(shape[0] * shape[1], np.inf)
    np.minimum.at(nearest, flat, range_m)
    return RangeImage(np.where(np.isfinite(nearest), nearest, 0.0).reshape(shape), empty.elevation_rad, _AZIMUTH_RAD, T)


def scan_of_hits(
    range_m: np.ndarray,
    index: np.ndarray,
    lidar: LidarModel,
    T_world_sensor: np.ndarray,
    rng: np.random.Generator | None,
) -> tuple[RangeImage, np.ndarray]:
    """The scan that a scanner makes of what its shots meet.

    Args:
        range_m: (h * w,) m, inf where nothing is met.
        index: (h * w,) what is met.
        lidar: Rings, shots and noise.
        T_world_sensor: (4, 4).
        rng: Draws noise and lost returns; None leaves both out.

    Returns:
        The scan, and what its returns met (h, w) int32, -1 where nothing came back.
    """
    shape = len(lidar.elevation_deg), lidar.columns
    seen = lidar.returned(range_m.reshape(shape), rng)
    image = RangeImage(seen, np.deg2rad(lidar.elevation_deg), _AZIMUTH_RAD, T_world_sensor)
    return image, np.where(seen > 0, index.reshape(shape), -1).astype(np.int32)
