"""Grasps on a completed shape: antipodal ones, a heuristic beside them, or a planner of one's own."""

from gfp_grasp.grasps.config import GraspConfig
from gfp_grasp.grasps.gripper import Gripper
from gfp_grasp.grasps.plan import plan_grasps
from gfp_grasp.grasps.planners import Planner, planner
from gfp_grasp.grasps.top_down import plan_top_down

__all__ = ["GraspConfig", "Gripper", "Planner", "plan_grasps", "plan_top_down", "planner"]
