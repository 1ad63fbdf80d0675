"""Bodies with what is known of their surface, as the planner of grasps takes them, and the load that a grasp bears."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.grasps import Gripper
from gfp_grasp.grasps.contact import load_ratio
from gfp_grasp.types import Detection, OrientedBox, PointCloud

UP = np.array([0.0, 0.0, 1.0])
GRIPPER = Gripper()


@dataclass(frozen=True)
class Completed:
    """A mesh, its convex parts, and what the planner asks of each vertex: whether it was seen, and how sure it is."""

    mesh: trimesh.Trimesh
    parts: tuple[trimesh.Trimesh, ...]
    observed: np.ndarray
    sigma_m: np.ndarray
    detection: Detection


def completion_of(
    mesh, *, observed: Any = True, sigma_m: Any = 0.0, support=None, view=None, mask=None, viewpoint=None, parts=()
):
    """A mesh as if completed from a detection that has all of its vertices; seen and certain where nothing is said."""
    points = np.asarray(mesh.vertices)
    box = OrientedBox(np.eye(4), np.ptp(points, axis=0))
    cloud = PointCloud(points, viewpoint)
    detection = Detection(cloud, UP, support, "", {}, box, view=view, mask=mask)
    seen = np.broadcast_to(observed, (len(points),))
    return Completed(mesh, tuple(parts), seen, np.broadcast_to(sigma_m, (len(points),)), detection)


def load_of(T, levers, *, friction=0.5, sway=0.0, up=UP, centre=(0, 0, 0)):
    """Load ratio of one pose whose levers are those of its own axes (3,) m, or a matrix (3, 3) m."""
    levers = np.diag(levers) if np.ndim(levers) == 1 else levers
    return float(load_ratio(T[None], levers[None], np.asarray(centre), up, friction=friction, sway=sway)[0])
