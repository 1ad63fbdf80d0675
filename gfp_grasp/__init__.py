"""Completion of shapes seen by one depth camera, for grasping in simulation.

Importing the package loads neither torch, mujoco nor coacd; it registers the gymnasium environment `GfpGrasp-v0`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

import gymnasium

if TYPE_CHECKING:
    from gfp_grasp.collision import decompose
    from gfp_grasp.complete import Completion, complete_scene, complete_to_mesh
    from gfp_grasp.grasps import plan_grasps

__version__ = "0.1.0"
__all__ = ["Completion", "complete_scene", "complete_to_mesh", "decompose", "plan_grasps"]

_HOMES = {
    "Completion": "gfp_grasp.complete",
    "complete_scene": "gfp_grasp.complete",
    "complete_to_mesh": "gfp_grasp.complete",
    "decompose": "gfp_grasp.collision",
    "plan_grasps": "gfp_grasp.grasps",
}

gymnasium.register(id="GfpGrasp-v0", entry_point="gfp_grasp.envs:GfpGraspEnv")


def __getattr__(name: str) -> object:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'gfp_grasp' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
