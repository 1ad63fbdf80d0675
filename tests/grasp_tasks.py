"""Tasks of small pictures with two bottles and a crooked box, and a level grasp for them."""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.envs import EnvConfig, GraspTask
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Grasp

SMALL: dict[str, Any] = {"completer": "mirror", "num_points": 64, "image_width": 120, "image_height": 90}
TINY: dict[str, Any] = {"image_width": 8, "image_height": 6}  # nothing is detected, but all else is drawn
# Level, at mid-height, at the middle of the table.
LEVEL = Grasp(make_T(np.column_stack([(0, 0, -1.0), (0, 1.0, 0), (1.0, 0, 0)]), (0, 0, 0.07)), 0.078)


def leaning_box():
    """A box that is not about its own axis, so that yaw and place show."""
    mesh = trimesh.creation.box((0.05, 0.03, 0.14))
    mesh.apply_translation((0.012, 0.004, 0.07))
    return mesh


def written_objects(path: Path) -> str:
    """The folder, with the bottles and the box written into it."""
    for name, radius_m in (("slim", 0.025), ("wide", 0.034)):
        mesh = trimesh.creation.cylinder(radius_m, 0.14, sections=32)
        mesh.apply_translation((0, 0, 0.07))
        mesh.export(path / f"bottle__{name}.ply")
    leaning_box().export(path / "box__crooked.ply")
    return str(path)


def task_of(folder, **options):
    """A task of the objects of a folder, with small pictures where no others are asked for."""
    return GraspTask(EnvConfig(objects=folder, **{**SMALL, **options}))
