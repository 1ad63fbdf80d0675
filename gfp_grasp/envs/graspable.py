"""Whether the gripper can take hold of an object at all."""

import numpy as np

from gfp_grasp.completers import Oracle
from gfp_grasp.detect.box import upright_box
from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.grasps.plan import plan_grasps
from gfp_grasp.types import Detection, PointCloud, SupportPlane, TrueObject

_UP = np.array([0.0, 0.0, 1.0])
# Many more tries than for a ranking: nothing found is to mean that there is nothing.
_THOROUGH = GraspConfig(num_rays=20_000, num_lines=2000, num_looks=16_000, num_poses=2400)


def is_graspable(truth: TrueObject) -> bool:
    """Whether the planner finds a grasp on an object as it stands, of all of which it knows.

    A jug that is wider everywhere than the jaws open tells nothing about a completion.
    """
    points = np.asarray(truth.mesh.vertices)
    detection = Detection(PointCloud(points), _UP, SupportPlane(_UP, 0.0), "", {}, upright_box(points, _UP))
    known = Oracle()(detection, truth.mesh, truth.collision)
    return any(plan_grasps(known, 1, config=config) for config in (GraspConfig(), _THOROUGH))
