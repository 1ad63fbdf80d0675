"""How fast a held object moves in the jaws: a simulator's own slip, which no grasp is to blame for."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from gfp_grasp.envs.rig import Rig
from gfp_grasp.envs.settings import TrialSettings
from gfp_grasp.envs.trial import run_trial
from gfp_grasp.envs.world import TARGET, World
from gfp_grasp.transforms import invert_T
from gfp_grasp.types import Grasp

_SETTLES_S = 1.0


def creep_mps(world: World, grasp: Grasp, settings: TrialSettings, *, seconds: float = 3.0) -> float | None:
    """Speed of the object in the gripper while it hangs there at rest, from one second after the lift on.

    Args:
        world: Scene with the object at rest, which is restored first.
        grasp: World frame.
        settings: Of the attempt; its hold is made longer.
        seconds: Time over which the speed is taken.

    Returns:
        m/s, of the object's point at the gripper's origin, as slip is measured; None where the attempt ended before.
    """
    world.restore()
    rig = Rig.of(world.model, world.data, TARGET)
    began = world.data.time
    times, poses = [], []

    def note(data: mujoco.MjData) -> None:
        times.append(data.time - began)
        poses.append(invert_T(rig.T_world_gripper) @ rig.T_world_target)

    held = replace(settings, hold_s=_SETTLES_S + seconds)
    run_trial(world.model, world.data, grasp, held, target=TARGET, on_step=note)
    start = held.approach_s + held.close_s + held.lift_s + _SETTLES_S
    first, last = np.searchsorted(times, (start - 1e-9, start + seconds - 1e-9))
    if last >= len(times):
        return None
    moved = (poses[last] @ invert_T(poses[first]))[:3, 3]
    return float(np.linalg.norm(moved) / (times[last] - times[first]))
