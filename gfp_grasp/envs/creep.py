"""How fast a held object moves in the jaws: a simulator's own slip, which no grasp is to blame for."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from gfp_grasp.envs.settings import TrialSettings
from gfp_grasp.envs.trial import run_trial
from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes import TARGET, Handles, World
from gfp_grasp.transforms import invert_T
from gfp_grasp.types import Grasp

_SETTLES_S = 1.0


def creep_mps(world: World, grasp: Grasp, settings: TrialSettings, *, seconds: float = 3.0) -> float | None:
    """Speed of the object in the gripper while it hangs there at rest, from one second after the lift on.

    Args:
        world: Scene with the object at rest, which is restored first.
        grasp: World frame.
        settings: Of the attempt; its hold is made longer.
        seconds: Time over which the speed is taken, s.

    Returns:
        m/s, of the object's point at the gripper's origin, as slip is measured; None where the attempt ended before.

    Raises:
        InvalidOption: seconds is not a positive number.
    """
    if not 0 < seconds < float("inf"):
        raise InvalidOption(f"seconds is {seconds}; a positive finite number is expected")
    handles = Handles.of(world, TARGET)
    poses: list[np.ndarray] = []

    def note(_: mujoco.MjData) -> None:
        poses.append(invert_T(handles.T_world_gripper) @ handles.T_world_target)

    held = replace(settings, hold_s=_SETTLES_S + seconds)
    run_trial(world, grasp, held, on_step=note)
    # The attempt lasts a whole number of commands; the last of them at rest is that at the end of the hold.
    phases = (held.approach_s, held.close_s, held.lift_s, held.hold_s)
    last = sum(max(1, round(phase / held.control_s)) for phase in phases) - 1
    first = last - max(1, round(seconds / held.control_s))
    if last >= len(poses):
        return None
    moved = (poses[last] @ invert_T(poses[first]))[:3, 3]
    command_s = max(1, round(held.control_s / world.model.opt.timestep)) * world.model.opt.timestep
    return float(np.linalg.norm(moved) / ((last - first) * command_s))
