"""Antipodal grasps on a completed shape."""

from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.grasps.gripper import Gripper
from gfp_grasp.grasps.plan import plan_grasps

__all__ = ["GraspConfig", "Gripper", "plan_grasps"]
