"""A trial as a film: pictures of the simulator while the grasp is tried."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gfp_grasp.envs import TrialSettings, run_trial, shade
from gfp_grasp.scenes import TARGET, World
from gfp_grasp.transforms import look_at, rotation_about
from gfp_grasp.types import Grasp, Outcome

# 160 ms of simulation between two frames, which are shown for 80 ms each.
_COMMANDS_A_FRAME = 16
FRAME_PX = (400, 300)
# The camera looks down by this much, from the front right unless the jaws close along its line of sight. It has the
# object in view where it stands, and the whole gripper at the top of the lift.
_FRONT, _ELEVATION_RAD, _LOOK_AT_M = np.array([0.76, -0.65, 0.0]), np.deg2rad(20.0), 0.24
_ALONE_M, _CLUTTER_M = 0.92, 1.0
_UPRIGHT_JAWS = 0.3  # jaws that close with less than this along the level look the same from every side
_FROM_THE_SIDE, _OBLIQUE_RAD, _UP = 0.5, np.deg2rad(55.0), np.array([0.0, 0.0, 1.0])


def filmed_trial(
    world: World,
    grasp: Grasp,
    settings: TrialSettings | None = None,
    *,
    target: str = TARGET,
    alone: bool,
    commands_a_frame: int = _COMMANDS_A_FRAME,
) -> tuple[Outcome, list[np.ndarray]]:
    """Run a trial as `gfp_grasp.envs.run_trial` does, and take pictures of it.

    Args:
        world: Objects at rest; left as the trial ends.
        grasp: Grasp in the world's frame.
        settings: Numbers of the trial.
        target: Name of the object.
        alone: Whether nothing else stands on the table: the camera is nearer then.
        commands_a_frame: Commands of the gripper between two pictures.

    Returns:
        The outcome, and frames (h, w, 3) uint8; the last frame shows how the trial ended.
    """
    width, height = FRAME_PX
    T_world_camera = film_camera(grasp, alone=alone)
    frames: list[np.ndarray] = []

    def shoot() -> None:
        frames.append(shade(world.model, world.data, width=width, height=height, T_world_camera=T_world_camera))

    on_step = every_nth(commands_a_frame, shoot)
    outcome = run_trial(world, grasp, settings, target=target, on_step=on_step)
    shoot()
    return outcome, frames


def every_nth(num: int, act: Callable[[], None]) -> Callable[[object], None]:
    """A function for `on_step` of `run_trial` that acts at its calls 0, num, 2 num and so on."""
    calls = 0

    def on_step(_: object) -> None:
        nonlocal calls
        if calls % num == 0:
            act()
        calls += 1

    return on_step


def film_camera(grasp: Grasp, *, alone: bool) -> np.ndarray:
    """T_world_camera (4, 4) that looks across the closing axis, so that both jaws show.

    A gripper that comes from the side is looked at obliquely from behind, so that neither it nor the object is hidden.
    """
    closing = grasp.T_world_gripper[:3, 1] * (1.0, 1.0, 0.0)
    behind = -grasp.T_world_gripper[:3, 2] * (1.0, 1.0, 0.0)
    towards = _FRONT
    if np.linalg.norm(behind) > _FROM_THE_SIDE:
        sides = [rotation_about(_UP, sign * _OBLIQUE_RAD) @ behind / np.linalg.norm(behind) for sign in (-1.0, 1.0)]
        towards = max(sides, key=lambda side: float(side @ _FRONT))
    elif np.linalg.norm(closing) > _UPRIGHT_JAWS:
        across = np.cross((0.0, 0.0, 1.0), closing / np.linalg.norm(closing))
        towards = across if across @ _FRONT > 0 else -across
    level, height = np.cos(_ELEVATION_RAD) * towards, np.array([0.0, 0.0, np.sin(_ELEVATION_RAD)])
    target = np.array([0.0, 0.0, _LOOK_AT_M])
    return look_at(target + (_ALONE_M if alone else _CLUTTER_M) * (level + height), target)
