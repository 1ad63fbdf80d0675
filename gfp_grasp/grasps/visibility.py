"""Which grasps put their jaws where nobody has looked: behind the object may be a handle, in its hollow a floor."""

from itertools import product

import numpy as np
import trimesh

from gfp_grasp.grasps.gripper import Gripper

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
