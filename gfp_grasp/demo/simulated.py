"""Objects of the held-out split on a simulated table: seen once through a noisy camera, completed, grasped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.camera import SensorModel, apply_sensor, intrinsics, render_depth
from gfp_grasp.complete import Completion, complete_scene
from gfp_grasp.demo.attempt import attempt, plan_among
from gfp_grasp.demo.files import write_files
from gfp_grasp.demo.props import load_prop
from gfp_grasp.demo.story import Item, Story
from gfp_grasp.metrics import completion_errors
from gfp_grasp.scenes import ObjectSource, SceneObject, place_clutter
from gfp_grasp.scenes.stage import Stage
from gfp_grasp.transforms import apply_T, look_at
from gfp_grasp.types import DepthImage, TrueObject

WIDTH, HEIGHT, FOV_DEG = 640, 480, 40.0
EYES = {"clutter": (0.46, -0.36, 0.56), "single": (0.40, -0.30, 0.32)}  # m


def set_stage(sources: Sequence[ObjectSource], rng: np.random.Generator) -> tuple[Stage, tuple[TrueObject, ...]]:
    """The objects at rest on the table, apart from each other, at random."""
    truths = tuple(load_prop(source) for source in sources)
    poses = place_clutter(truths, rng, radius_m=0.2 if len(truths) > 1 else 0.06, gap_m=0.03)
    return Stage([SceneObject.of(truth, T) for truth, T in zip(truths, poses, strict=True)]), truths


def look(stage: Stage, eye: Sequence[float], rng: np.random.Generator) -> tuple[DepthImage, np.ndarray]:
    """What a sensor at the eye (3,) m sees of the stage, and the geom id (h, w) in each pixel."""
    K, T = intrinsics(WIDTH, HEIGHT, FOV_DEG), look_at(eye, (0.0, 0.0, 0.06))
    depth, geom = render_depth(stage.model, stage.data, K=K, width=WIDTH, height=HEIGHT, T_world_camera=T)
    return apply_sensor(DepthImage(depth, K, T), SensorModel.realsense(), rng), geom


def simulated_story(
    title: str, text: str, sources: Sequence[ObjectSource], *, eye: Sequence[float], folder: Path, seed: int
) -> Story:
    """See, complete, grasp, and write the files of one simulated scene."""
    rng = np.random.default_rng(seed)
    stage, truths = set_stage(sources, rng)
    image, geom = look(stage, eye, rng)
    completions = complete_scene(image, seed=seed)
    items, frames = [], []
    for completion in completions:
        truth = _truth_of(completion, stage, truths, geom)
        item, film = _grasped(completion, completions, truth, stage, rng, seed=seed, film=not frames)
        items.append(_named(item, items))
        frames = frames or film
    return write_files(title, text, tuple(items), folder, image=image, frames=frames, stages={"true": stage})


def _truth_of(
    completion: Completion, stage: Stage, truths: Sequence[TrueObject], geom: np.ndarray
) -> TrueObject | None:
    """The object that most of the detection's pixels saw; None where that is the table."""
    seen = geom[completion.detection.mask] if completion.detection.mask is not None else geom[:0, 0]
    seen = seen[seen >= 0]
    votes = [int(stage.geoms(truth.name)[seen].sum()) for truth in truths]
    return truths[int(np.argmax(votes))] if votes and max(votes) > len(seen) / 2 else None


def _grasped(
    completion: Completion,
    completions: Sequence[Completion],
    truth: TrueObject | None,
    stage: Stage,
    rng: np.random.Generator,
    *,
    seed: int,
    film: bool,
) -> tuple[Item, list[np.ndarray]]:
    grasps, grasp_s = plan_among(completion, completions, seed=seed)
    if truth is None:
        return Item(completion.category, completion, grasps, grasp_s=grasp_s), []
    outcome, frames = attempt(stage, grasps[0], truth.name, film=film) if grasps else (None, [])
    mesh = trimesh.Trimesh(apply_T(stage.pose(truth.name), truth.mesh.vertices), truth.mesh.faces, process=False)
    errors = completion_errors(completion.mesh, mesh, rng=rng)
    return Item(truth.name, completion, grasps, outcome, "true object", mesh, errors, grasp_s), frames


def _named(item: Item, others: Sequence[Item]) -> Item:
    """The item under a name that none of the others has."""
    taken, name, number = {other.name for other in others}, item.name, 2
    while name in taken:
        name, number = f"{item.name}-{number}", number + 1
    return replace(item, name=name)
