"""MuJoCo's own viewer on an episode, for people at a screen."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import os
import sys
import time
from typing import Any

import mujoco

from gfp_grasp.errors import InvalidOption


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
