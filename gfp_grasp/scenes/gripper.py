"""Names and placing of the gripper in sim_scenes/gripper.xml."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np

from gfp_grasp.errors import InvalidScene
from gfp_grasp.transforms import quat_wxyz

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
