"""Where the bodies and the meshes of a compiled MuJoCo model are at its start."""

# MuJoCo's Python stubs leave out what its C module defines.
# pyright: reportAttributeAccessIssue=false

from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from gfp_grasp.transforms import make_T


def matrix_of(quat_wxyz: ArrayLike) -> np.ndarray:
    """(3, 3) rotation of MuJoCo's quaternion."""
    R = np.zeros(9)
    mujoco.mju_quat2Mat(R, np.asarray(quat_wxyz, dtype=float))
    return R.reshape(3, 3)


def pose_of(body: Any) -> np.ndarray:
    """T_world_body (4, 4) of a body, `model.body(name)`, whose parent is the world."""
    return make_T(matrix_of(body.quat), body.pos)


def bounds_of(model: mujoco.MjModel, name: str) -> np.ndarray:
    """Lowest and highest coordinates (2, 3) m, world, of the mesh of a geom."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mesh = model.geom(name).dataid[0]
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    points = model.mesh_vert[start : start + count] @ data.geom(name).xmat.reshape(3, 3).T + data.geom(name).xpos
    return np.array([points.min(axis=0), points.max(axis=0)])
