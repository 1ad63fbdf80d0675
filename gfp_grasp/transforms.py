"""Rigid motions as (4, 4) float64 matrices, named T_to_from; quaternions say their order."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

# OpenGL and MuJoCo cameras look along -z with y up; OpenCV's look along +z with y down.
FLIP_YZ = np.diag([1.0, -1.0, -1.0, 1.0])
# Tolerance of R @ R.T: rotations in float32 or rounded text pass; a tenth of a degree of shear does not.
_RIGID = 1e-3


def is_rotation(R: np.ndarray) -> bool:
    """Whether a finite (3, 3) matrix only turns: it has no scale, no shear and no mirror."""
    return bool(np.allclose(R @ R.T, np.eye(3), atol=_RIGID) and np.linalg.det(R) > 0)


def make_T(R: ArrayLike | None = None, t: ArrayLike | None = None) -> np.ndarray:
    """(4, 4) transform of a (3, 3) rotation and a (3,) translation; each of them may be left out."""
    T = np.eye(4)
    if R is not None:
        T[:3, :3] = R
    if t is not None:
        T[:3, 3] = t
    return T


def apply_T(T: np.ndarray, points: ArrayLike) -> np.ndarray:
    """Transform (..., 3) points."""
    return np.asarray(points, dtype=np.float64) @ T[:3, :3].T + T[:3, 3]


def invert_T(T: np.ndarray) -> np.ndarray:
    """Inverse of a rigid (4, 4) transform."""
    R = T[:3, :3].T
    return make_T(R, -R @ T[:3, 3])


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products (..., 3) of vectors (..., 3), as numpy's own, which takes three to ten times as long."""
    answer = np.empty(np.broadcast_shapes(a.shape, b.shape), dtype=np.result_type(a, b))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        answer[..., i] = a[..., j] * b[..., k] - a[..., k] * b[..., j]
    return answer


def rotation_between(a: ArrayLike, b: ArrayLike) -> np.ndarray:
    """The smallest (3, 3) rotation that turns direction a onto direction b, both (3,) and not zero."""
    a = np.asarray(a, dtype=np.float64) / np.linalg.norm(a)
    b = np.asarray(b, dtype=np.float64) / np.linalg.norm(b)
    axis, cosine = np.cross(a, b), float(a @ b)
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        if cosine > 0:
            return np.eye(3)
        axis = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
        sine = np.linalg.norm(axis)
    return Rotation.from_rotvec(axis / sine * np.arccos(np.clip(cosine, -1.0, 1.0))).as_matrix()


def look_at(eye: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> np.ndarray:
    """T_world_camera (4, 4) of an OpenCV camera (x right, y down, z forward) at eye, looking at target."""
    eye, target, up = (np.asarray(a, dtype=np.float64) for a in (eye, target, up))
    z = (target - eye) / np.linalg.norm(target - eye)
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-9:  # looking along up: any horizontal x will do
        x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    return make_T(np.column_stack([x, np.cross(z, x), z]), eye)


def rotation_about(axis: ArrayLike, angle_rad: float) -> np.ndarray:
    """(3, 3) rotation by an angle about an axis (3,) of any length but zero."""
    axis = np.asarray(axis, dtype=np.float64)
    return Rotation.from_rotvec(axis / np.linalg.norm(axis) * angle_rad).as_matrix()


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """(3, 3) rotation, uniform over SO(3)."""
    return Rotation.random(rng=rng).as_matrix()


def quat_wxyz(R: np.ndarray) -> np.ndarray:
    """Unit quaternion (4,), scalar first, of a (3, 3) rotation."""
    return Rotation.from_matrix(R).as_quat(scalar_first=True)
