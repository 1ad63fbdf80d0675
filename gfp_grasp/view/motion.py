"""An attempt as the simulator ran it: where gripper and object were, 25 times a second."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gfp_grasp.envs import GfpGraspEnv, run_trial
from gfp_grasp.envs.world import TARGET
from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes.gripper import gripper_pose
from gfp_grasp.types import Grasp, Outcome

FRAMES_PER_S = 25


@dataclass(frozen=True, eq=False)
class Motion:
    """What moved during an attempt, f frames of it.

    Attributes:
        outcome: What happened.
        T_world_gripper: (f, 4, 4).
        opening_m: (f,) between the faces of the pads.
        T_world_object: (f, 4, 4).
        T_start: (4, 4), the object before the attempt.
    """

    outcome: Outcome
    T_world_gripper: np.ndarray
    opening_m: np.ndarray
    T_world_object: np.ndarray
    T_start: np.ndarray

    def __len__(self) -> int:
        return len(self.opening_m)

    def moved(self, frame: int) -> np.ndarray:
        """(4, 4) motion of the object since the attempt began, in the world's frame."""
        return self.T_world_object[frame] @ np.linalg.inv(self.T_start)


def record_trial(env: GfpGraspEnv, grasp: Grasp) -> Motion:
    """Attempt a grasp in the scene of the env's episode, as `env.step` does, and record what moves.

    Args:
        env: After a reset; its scene is left as it was before.
        grasp: World frame.

    Returns:
        The attempt; of one that ends before its first frame, that frame alone.

    Raises:
        InvalidOption: The episode has no scene to try a grasp in.
    """
    world = env.world
    if world is None:
        raise InvalidOption("there is no scene to try the grasp in: completion failed; reset to another seed")
    world.restore()
    every = max(1, round(1.0 / (FRAMES_PER_S * env.settings.control_s)))
    T_start = world.T_world_object
    grippers, openings, objects, commands = [], [], [], 0

    def shoot() -> None:
        T_world_gripper, opening_m = gripper_pose(world.model, world.data)
        grippers.append(T_world_gripper)
        openings.append(opening_m)
        objects.append(world.T_world_object)

    def watch(_: object) -> None:
        nonlocal commands
        if commands % every == 0:
            shoot()
        commands += 1

    floats = env.config.world == "completed"
    outcome = run_trial(world.model, world.data, grasp, env.trial_settings, target=TARGET, floats=floats, on_step=watch)
    shoot()
    world.restore()
    return Motion(outcome, np.stack(grippers), np.array(openings), np.stack(objects), T_start)
