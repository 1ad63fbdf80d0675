"""Handles on the gripper of sim_scenes/gripper.xml and on the object inside of a compiled scene."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from gfp_grasp.errors import InvalidScene
from gfp_grasp.scenes.world import World
from gfp_grasp.transforms import make_T, quat_wxyz
from gfp_grasp.types import Grasp

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false


PADS = ("pad_left", "pad_right")  # geoms
FINGERS = ("finger_left", "finger_right")  # geoms, joints and bodies
PALM = ("palm",)  # geom
BODY = "gripper"
MOCAP = "gripper_mocap"
FREE_JOINT = "gripper_free"
ACTUATOR = "grip"
SITE = "grip_center"
STROKE_M = 0.08
FORCE_N = 30.0
SQUEEZE = -0.02  # control at which the actuator presses with all its force, however thin the thing held


def place_gripper(model: mujoco.MjModel, data: mujoco.MjData, T_world_gripper: np.ndarray, width_m: float) -> None:
    """Put the gripper somewhere at once, at rest, its jaws open by a width; forward kinematics are brought up to date.

    Raises:
        InvalidScene: The model has no gripper.
    """
    if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, BODY) < 0:
        raise InvalidScene("the scene has no gripper: build it with gripper=True")
    move_gripper(model, data, T_world_gripper)
    free = model.joint(FREE_JOINT)
    at, speed = free.qposadr[0], free.dofadr[0]
    data.qpos[at : at + 3] = T_world_gripper[:3, 3]
    data.qpos[at + 3 : at + 7] = quat_wxyz(T_world_gripper[:3, :3])
    data.qvel[speed : speed + 6] = 0.0
    opening = float(np.clip(width_m, 0.0, STROKE_M))
    for finger in FINGERS:
        joint = model.joint(finger)
        data.qpos[joint.qposadr[0]] = opening / 2
        data.qvel[joint.dofadr[0]] = 0.0
    data.ctrl[model.actuator(ACTUATOR).id] = opening
    mujoco.mj_forward(model, data)


def move_gripper(model: mujoco.MjModel, data: mujoco.MjData, T_world_gripper: np.ndarray) -> None:
    """Set where the gripper is to go; it follows as the simulation steps, 2.5 mm behind at 0.25 m/s."""
    mocap = model.body(MOCAP).mocapid[0]
    data.mocap_pos[mocap] = T_world_gripper[:3, 3]
    data.mocap_quat[mocap] = quat_wxyz(T_world_gripper[:3, :3])


def gripper_pose(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[np.ndarray, float]:
    """T_world_gripper (4, 4) of the gripper as it is, and the opening between its pads, m."""
    body = data.body(BODY)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = body.xmat.reshape(3, 3), body.xpos
    return T, float(sum(data.qpos[model.joint(finger).qposadr[0]] for finger in FINGERS))


# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false


_WARNINGS = [
    int(warning)
    for warning in (
        mujoco.mjtWarning.mjWARN_BADQPOS,
        mujoco.mjtWarning.mjWARN_BADQVEL,
        mujoco.mjtWarning.mjWARN_BADQACC,
        mujoco.mjtWarning.mjWARN_CNSTRFULL,  # contacts were left out for want of memory
    )
]


@dataclass(frozen=True, eq=False)
class Handles:
    """Where to find the gripper and one object in a compiled scene and its state.

    Attributes:
        model: The scene.
        data: State of the scene, which moves on.
        target: Body id of the object.
        gripper: Body id of the gripper.
        mocap: Index of the mocap body that it hangs on.
        servo: Actuator id of the jaws.
        is_gripper: (ngeom,) bool, geoms of the gripper.
        is_pad: (ngeom,) bool, its pads.
        is_target: (ngeom,) bool, geoms of the object.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    target: int
    gripper: int
    mocap: int
    servo: int
    is_gripper: np.ndarray
    is_pad: np.ndarray
    is_target: np.ndarray

    @classmethod
    def of(cls, world: World, target: str) -> Handles:
        """Find the gripper of sim_scenes/gripper.xml and a body by name.

        Raises:
            InvalidScene: The scene has no gripper, or no such body.
        """
        model = world.model
        bodies = {name: mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name) for name in (BODY, MOCAP, target)}
        missing = [name for name, number in bodies.items() if number < 0]
        if missing:
            raise InvalidScene(
                f"the scene has no body {', '.join(missing)}: build it with gripper=True and the object in it"
            )
        is_pad = np.zeros(model.ngeom, dtype=bool)
        is_pad[[model.geom(name).id for name in PADS]] = True
        return cls(
            model=model,
            data=world.data,
            target=bodies[target],
            gripper=bodies[BODY],
            mocap=int(model.body_mocapid[bodies[MOCAP]]),
            servo=model.actuator(ACTUATOR).id,
            is_gripper=model.body_rootid[model.geom_bodyid] == bodies[BODY],
            is_pad=is_pad,
            is_target=model.geom_bodyid == bodies[target],
        )

    @property
    def T_world_gripper(self) -> np.ndarray:
        """(4, 4) of the gripper as it is, which lags behind its commands."""
        return self._pose(self.gripper)

    @property
    def T_world_target(self) -> np.ndarray:
        """(4, 4) of the object."""
        return self._pose(self.target)

    def reaches(self, grasp: Grasp) -> bool:
        """Whether the jaws open as wide as the grasp asks for."""
        return grasp.width_m <= STROKE_M + 1e-6

    def place(self, T_world_gripper: np.ndarray, opening_m: float) -> None:
        """Put the gripper somewhere at once, at rest and open."""
        place_gripper(self.model, self.data, T_world_gripper, opening_m)

    @property
    def commanded(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the gripper is to go, (3,) m and a unit quaternion (4,), to be written to."""
        return self.data.mocap_pos[self.mocap], self.data.mocap_quat[self.mocap]

    def pose_of(self, body: int) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (3, 3) and position (3,) m of a body, as the state has them: they change with it."""
        return self.data.xmat[body].reshape(3, 3), self.data.xpos[body]

    def set_force_limit(self, grip_n: float) -> None:
        """Largest force of each jaw."""
        self.model.actuator_forcerange[self.servo] = (-grip_n, grip_n)

    def set_weight(self, share: float) -> None:
        """Share of its weight that the object feels."""
        self.model.body_gravcomp[self.target] = 1.0 - share

    def set_opening(self, opening_m: float) -> None:
        """Opening that the jaws are to take; nothing can keep them from pressing where it is below zero."""
        self.data.ctrl[self.servo] = max(opening_m, SQUEEZE)

    def open_jaws(self) -> None:
        """Open the jaws as wide as they go."""
        self.set_opening(STROKE_M)

    def largest_force_n(self) -> float:
        """Largest normal force between the gripper and anything else."""
        pairs = self.data.contact.geom
        others = np.flatnonzero(self.is_gripper[pairs[:, 0]] != self.is_gripper[pairs[:, 1]])
        force, largest = np.zeros(6), 0.0
        for contact in others:
            mujoco.mj_contactForce(self.model, self.data, int(contact), force)
            largest = max(largest, float(force[0]))
        return largest

    def touching_pads(self) -> int:
        """How many of the two pads touch the object."""
        pairs = self.data.contact.geom
        pads = pairs[self.is_pad[pairs] & self.is_target[pairs[:, ::-1]]]
        return len(set(pads.tolist()))

    def is_unstable(self, too_fast_mps: float) -> bool:
        """Whether the state is not finite, MuJoCo has warned of it, or the object is faster than anything sound."""
        if self.data.warning.number[_WARNINGS].any():
            return True
        # What is not finite leaves no finite sum, and a sum of finite numbers below 1e300 is finite.
        if not (np.isfinite(self.data.qpos.sum()) and np.isfinite(self.data.qvel.sum())):
            return True
        speed = self.data.cvel[self.target, 3:]
        return bool(speed @ speed > too_fast_mps**2)

    def _pose(self, body: int) -> np.ndarray:
        return make_T(*self.pose_of(body))
