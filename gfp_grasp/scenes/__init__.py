"""Scenes for the simulator: objects from meshes, a table, a gripper. MuJoCo is loaded when a scene is built."""

from importlib import import_module
from typing import TYPE_CHECKING

from gfp_grasp.scenes.objects import TARGET, SceneObject, mesh_sha256, true_object
from gfp_grasp.scenes.sources import (
    ALL_FAMILIES,
    ObjectSource,
    class_and_name,
    label_of,
    load_objects,
    shipped_families,
)
from gfp_grasp.scenes.world import place_clutter

if TYPE_CHECKING:
    from gfp_grasp.scenes.build import add_body, build_scene, compile_scene, save_scene
    from gfp_grasp.scenes.check import BodyCheck, SettledScene, check_file, check_model, settle_file
    from gfp_grasp.scenes.handles import Handles, gripper_pose, place_gripper
    from gfp_grasp.scenes.rooms import Room, draw_camera, draw_things, make_room, view_room
    from gfp_grasp.scenes.streets import Street, StreetThing, compile_street, draw_street, scan_street
    from gfp_grasp.scenes.world import World

_LATER = {
    "BodyCheck": "check",
    "add_body": "build",
    "SettledScene": "check",
    "check_file": "check",
    "settle_file": "check",
    "check_model": "check",
    "Handles": "handles",
    "Room": "rooms",
    "Street": "streets",
    "StreetThing": "streets",
    "World": "world",
    "build_scene": "build",
    "draw_camera": "rooms",
    "draw_street": "streets",
    "draw_things": "rooms",
    "compile_scene": "build",
    "compile_street": "streets",
    "gripper_pose": "handles",
    "make_room": "rooms",
    "place_gripper": "handles",
    "save_scene": "build",
    "scan_street": "streets",
    "view_room": "rooms",
}

__all__ = [
    "ALL_FAMILIES",
    "TARGET",
    "BodyCheck",
    "Handles",
    "ObjectSource",
    "Room",
    "SceneObject",
    "SettledScene",
    "Street",
    "StreetThing",
    "World",
    "add_body",
    "build_scene",
    "check_file",
    "check_model",
    "class_and_name",
    "compile_scene",
    "compile_street",
    "draw_camera",
    "draw_street",
    "draw_things",
    "gripper_pose",
    "label_of",
    "load_objects",
    "make_room",
    "mesh_sha256",
    "place_clutter",
    "place_gripper",
    "save_scene",
    "scan_street",
    "settle_file",
    "shipped_families",
    "true_object",
    "view_room",
]


def __getattr__(name: str) -> object:
    if name in _LATER:
        return getattr(import_module(f"gfp_grasp.scenes.{_LATER[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
