"""Whether the gripper has room on its way in, and which grasps put their jaws where nobody has looked."""

from itertools import product

import numpy as np
import trimesh

from gfp_grasp.grasps.config import Gripper
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


# Places in each box, as shares of its half extents.
_PLACES = 0.6 * np.array(list(product((-1.0, 1.0), repeat=3)))


def hidden_share(
    T_world_gripper: np.ndarray, opening_m: np.ndarray, mesh: trimesh.Trimesh, viewpoint: np.ndarray, gripper: Gripper
) -> np.ndarray:
    """Share of the jaws that an object hides from a viewpoint, behind it as well as in its own hollow.

    A hidden place may be free, or it may hold a part of the object that was not completed: a handle, or a floor that is
    higher up.

    Args:
        T_world_gripper: (p, 4, 4) final poses.
        opening_m: (p,) jaw openings.
        mesh: The completed object.
        viewpoint: (3,) m, from where it was seen.
        gripper: The boxes of the gripper.

    Returns:
        (p,) from 0 to 1.
    """
    num_jaws = 2 * len(gripper.jaw)
    boxes = gripper.solids(opening_m)[:, :num_jaws]
    centres, halves = (boxes[:, :, 0] + boxes[:, :, 1]) / 2, (boxes[:, :, 1] - boxes[:, :, 0]) / 2
    local = (centres[:, :, None] + _PLACES * halves[:, :, None]).reshape(len(boxes), num_jaws * len(_PLACES), 3)
    places = np.einsum("pij,pnj->pni", T_world_gripper[:, :3, :3], local) + T_world_gripper[:, None, :3, 3]
    hidden = _is_blocked(mesh, viewpoint, places.reshape(-1, 3) - viewpoint)
    return hidden.reshape(len(boxes), num_jaws * len(_PLACES)).mean(axis=1)


def _is_blocked(mesh: trimesh.Trimesh, viewpoint: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """Whether the mesh is between a viewpoint and places (n, 3) m from it."""
    if not len(towards):
        return np.zeros(0, dtype=bool)
    distance = np.linalg.norm(towards, axis=1)
    directions = towards / distance[:, None]
    starts = np.broadcast_to(viewpoint, towards.shape)
    hits, ray, _ = mesh.ray.intersects_location(starts, directions, multiple_hits=False)
    nearest = np.full(len(towards), np.inf)
    np.minimum.at(nearest, ray, np.linalg.norm(hits - viewpoint, axis=1))
    return nearest < distance
