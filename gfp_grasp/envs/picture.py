"""A shaded picture of a scene by casting rays, where there may be no OpenGL."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np

from gfp_grasp.camera import intrinsics, render_depth, surface_normals
from gfp_grasp.transforms import look_at
from gfp_grasp.types import DepthImage

# A camera that has table, object and lifted gripper in view.
OVERVIEW = look_at((0.85, -0.65, 0.62), (0.0, 0.0, 0.17))
_OVERVIEW_FOV_DEG = 35.0
_SKY = np.array([0.92, 0.94, 0.97])
_LIGHT = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
# Each pixel is cast as 2 by 2 and averaged, for smooth edges.
_SUPERSAMPLE = 2


def shade(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    width: int = 320,
    height: int = 240,
    T_world_camera: np.ndarray = OVERVIEW,
    fov_deg: float = _OVERVIEW_FOV_DEG,
) -> np.ndarray:
    """Picture (h, w, 3) uint8 of the scene as it stands, coloured by geom and shaded by the angle to a lamp.

    Args:
        model: The scene.
        data: State of the scene.
        width: Columns.
        height: Rows.
        T_world_camera: (4, 4), OpenCV camera.
        fov_deg: Vertical field of view.
    """
    wide, high = _SUPERSAMPLE * width, _SUPERSAMPLE * height
    K = intrinsics(wide, high, fov_deg)
    depth, geom = render_depth(
        model, data, K=K, width=wide, height=high, T_world_camera=T_world_camera, backend="rays", farthest_m=10.0
    )
    normals = surface_normals(DepthImage(depth, K, T_world_camera)) @ T_world_camera[:3, :3].T
    facing = np.nan_to_num(normals @ _LIGHT, nan=0.5)
    colours = model.geom_rgba[np.maximum(geom, 0), :3] * (0.45 + 0.55 * np.clip(facing, 0.0, 1.0))[..., None]
    colours = np.where((geom >= 0)[..., None], colours, _SKY)
    small = colours.reshape(height, _SUPERSAMPLE, width, _SUPERSAMPLE, 3).mean(axis=(1, 3))
    return (255 * np.clip(small, 0.0, 1.0)).astype(np.uint8)
