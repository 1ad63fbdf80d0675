"""The files of one story: picture, clip, clouds, meshes, scenes, figures."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.demo.pictures import write_clip, write_depth
from gfp_grasp.demo.story import HEADINGS, Item, Story, row
from gfp_grasp.scenes.stage import Stage
from gfp_grasp.types import DepthImage


def write_files(
    title: str,
    text: str,
    items: tuple[Item, ...],
    folder: Path,
    *,
    image: DepthImage | None,
    frames: Sequence[np.ndarray],
    stages: Mapping[str, Stage],
) -> Story:
    """Write a story's folder.

    Args:
        title: Of the story.
        text: Of the story.
        items: Its objects.
        folder: Made if it is not there.
        image: Depth picture, or None for a bare cloud.
        frames: Of the clip, (h, w, 3) uint8; none leaves the clip out.
        stages: Scenes to write, by name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    pictures: dict[str, str] = {}
    if image is not None:
        write_depth(folder / "depth.png", image.depth_m)
        pictures["depth.png"] = "What the camera saw: light is near, dark is far, grey came back with nothing."
    if frames:
        write_clip(folder / "grasp.gif", frames)
        first = next(item for item in items if item.outcome)
        pictures["grasp.gif"] = (
            f"The best grasp on {first.name}, tried on the {first.world}: {row(first)[7].split(',')[0]}."
        )
    for item in items:
        _write_item(item, folder)
    for name, stage in stages.items():
        stage.save(folder / f"scene_{name}.xml")
    figures = [dict(zip(HEADINGS, row(item), strict=True)) for item in items]
    (folder / "figures.json").write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")
    return Story(title, text, items, folder, pictures)


def _write_item(item: Item, folder: Path) -> None:
    """Cloud, completed mesh coloured by what was seen of it, and the object alone as MJCF."""
    points = trimesh.PointCloud(np.asarray(item.completion.detection.cloud.points))
    points.export(folder / f"{item.name}_cloud.ply")
    item.completion.export(folder / f"{item.name}_completed.glb")
    item.completion.export(folder / f"{item.name}_completed.xml")
