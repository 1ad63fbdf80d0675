"""Views of a class by the sensor that meets it: a LiDAR in traffic, else a depth camera."""

from __future__ import annotations

from pathlib import Path

from gfp_grasp.shapes import TRAFFIC
from gfp_grasp.train.scans import ScansConfig
from gfp_grasp.train.views import View, ViewsConfig, cached_views
from gfp_grasp.types import LIDAR, TABLETOP, SensorProfile


def class_sensor(name: str) -> SensorProfile:
    """The sensor that meets a class; one that is no procedural family stands on a table."""
    return LIDAR if name in TRAFFIC else TABLETOP


def class_views(
    name: str,
    split: str,
    *,
    num_views: int,
    limit: int | None = None,
    sensor: SensorProfile | None = None,
    runs: Path = Path("runs"),
    workers: int = 1,
    data: Path | None = None,
) -> list[View]:
    """Cached views of a class.

    Args:
        name: Class.
        split: "train", "val" or "test".
        num_views: Views of each shape.
        limit: At most so many shapes; None takes the whole split.
        sensor: What sees it; None is the sensor that meets the class.
        runs: Folder of the caches.
        workers: Processes that render.
        data: Folder of meshes, as `read_dataset` takes it; None takes procedural shapes.
    """
    sensor = sensor or class_sensor(name)
    return cached_views(
        name,
        split,
        num_views=num_views,
        limit=limit,
        folder=runs / "views",
        workers=workers,
        config=ScansConfig() if sensor.of_traffic else ViewsConfig(),
        data=data,
    )
