"""Scenes for the simulator: objects from meshes, a table, a gripper. MuJoCo is loaded when a scene is built."""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.scenes.objects import TARGET, SceneObject, mesh_sha256, true_object
from gfp_grasp.scenes.sources import ALL_FAMILIES, ObjectSource, class_and_name, label_of, load_objects
from gfp_grasp.scenes.world import place_clutter

if TYPE_CHECKING:
    from gfp_grasp.scenes.build import add_body, build_scene, compile_scene, save_scene
    from gfp_grasp.scenes.check import BodyCheck, check_file, check_model
    from gfp_grasp.scenes.handles import Handles, gripper_pose, place_gripper
    from gfp_grasp.scenes.world import World

_LATER = {
    "BodyCheck": "check",
    "add_body": "build",
    "check_file": "check",
    "check_model": "check",
    "Handles": "handles",
    "World": "world",
    "build_scene": "build",
    "compile_scene": "build",
    "gripper_pose": "handles",
    "place_gripper": "handles",
    "save_scene": "build",
}

__all__ = [
    "ALL_FAMILIES",
    "TARGET",
    "BodyCheck",
    "Handles",
    "ObjectSource",
    "SceneObject",
    "World",
    "add_body",
    "build_scene",
    "check_file",
    "check_model",
    "class_and_name",
    "compile_scene",
    "gripper_pose",
    "label_of",
    "load_objects",
    "mesh_sha256",
    "place_clutter",
    "place_gripper",
    "save_scene",
    "true_object",
]


def __getattr__(name: str) -> object:
    if name in _LATER:
        return getattr(import_module(f"gfp_grasp.scenes.{_LATER[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
