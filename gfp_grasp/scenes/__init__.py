"""Scenes for the simulator: objects from meshes, a table, a gripper. MuJoCo is loaded when a scene is built."""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.scenes.objects import true_object
from gfp_grasp.scenes.placing import place_clutter
from gfp_grasp.scenes.scene_object import SceneObject
from gfp_grasp.scenes.sources import SUFFIXES, ObjectSource, label_of, load_objects

if TYPE_CHECKING:
    from gfp_grasp.scenes.build import build_scene, compile_scene, save_scene
    from gfp_grasp.scenes.gripper import FINGERS, PADS, PALM, place_gripper

_LATER = {
    "build_scene": "build",
    "compile_scene": "build",
    "save_scene": "build",
    "FINGERS": "gripper",
    "PADS": "gripper",
    "PALM": "gripper",
    "place_gripper": "gripper",
}

__all__ = [
    "FINGERS",
    "PADS",
    "PALM",
    "SUFFIXES",
    "ObjectSource",
    "SceneObject",
    "build_scene",
    "compile_scene",
    "label_of",
    "load_objects",
    "place_clutter",
    "place_gripper",
    "save_scene",
    "true_object",
]


def __getattr__(name: str) -> object:
    if name in _LATER:
        return getattr(import_module(f"gfp_grasp.scenes.{_LATER[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
