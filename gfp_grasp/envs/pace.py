"""How fast MuJoCo steps, alone and with an object in the gripper."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import time

import mujoco

from gfp_grasp.envs.rig import Rig
from gfp_grasp.envs.world import TARGET, World
from gfp_grasp.types import ConvexPart, Grasp

_MASS_KG, _FRICTION = 0.2, 0.8


def held_steps_per_s(parts: tuple[ConvexPart, ...], grasp: Grasp, *, steps: int = 400) -> float:
    """Steps a second of MuJoCo with the jaws of a gripper closed on convex parts.

    Args:
        parts: World frame, above a table at z = 0 or lifted onto it.
        grasp: Where the jaws close, world frame.
        steps: So many to close, and so many that are timed.
    """
    world = World.of_parts(parts, _MASS_KG, _FRICTION)
    rig = Rig.of(world.model, world.data, TARGET)
    rig.place(grasp.T_world_gripper, grasp.width_m + 0.01)
    rig.set_opening(0.0)
    mujoco.mj_step(world.model, world.data, steps)
    start = time.perf_counter()
    mujoco.mj_step(world.model, world.data, steps)
    return round(steps / (time.perf_counter() - start), 1)


class TimedStep:
    """MuJoCo's own step that adds up the time it takes.

    Attributes:
        seconds: In all.
    """

    def __init__(self) -> None:
        self.seconds = 0.0

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        start = time.perf_counter()
        mujoco.mj_step(model, data)
        self.seconds += time.perf_counter() - start
