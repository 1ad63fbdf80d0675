"""A trial as the simulator ran it, 25 frames a second, and the gripper that plays it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from gfp_grasp.drawing import every_nth, joined_boxes
from gfp_grasp.envs import GfpGraspEnv, run_trial
from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps import Gripper
from gfp_grasp.scenes import TARGET, gripper_pose
from gfp_grasp.transforms import quat_wxyz
from gfp_grasp.types import Grasp, Outcome
from gfp_grasp.view.colours import GRIPPER

if TYPE_CHECKING:
    import viser  # type: ignore[import-not-found]

FRAMES_PER_S = 25
GRIPPER_NODE = "/gripper"


@dataclass(frozen=True, eq=False)
class Motion:
    """Poses of gripper and object in the f frames of a trial.

    Attributes:
        outcome: Outcome of the trial.
        T_world_gripper: (f, 4, 4) poses of the gripper.
        opening_m: (f,) distance between the faces of the pads, m.
        T_world_object: (f, 4, 4) poses of the object.
        T_start: (4, 4) pose of the object before the trial.
    """

    outcome: Outcome
    T_world_gripper: np.ndarray
    opening_m: np.ndarray
    T_world_object: np.ndarray
    T_start: np.ndarray

    def __len__(self) -> int:
        return len(self.opening_m)

    def moved(self, frame: int) -> np.ndarray:
        """(4, 4) motion of the object since the trial began, in the world's frame."""
        return self.T_world_object[frame] @ np.linalg.inv(self.T_start)


def record_trial(env: GfpGraspEnv, grasp: Grasp) -> Motion:
    """Try a grasp in the scene of the env's episode, as `env.step` does, and record what moves.

    Args:
        env: Environment after a reset; its scene is left as it was before.
        grasp: Grasp in the world's frame.

    Returns:
        The motion; a trial that ends before its first frame has that frame alone.

    Raises:
        InvalidOption: The episode has no scene to try a grasp in.
    """
    world = env.world
    if world is None:
        raise InvalidOption("there is no scene to try the grasp in: completion failed; reset to another seed")
    every = max(1, round(1.0 / (FRAMES_PER_S * env.trial_settings.control_s)))
    T_start = world.pose(TARGET)
    grippers, openings, objects = [], [], []

    def shoot() -> None:
        T_world_gripper, opening_m = gripper_pose(world.model, world.data)
        grippers.append(T_world_gripper)
        openings.append(opening_m)
        objects.append(world.pose(TARGET))

    floats, on_step = env.config.world == "completed", every_nth(every, shoot)
    outcome = run_trial(world, grasp, env.trial_settings, floats=floats, on_step=on_step)
    shoot()
    world.restore()
    return Motion(outcome, np.stack(grippers), np.array(openings), np.stack(objects), T_start)


def gripper_meshes() -> dict[str, tuple[trimesh.Trimesh, float]]:
    """Meshes of body and closed jaws, gripper's frame, each with the sense in which it opens along y: 1, -1 or 0."""
    gripper = Gripper()
    boxes = gripper.solids(np.zeros(1))[0]
    num = len(gripper.jaw)
    pieces = {"left": (boxes[:num], 1.0), "right": (boxes[num : 2 * num], -1.0), "body": (boxes[2 * num :], 0.0)}
    return {name: (joined_boxes(some), sense) for name, (some, sense) in pieces.items()}


class MovingGripper:
    """A gripper in the scene, hidden until it is put somewhere."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._root = server.scene.add_frame(GRIPPER_NODE, show_axes=False, visible=False)
        self._jaws = []
        for name, (mesh, sense) in gripper_meshes().items():
            node = server.scene.add_mesh_simple(
                f"{GRIPPER_NODE}/{name}",
                np.asarray(mesh.vertices),
                np.asarray(mesh.faces),
                color=GRIPPER,
                flat_shading=True,
            )
            if sense:
                self._jaws.append((node, sense))

    def put(self, T_world_gripper: np.ndarray, opening_m: float) -> None:
        """Show it at a pose (4, 4) with its jaws open by a width."""
        self._root.wxyz = quat_wxyz(T_world_gripper[:3, :3])
        self._root.position = T_world_gripper[:3, 3]
        for jaw, sense in self._jaws:
            jaw.position = (0.0, sense * opening_m / 2.0, 0.0)
        self._root.visible = True

    def hide(self) -> None:
        """Take it out of sight."""
        self._root.visible = False
