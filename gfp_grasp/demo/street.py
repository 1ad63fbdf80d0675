"""A whole LiDAR scan for the demonstration: its completed objects, seen obliquely from above, and as one scene."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from gfp_grasp.captures import Capture, complete_capture
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.completion import CompletedScene
from gfp_grasp.demo.demo_scene import Columns, DemoScene, StreetLook, write_scene
from gfp_grasp.detect import Detector
from gfp_grasp.drawing import ClassColours, Item, draw_scan, level_frame_of, scan_points
from gfp_grasp.errors import InvalidOption
from gfp_grasp.scenes import settle_file
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import RangeImage

HEADINGS = ("object", "class", "distance, m", "size, m", "points", "guessed", "complete, s")
_PICTURE, _SCENE = "street.jpg", "street.xml"
_PICTURE_PX, _QUALITY = (1600, 860), 86


def street_scene(
    capture: Capture,
    *,
    folder: Path,
    detector: str | Detector | None = None,
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> DemoScene:
    """Complete the vehicles and people of a whole scan, draw it, and let their scene stand in MuJoCo for two seconds.

    Args:
        capture: The scan.
        folder: Folder to write; it is made if it is not there.
        detector: What finds them; None takes the default for scans.
        config: Switches of the completion.
        seed: Seed of every random choice.

    Raises:
        InvalidOption: The recording is no whole scan.
        GfpGraspError: Nothing in it can be completed.
    """
    scene = complete_capture(capture, detector=detector, sensor="lidar", config=config, seed=seed)
    if not isinstance(scene, CompletedScene) or not isinstance(scene.view, RangeImage):
        raise InvalidOption(f"{capture.name} is no whole LiDAR scan: leave out --street to complete one object")
    items = tuple(Item(name, completion) for name, completion in zip(scene.names, scene, strict=True))
    text = f"One turn of a LiDAR, {int((scene.view.range_m > 0).sum()):,} points, and all that was found on its road."
    made = write_scene(capture.name, text, items, folder, image=None, frames=(), stages={}, columns=TRAFFIC)
    write_street(scene, folder / _PICTURE)
    checks = settle_file(scene.export(folder / _SCENE)).checks
    caption = (
        "The scan with the completed objects in it, each in the colour of its class, paler where nobody saw it. "
        f"{_SCENE} after two seconds in MuJoCo: {sum(check.stands for check in checks)} of {len(checks)} objects stand."
    )
    colours = ClassColours.of([completion.category for completion in scene])
    look = StreetLook(scan_points(scene), level_frame_of(scene), colours)
    return replace(made, pictures={_PICTURE: caption}, street=look)


def write_street(scene: CompletedScene, path: Path) -> None:
    """Write the picture of a scan with its completed objects, .jpg or .png."""
    width, height = _PICTURE_PX
    picture = Image.fromarray(draw_scan(scene, width=width, height=height))
    picture.save(path, quality=_QUALITY, optimize=True)


def street_row(item: Item) -> tuple[str, ...]:
    """Figures of a thing in a street under HEADINGS, as text."""
    completion = item.completion
    score = completion.scores.get(completion.category)
    local = apply_T(invert_T(completion.T_world_object), completion.mesh.vertices)
    away = completion.mesh.bounds.mean(axis=0)
    away_m = float("nan") if (eye := completion.detection.cloud.viewpoint) is None else np.linalg.norm(away - eye)
    return (
        item.name,
        completion.category + (f" {score:.2f}" if score is not None else ""),
        f"{away_m:.1f}",
        " x ".join(f"{extent:.1f}" for extent in np.ptp(local, axis=0)),
        str(len(completion.detection.cloud.points)),
        f"{1 - completion.observed.mean():.0%}",
        f"{item.seconds:.1f}",
    )


TRAFFIC = Columns(HEADINGS, ("object", "class"), street_row)
