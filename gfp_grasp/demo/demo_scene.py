"""One scene of the demonstration: its objects, what became of them, and the files that tell of it.

The objects are shapes of the held-out split whose convex parts ship with the package: making the parts takes seconds
for each object, which a demonstration should not wait for.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.assets import data_dir
from gfp_grasp.collision import parts_from_arrays, parts_to_arrays
from gfp_grasp.drawing import ClassColours, Item, spoken, write_clip, write_depth
from gfp_grasp.scenes import ObjectSource, World, load_objects, mesh_sha256
from gfp_grasp.types import CollisionMesh, DepthImage, TrueObject

FILE = "demo_parts.npz"
# Families and places in their held-out splits: objects unlike each other, each narrow enough somewhere for the gripper.
CLUTTER = (("mug", 7), ("bottle", 8), ("box", 3), ("wine_glass", 6))
SINGLE = (("mug", 4),)
ROOM = (("mug", 4), ("bowl", 6), ("bottle", 8), ("can", 4), ("jar", 5))


def pick_objects(places: Sequence[tuple[str, int]], *, seed: int = 0) -> tuple[ObjectSource, ...]:
    """Objects by family and place in its held-out split; another seed moves all places on."""
    splits = {family: load_objects(family, split="test") for family, _ in places}
    return tuple(splits[family][(place + seed) % len(splits[family])] for family, place in places)


def load_asset(source: ObjectSource) -> TrueObject:
    """The object with the parts that ship for its mesh; where there are none, they are made."""
    shipped = read_parts(data_dir("sim_scenes") / FILE).get(mesh_sha256(source.load_mesh()))
    return source.load(decompose=None if shipped is None else lambda mesh: shipped)


def write_parts(objects: Sequence[TrueObject], path: Path) -> None:
    """Write the convex parts of objects to a file, under the hash of each mesh."""
    arrays: dict[str, np.ndarray] = {}
    for thing in objects:
        key = mesh_sha256(thing.mesh)
        arrays[f"{key}/error_m"] = np.array(thing.collision.error_m)
        arrays |= parts_to_arrays(thing.collision.parts, prefix=f"{key}/", dtype=np.float32)
    np.savez_compressed(path, **arrays)  # pyright: ignore[reportArgumentType]


def read_parts(path: Path) -> dict[str, CollisionMesh]:
    """Convex parts by the hash of their mesh; nothing where the file is not there."""
    if not path.is_file():
        return {}
    with np.load(path, allow_pickle=False) as file:
        arrays = {key: file[key] for key in file.files}
    return {key: _collision(arrays, key) for key in {name.split("/")[0] for name in arrays}}


def _collision(arrays: dict[str, np.ndarray], key: str) -> CollisionMesh:
    mean, high, largest = arrays[f"{key}/error_m"].tolist()
    return CollisionMesh(parts_from_arrays(arrays, prefix=f"{key}/"), (mean, high, largest), "cuts", 0.0)


HEADINGS = ("object", "class", "fit, mm", "CD, mm", "F", "parts", "grasps", "best grasp", "complete, s", "plan, s")
WORD_HEADINGS = ("object", "class", "best grasp")  # columns of words, which start at the left


def figures_row(item: Item) -> tuple[str, ...]:
    """Figures of an object under HEADINGS, as text."""
    score = item.completion.scores.get(item.completion.category)
    return (
        item.name,
        item.completion.category + (f" {score:.2f}" if score is not None else ""),
        f"{1000 * item.residual_m:.1f}" if np.isfinite(item.residual_m) else "",
        f"{1000 * item.errors.cd_m:.1f}" if item.errors else "?",
        f"{item.errors.f_score:.2f}" if item.errors else "?",
        str(len(item.completion.parts)),
        str(len(item.grasps)),
        spoken(item.outcome.reason) if item.outcome else ("not tried" if item.grasps else "none found"),
        f"{item.seconds:.1f}",
        f"{item.grasp_s:.1f}",
    )


@dataclass(frozen=True)
class Columns:
    """What a table says of objects.

    Attributes:
        headings: Names of the columns.
        words: Those of the columns of words, which start at the left.
        row: Figures of an object under the headings, as text.
    """

    headings: tuple[str, ...]
    words: tuple[str, ...]
    row: Callable[[Item], tuple[str, ...]]


OBJECTS = Columns(HEADINGS, WORD_HEADINGS, figures_row)


@dataclass(frozen=True, eq=False)
class StreetLook:
    """How a page shows a LiDAR's scan about the objects that were completed in it.

    Attributes:
        points: (n, 3) m, those of no object, in the scan's frame.
        T_level_world: (4, 4) to a frame with z up, the road at z = 0 and the sensor above the origin, looking along x.
        colours: Colours of the classes.
    """

    points: np.ndarray
    T_level_world: np.ndarray
    colours: ClassColours


@dataclass(frozen=True, eq=False)
class DemoScene:
    """One picture and what came of it.

    Attributes:
        title: Heading.
        text: A sentence or two.
        items: Objects of the picture.
        folder: Folder that holds the scene's files.
        pictures: File names in the folder, each with its caption.
        columns: What its table says.
        street: What the page shows of the scan about the objects; None where they do not come of one.
    """

    title: str
    text: str
    items: tuple[Item, ...]
    folder: Path
    pictures: dict[str, str] = field(default_factory=dict)
    columns: Columns = OBJECTS
    street: StreetLook | None = None


def write_scene(
    title: str,
    text: str,
    items: tuple[Item, ...],
    folder: Path,
    *,
    image: DepthImage | None,
    frames: Sequence[np.ndarray],
    stages: Mapping[str, World],
    columns: Columns = OBJECTS,
) -> DemoScene:
    """Write the folder of a scene: pictures, clip, clouds, meshes, simulator scenes, figures.

    Args:
        title: Heading of the scene.
        text: A sentence or two about it.
        items: Its objects.
        folder: Folder to write; it is made if it is not there.
        image: Depth picture, or None for a bare cloud.
        frames: Frames of the clip, (h, w, 3) uint8; none leaves the clip out.
        stages: Simulator scenes to write, by name.
        columns: Figures of its table and of figures.json.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures: dict[str, str] = {}
    if image is not None:
        write_depth(folder / "depth.png", image.depth_m)
        pictures["depth.png"] = "What the camera saw: light is near, dark is far, grey came back with nothing."
    if frames:
        write_clip(folder / "grasp.gif", frames)
        first = next(item for item in items if item.outcome)
        assert first.outcome is not None
        pictures["grasp.gif"] = (
            f"The best grasp on {first.name}, tried on the {first.world}: {spoken(first.outcome.reason)}."
        )
    for item in items:
        _write_item(item, folder)
    for name, stage in stages.items():
        stage.save(folder / f"scene_{name}.xml")
    figures = [dict(zip(columns.headings, columns.row(item), strict=True)) for item in items]
    (folder / "figures.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return DemoScene(title, text, items, folder, pictures, columns)


def _write_item(item: Item, folder: Path) -> None:
    """Cloud, completed mesh coloured by what was seen of it, and the object alone as MJCF."""
    points = trimesh.PointCloud(np.asarray(item.completion.detection.cloud.points))
    points.export(folder / f"{item.name}_cloud.ply")
    item.completion.export(folder / f"{item.name}_completed.glb")
    item.completion.export(folder / f"{item.name}_completed.xml")
