"""Clearance of the gripper on its way in: swept boxes against surface points and against the support."""

from itertools import product

import numpy as np

from gfp_grasp.grasps.gripper import Gripper
from gfp_grasp.types import SupportPlane

# Poses times points that are held at once: 2 M single-precision triples are 24 MB.
_CHUNK = 2_000_000


def clearance_around(
    T_world_gripper: np.ndarray,
    opening_m: np.ndarray,
    points: np.ndarray,
    *,
    gripper: Gripper,
    standoff_m: float,
) -> np.ndarray:
    """Smallest gap between the gripper, swept along a straight approach, and points.

    Args:
        T_world_gripper: (p, 4, 4) final poses.
        opening_m: (p,) jaw openings.
        points: (n, 3) m, world frame.
        gripper: The boxes of the gripper.
        standoff_m: Length of the approach along the gripper's z.

    Returns:
        (p,) m in the largest norm of the gripper's axes; negative where a point is inside of a swept box.
    """
    boxes = gripper.swept(opening_m, standoff_m)
    clearance = np.empty(len(boxes))
    for some, local in _in_gripper_frame(T_world_gripper, points):
        gaps = [_gap(local, boxes[some, b].astype(np.float32)) for b in range(boxes.shape[1])]
        clearance[some] = np.min(gaps, axis=0)
    return clearance


def height_above(
    T_world_gripper: np.ndarray, opening_m: np.ndarray, support: SupportPlane, *, gripper: Gripper, standoff_m: float
) -> np.ndarray:
    """Height (p,) m of the lowest corner of the gripper above the support, anywhere on its straight approach."""
    boxes = gripper.solids(opening_m)
    corners = np.stack([boxes[:, :, [i, j, k], [0, 1, 2]] for i, j, k in product((0, 1), repeat=3)], axis=2)
    up_local = T_world_gripper[:, :3, :3].transpose(0, 2, 1) @ support.normal
    heights = np.einsum("pbci,pi->pbc", corners, up_local).min(axis=(1, 2))
    heights += support.distances(T_world_gripper[:, :3, 3])
    return heights - standoff_m * np.maximum(up_local[:, 2], 0.0)


def _in_gripper_frame(T_world_gripper: np.ndarray, points: np.ndarray):
    """Yield slices of the poses with (poses, n, 3) float32 points in each pose's frame."""
    step = max(1, _CHUNK // max(len(points), 1))
    for begin in range(0, len(T_world_gripper), step):
        some = slice(begin, begin + step)
        R, t = T_world_gripper[some, :3, :3], T_world_gripper[some, :3, 3]
        local = points.astype(np.float32) @ R.astype(np.float32)
        local -= np.einsum("pi,pij->pj", t, R)[:, None].astype(np.float32)
        yield some, local


def _gap(local: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Smallest signed gap (p,) of (p, n, 3) points to (p, 2, 3) boxes."""
    centre, half = (box[:, 0] + box[:, 1]) / 2, (box[:, 1] - box[:, 0]) / 2
    outside = np.abs(local[..., 0] - centre[:, None, 0]) - half[:, None, 0]
    for axis in (1, 2):
        np.maximum(outside, np.abs(local[..., axis] - centre[:, None, axis]) - half[:, None, axis], out=outside)
    return outside.min(axis=1)
