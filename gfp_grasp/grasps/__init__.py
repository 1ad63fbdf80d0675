"""Grasps on a completed shape: antipodal ones, a heuristic beside them, or a planner of the user's own."""

from gfp_grasp.grasps.config import Box, GraspConfig, Gripper
from gfp_grasp.grasps.contact import Graspable
from gfp_grasp.grasps.plan import bearable_weight, plan_grasps
from gfp_grasp.grasps.planners import PLANNERS, Planner, get_planner, plan_top_down

__all__ = [
    "PLANNERS",
    "Box",
    "GraspConfig",
    "Graspable",
    "Gripper",
    "Planner",
    "bearable_weight",
    "get_planner",
    "plan_grasps",
    "plan_top_down",
]
