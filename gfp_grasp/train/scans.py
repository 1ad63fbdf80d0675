"""Partial views of traffic as a spinning LiDAR has them: what a network for that sensor learns from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from gfp_grasp.camera import HDL_64, cast_rays
from gfp_grasp.clouds import thin
from gfp_grasp.errors import InvalidOption
from gfp_grasp.transforms import make_T, rotation_about

_ASIDE_RAD = 0.01  # the look goes beyond the outline by this
_FROM_BELOW = 0.3  # of what is hidden: behind something low; the rest is hidden from one side


@dataclass(frozen=True)
class ScansConfig:
    """How scans of single things are drawn.

    Attributes:
        distance_m: Range of the distance from the sensor, drawn by its logarithm.
        height_m: Range of the sensor's height above the ground.
        hidden_share: Share of scans of which an occluder hides a part.
        lost_share: Largest share of the returns that are lost; each scan has one of its own.
        least_points: A scan of fewer is drawn anew.
        num_points: Most points that are kept of one.
    """

    distance_m: tuple[float, float] = (4.0, 45.0)
    height_m: tuple[float, float] = (1.5, 2.0)
    hidden_share: float = 0.35
    lost_share: float = 0.3
    least_points: int = 30
    num_points: int = 1500

    def __post_init__(self) -> None:
        if not (0 <= self.hidden_share <= 1 and 0 <= self.lost_share < 1):
            raise InvalidOption("hidden_share and lost_share must be shares between 0 and 1")


def scan_of(
    mesh: trimesh.Trimesh, rng: np.random.Generator, config: ScansConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """One scan of a mesh that stands on z = 0, turned and moved at random.

    Returns:
        Points (n, 3) m, viewpoint (3,) m and T_world_object (4, 4); None where too little of it is in sight.
    """
    T = make_T(rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)), (0.0, 0.0, 0.0))
    vertices = np.asarray(mesh.vertices) @ T[:3, :3].T
    distance_m = np.exp(rng.uniform(*np.log(config.distance_m)))
    towards = rng.uniform(0, 2 * np.pi)
    # The distance is that of the nearest side, or the sensor would be inside of a bus.
    reach_m = np.linalg.norm(vertices[:, :2], axis=1).max()
    away_m = distance_m + reach_m
    eye = np.array([away_m * np.cos(towards), away_m * np.sin(towards), rng.uniform(*config.height_m)])
    lidar = replace(HDL_64, lost_share=rng.uniform(0.0, config.lost_share))
    T_sensor = make_T(rotation_about((0, 0, 1), towards + np.pi), eye)
    local = (vertices - eye) @ T_sensor[:3, :3]
    azimuth = np.arctan2(local[:, 1], local[:, 0])
    middle, step = lidar.columns / 2, 2 * np.pi / lidar.columns
    first, last = middle - (azimuth.max() + _ASIDE_RAD) / step, middle - (azimuth.min() - _ASIDE_RAD) / step
    rays = lidar.rays(np.arange(int(first), int(last) + 1))
    flat = (rays @ T_sensor[:3, :3].T).reshape(-1, 3)
    met, _, _ = cast_rays([(vertices, np.asarray(mesh.faces))], eye, flat)
    range_m = lidar.returned(met.reshape(rays.shape[:2]), rng)
    if rng.random() < config.hidden_share:
        range_m = _behind_something(range_m, rng)
    points = (eye + range_m.reshape(-1, 1) * flat)[range_m.ravel() > 0]
    if len(points) < config.least_points:
        return None
    return thin(points, config.num_points), eye, T


def _behind_something(range_m: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Ranges (h, w) without those beyond an edge: from below, as a parked car hides legs, or from a side."""
    row, column = np.nonzero(range_m)
    if not len(row):
        return range_m
    along = -row if rng.random() < _FROM_BELOW else column * rng.choice([-1, 1])
    hidden = along < np.quantile(along, rng.uniform(0.1, 0.6))
    kept = range_m.copy()
    kept[row[hidden], column[hidden]] = 0.0
    return kept
