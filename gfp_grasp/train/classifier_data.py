"""What the classifier learns from: partial views of the three families, and of things that are none of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.camera import SensorModel, apply_sensor, cloud_of, intrinsics, render_mesh_view, sample_viewpoint
from gfp_grasp.parallel import pmap
from gfp_grasp.shapes import FAMILIES, make_shape
from gfp_grasp.train.views import ViewsConfig, cached_views, config_id
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about

VIEWS = ViewsConfig(
    elevation_deg=(5.0, 70.0), distance_m=(0.4, 1.0), fallen_share=0.2, hidden_share=0.25, num_points=1500
)
CACHE = Path("runs/classifier")
_MIN_HANDLE_POINTS = 15
_MIN_PIXELS = 60


@dataclass(frozen=True, eq=False)
class Example:
    """A view with its class.

    Attributes:
        points: (n, 3) m, on the table z = 0.
        category: Its class, "" for a thing of none.
        answers: The classes that it may be taught as: both cup and mug where a mug's handle is not seen.
        resting: "upright", "upside_down" or "lying".
    """

    points: np.ndarray
    category: str
    answers: tuple[str, ...]
    resting: str

    @property
    def accepted(self) -> tuple[str, ...]:
        """The classes that count as right: cup and mug are told apart only where a handle is seen."""
        return ("cup", "mug") if "cup" in self.answers else self.answers


def family_examples(
    split: str, *, num_views: int, workers: int = 1, folder: Path = CACHE, progress=None
) -> list[Example]:
    """Views of every procedural shape of a split, from the cache where they are in it."""
    examples = []
    for family in FAMILIES:
        views = cached_views(
            family, split, num_views=num_views, folder=folder, workers=workers, config=VIEWS, progress=progress
        )
        for view in views:
            answers: tuple[str, ...] = (family,)
            if family == "mug" and not _handle_is_seen(view.points, view.T_world_object, view.seed):
                answers = ("cup", "mug")
            examples.append(Example(view.points, family, answers, view.resting))
    return examples


def foreign_examples(count: int, *, seed: int, workers: int = 1, folder: Path = CACHE) -> list[Example]:
    """Views of boxes, cans, plates, bowls, balls and heaps of them, which the classifier is to be unsure about."""
    path = folder / f"foreign_{seed}_{count}_{config_id(VIEWS)}.npz"
    if not path.is_file():
        clouds = pmap(partial(_foreign_view, seed=seed), range(count), workers=workers)
        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(path, count=[len(c) for c in clouds], points=np.concatenate(clouds).astype(np.float32))
    with np.load(path) as stored:
        clouds = np.split(stored["points"].astype(np.float64), np.cumsum(stored["count"])[:-1])
    return [Example(points, "", (), "upright") for points in clouds if len(points) >= _MIN_PIXELS]


def _handle_is_seen(points: np.ndarray, T_world_object: np.ndarray, seed: int) -> bool:
    """Whether points lie beyond the body's radius towards +x, where a handle is; noise stays within 3 mm."""
    local = apply_T(invert_T(T_world_object), points)
    return int((local[:, 0] > _body_radius_m(seed) + 0.003).sum()) >= _MIN_HANDLE_POINTS


@cache
def _body_radius_m(seed: int) -> float:
    return float(np.abs(make_shape("mug", seed).mesh.vertices[:, 1]).max())


def _foreign_view(number: int, *, seed: int) -> np.ndarray:
    """(n, 3) m; empty where the object is out of sight."""
    rng = np.random.default_rng([seed, number])
    mesh = _foreign_mesh(rng)
    mesh.apply_transform(make_T(rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi))))
    mesh.apply_translation([0, 0, -mesh.bounds[0, 2]])
    target = mesh.bounds.mean(axis=0) + rng.uniform(-0.03, 0.03, 3)
    camera = sample_viewpoint(
        rng, elevation_deg=VIEWS.elevation_deg, distance_m=rng.uniform(*VIEWS.distance_m), target=target
    )
    K = intrinsics(VIEWS.width, VIEWS.height, VIEWS.fov_y_deg)
    image, index = render_mesh_view(
        [mesh], T_world_camera=camera, K=K, width=VIEWS.width, height=VIEWS.height, table_height=0.0
    )
    image = apply_sensor(image, (SensorModel.gaussian(0.001), SensorModel.realsense())[rng.integers(2)], rng)
    mask = (index == 0) & (image.depth_m > 0)
    if not mask.any():
        return np.zeros((0, 3))
    points = cloud_of(image, mask).points
    return points[np.sort(rng.permutation(len(points))[: VIEWS.num_points])]


def _foreign_mesh(rng: np.random.Generator) -> trimesh.Trimesh:
    size = rng.uniform(0.03, 0.2, 3)
    match int(rng.integers(7)):
        case 0:
            return trimesh.creation.box(size)
        case 1:  # a plate or a tray
            return _revolve(rng, radius_m=rng.uniform(0.08, 0.15), height_m=rng.uniform(0.012, 0.03))
        case 2:  # a bowl
            radius_m = rng.uniform(0.06, 0.13)
            return _revolve(rng, radius_m=radius_m, height_m=radius_m * rng.uniform(0.5, 0.9))
        case 3:
            return trimesh.creation.icosphere(subdivisions=3, radius=rng.uniform(0.02, 0.08))
        case 4:  # a can on its side, a pen, a banana's bulk
            mesh = trimesh.creation.capsule(height=rng.uniform(0.05, 0.25), radius=rng.uniform(0.008, 0.04))
            mesh.apply_transform(make_T(rotation_about((0, 1, 0), np.pi / 2)))
            return mesh
        case 5:
            return trimesh.creation.cone(radius=rng.uniform(0.02, 0.08), height=rng.uniform(0.03, 0.2))
        case _:  # two boxes, one against the other
            other = trimesh.creation.box(rng.uniform(0.03, 0.15, 3))
            other.apply_translation(rng.uniform(-0.08, 0.08, 3))
            return trimesh.creation.box(size) + other


def _revolve(rng: np.random.Generator, *, radius_m: float, height_m: float) -> trimesh.Trimesh:
    """An open dish with a flat bottom."""
    s = np.linspace(0, 1, 16)
    bend = rng.uniform(1.3, 3.0)
    base_m, wall_m = radius_m * rng.uniform(0.2, 0.6), rng.uniform(0.002, 0.006)
    r = base_m + (radius_m - base_m) * s
    z = height_m * s**bend
    outside, inside = np.column_stack([r, z]), np.column_stack([r - wall_m, z + wall_m])[::-1]
    return trimesh.creation.revolve(np.vstack([[0, 0], outside, inside, [0, wall_m]]), sections=48)
