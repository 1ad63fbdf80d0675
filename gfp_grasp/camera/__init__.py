"""Depth pictures and LiDAR scans: geometry, a sensor's noise, viewpoints, and renderers with and without OpenGL.

`render_depth` and `scan_scene` need MuJoCo and load it at first use; everything else here is numpy, scipy and Embree.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.camera.cast import cast_rays, render_mesh_view, visible_points
from gfp_grasp.camera.frames import SensorFrame, sensor_frame
from gfp_grasp.camera.lidar import HDL_64, LidarModel, range_image, scan_meshes
from gfp_grasp.camera.pinhole import (
    camera_points,
    cloud_of,
    intrinsics,
    mask_of_points,
    pixel_rays,
    sample_viewpoint,
    surface_normals,
    view_from_points,
)
from gfp_grasp.camera.sensor import SensorModel, apply_sensor

if TYPE_CHECKING:
    from gfp_grasp.camera.render import render_depth, scan_scene

__all__ = [
    "HDL_64",
    "LidarModel",
    "SensorFrame",
    "SensorModel",
    "apply_sensor",
    "camera_points",
    "cast_rays",
    "cloud_of",
    "intrinsics",
    "mask_of_points",
    "pixel_rays",
    "range_image",
    "render_depth",
    "render_mesh_view",
    "sample_viewpoint",
    "scan_meshes",
    "scan_scene",
    "sensor_frame",
    "surface_normals",
    "view_from_points",
    "visible_points",
]


def __getattr__(name: str) -> object:
    if name in ("render_depth", "scan_scene"):
        return getattr(import_module("gfp_grasp.camera.render"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
