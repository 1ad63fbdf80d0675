"""How fast MuJoCo steps, alone and with an object in the gripper."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import importlib.util
import time
from types import SimpleNamespace

import mujoco

from gfp_grasp.scenes import TARGET, Handles, SceneObject, World
from gfp_grasp.types import ConvexPart, Grasp

_MASS_KG, _FRICTION = 0.2, 0.8


def held_steps_per_s(parts: tuple[ConvexPart, ...], grasp: Grasp, *, steps: int = 400) -> float:
    """Steps a second of MuJoCo with the jaws of a gripper closed on convex parts.

    Args:
        parts: World frame, above a table at z = 0 or lifted onto it.
        grasp: Where the jaws close, world frame.
        steps: So many to close, and so many that are timed.
    """
    world = World([SceneObject.of_parts(parts, _MASS_KG, _FRICTION)])
    handles = Handles.of(world, TARGET)
    handles.place(grasp.T_world_gripper, grasp.width_m + 0.01)
    handles.set_opening(0.0)
    mujoco.mj_step(world.model, world.data, steps)
    start = time.perf_counter()
    mujoco.mj_step(world.model, world.data, steps)
    return round(steps / (time.perf_counter() - start), 1)


def fetch_steps_per_s(*, seconds: float = 3.0) -> float | None:
    """Physics steps a second of FetchPickAndPlace-v4 in its own `step`; None without gymnasium-robotics."""
    if importlib.util.find_spec("gymnasium_robotics") is None:
        return None
    import gymnasium
    from gymnasium_robotics.utils import mujoco_utils  # registers the environment, too

    # Release 1.4.2 looks for a number among MuJoCo's constants, and those of 3.17 are equal to none from that side.
    kinds = SimpleNamespace(**{name: int(kind) for name, kind in mujoco.mjtJoint.__members__.items()})
    mujoco_utils.mujoco = SimpleNamespace(**{**vars(mujoco), "mjtJoint": kinds})
    env = gymnasium.make("FetchPickAndPlace-v4")
    env.action_space.seed(0)
    env.reset(seed=0)
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        steps += 1
        if terminated or truncated:
            env.reset()
    rate = steps * env.unwrapped.n_substeps / (time.perf_counter() - start)  # pyright: ignore[reportAttributeAccessIssue]
    env.close()
    return round(rate, 1)


class TimedStep:
    """MuJoCo's own step that adds up the time it takes.

    Attributes:
        seconds: In all.
        steps: Their number.
    """

    def __init__(self) -> None:
        self.seconds, self.steps = 0.0, 0

    def __call__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        start = time.perf_counter()
        mujoco.mj_step(model, data)
        self.seconds += time.perf_counter() - start
        self.steps += 1
