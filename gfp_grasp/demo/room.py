"""A room for the demonstration: a table with things on it, a floor and a second table behind; its scene in MuJoCo."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image

from gfp_grasp.camera import SensorModel
from gfp_grasp.complete import CompleteConfig, complete_scene
from gfp_grasp.completion import CompletedScene
from gfp_grasp.demo.demo_scene import DemoScene, write_scene
from gfp_grasp.drawing import Item, items_of
from gfp_grasp.envs import shade
from gfp_grasp.metrics import completion_errors
from gfp_grasp.scenes import ObjectSource, Room, place_clutter, settle_file, view_room
from gfp_grasp.transforms import look_at

_EYE, _AIM, _FOV_DEG = (0.58, -0.46, 0.62), (-0.02, 0.02, 0.02), 46.0
_COLOURS = ((0.31, 0.49, 0.67), (0.75, 0.34, 0.27), (0.42, 0.56, 0.50), (0.85, 0.64, 0.25), (0.49, 0.36, 0.65))
_SEEN_GROUP = 2  # of the geoms that are seen and do not collide
_PICTURE_PX = (480, 360)
_FILE = "scene_completed.xml"


def room_scene(
    title: str,
    text: str,
    sources: Sequence[ObjectSource],
    *,
    folder: Path,
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> DemoScene:
    """See objects on a table in a room once, complete them, and let their scene stand in MuJoCo for two seconds."""
    rng = np.random.default_rng(seed)
    meshes = [source.load_mesh() for source in sources]
    poses = place_clutter(meshes, rng, radius_m=0.26, gap_m=0.03)
    room = Room(tuple(m.copy().apply_transform(T) for m, T in zip(meshes, poses, strict=True)), _furniture())
    camera = look_at(_EYE, _AIM)
    image, labels = view_room(
        room, camera, rng, sensor=SensorModel.realsense(), fov_y_deg=_FOV_DEG, width=640, height=480
    )
    scene = complete_scene(image, config=config, seed=seed)
    items = tuple(_compared(item, room, labels, rng) for item in items_of(scene, seed=seed))
    made = write_scene(title, text, items, folder, image=image, frames=(), stages={})
    return replace(made, pictures=made.pictures | _standing(scene, folder))


def _furniture() -> tuple[trimesh.Trimesh, ...]:
    """A table whose top is z = 0, the floor, a second and lower table behind, and a wall."""
    places = (
        ((1.0, 0.8, 0.03), (0.0, 0.0, -0.015)),
        ((8.0, 8.0, 0.1), (0.0, 0.0, -0.77)),
        ((0.9, 0.7, 0.03), (-1.2, 0.8, -0.115)),
        ((0.1, 8.0, 3.0), (-2.2, 0.0, 0.78)),
    )
    return tuple(trimesh.creation.box(size).apply_translation(middle) for size, middle in places)


def _compared(item: Item, room: Room, labels: np.ndarray, rng: np.random.Generator) -> Item:
    """An object with the thing that most of its pixels saw; without where that is none."""
    mask = item.completion.detection.mask
    seen = labels[mask] if mask is not None else labels[:0, 0]
    if not len(seen) or (label := int(np.bincount(seen).argmax())) == 0:
        return item
    truth = room.things[label - 1]
    return replace(item, truth=truth, errors=completion_errors(item.completion.mesh, truth, rng=rng))


def _standing(scene: CompletedScene, folder: Path) -> dict[str, str]:
    """Write the completed scene and its picture after two seconds in its own options; file names with captions."""
    settled = settle_file(scene.export(folder / _FILE))
    model, checks = settled.model, settled.checks
    for geom in np.flatnonzero(model.geom_group == _SEEN_GROUP):
        model.geom_rgba[geom, :3] = _COLOURS[model.geom_bodyid[geom] % len(_COLOURS)]
    width, height = _PICTURE_PX
    camera = look_at(_EYE, _AIM)
    picture = shade(model, settled.data, width=width, height=height, T_world_camera=camera, fov_deg=_FOV_DEG)
    Image.fromarray(picture).save(folder / "standing.png", optimize=True)
    standing = sum(check.stands for check in checks)
    travel_mm = 1000 * max(check.travel_m for check in checks)
    caption = (
        f"{_FILE} after two seconds in MuJoCo, with the file's own options: {standing} of {len(checks)} objects "
        f"stand; none travelled farther than {travel_mm:.1f} mm."
    )
    return {"standing.png": caption}
