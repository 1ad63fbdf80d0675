"""Pictures of an episode's scene: shaded by casting rays, where there may be no OpenGL, and MuJoCo's own viewer."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

import mujoco
import numpy as np

from gfp_grasp.camera import intrinsics, render_depth, surface_normals
from gfp_grasp.errors import InvalidOption
from gfp_grasp.transforms import look_at
from gfp_grasp.types import DepthImage

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false


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


# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false


def has_display() -> bool:
    """Whether a window can be opened, as far as the environment's variables tell."""
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(named) or not sys.platform.startswith("linux")


class HumanView:
    """A window that follows one state at a time, as fast as the clock and no faster."""

    def __init__(self) -> None:
        """Look for a screen; the window opens with the first state.

        Raises:
            InvalidOption: There is no display to open it on.
        """
        if not has_display():
            raise InvalidOption(
                "render_mode 'human' opens a window, and there is no display: take 'rgb_array', or gfp-grasp view"
            )
        self._model: mujoco.MjModel | None = None
        self._window: Any = None
        self._ahead_s = 0.0  # the clock's time less that of the state

    def show(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Show a state, in a new window where it is of another model; a window that was closed stays so."""
        if model is not self._model:
            self.close()
            import mujoco.viewer

            self._model, self._window = model, mujoco.viewer.launch_passive(model, data)
        self._ahead_s = time.monotonic() - data.time
        if self._window.is_running():
            self._window.sync()

    def follow(self, data: mujoco.MjData) -> None:
        """Show the same state later on, and wait until it is its time."""
        if self._window is None or not self._window.is_running():
            return
        self._window.sync()
        time.sleep(max(0.0, data.time + self._ahead_s - time.monotonic()))

    def close(self) -> None:
        """Close the window."""
        if self._window is not None:
            self._window.close()
        self._model = self._window = None
