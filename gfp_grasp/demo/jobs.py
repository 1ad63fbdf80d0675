"""Jobs of the demonstration: scenes that it simulates, and recordings of the user's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.camera import SensorModel, apply_sensor, intrinsics, render_depth
from gfp_grasp.captures import Capture, complete_capture
from gfp_grasp.complete import CompleteConfig, complete_scene
from gfp_grasp.completion import Completion, lowest_support
from gfp_grasp.demo.demo_scene import DemoScene, load_asset, write_scene
from gfp_grasp.drawing import Item, filmed_trial, items_of, plan_among
from gfp_grasp.envs import run_trial
from gfp_grasp.metrics import completion_errors
from gfp_grasp.scenes import ObjectSource, SceneObject, World, place_clutter
from gfp_grasp.transforms import apply_T, look_at, make_T, rotation_between
from gfp_grasp.types import ConvexPart, DepthImage, Grasp, Outcome, TrueObject

WIDTH, HEIGHT, FOV_DEG = 640, 480, 40.0
EYES = {"clutter": (0.46, -0.36, 0.56), "single": (0.40, -0.30, 0.32)}  # m
# For objects that nobody has weighed: a plastic wall, half a bottle of water; skin of plastic.
_DENSITY, _FRICTION = 500.0, 0.7
_MASS_KG = (0.03, 0.8)


def simulated_scene(
    title: str,
    text: str,
    sources: Sequence[ObjectSource],
    *,
    eye: Sequence[float],
    folder: Path,
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> DemoScene:
    """See objects on a simulated table once through a noisy camera, complete and grasp them, and write the files."""
    rng = np.random.default_rng(seed)
    stage, truths = set_stage(sources, rng)
    image, geom = take_picture(stage, eye, rng)
    completions = complete_scene(image, config=config, seed=seed)
    items, frames = [], []
    for completion in completions:
        truth = _truth_of(completion, stage, truths, geom)
        item, film = _grasped(completion, completions, truth, stage, rng, seed=seed, film=not frames)
        items.append(_named(item, items))
        frames = frames or film
    return write_scene(title, text, tuple(items), folder, image=image, frames=frames, stages={"true": stage})


def recorded_scene(
    capture: Capture,
    *,
    folder: Path,
    category: str | None = None,
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> DemoScene:
    """Complete a recording, try the best grasp of each object on the completed objects, and write the files."""
    completions = complete_capture(capture, category=category, config=config, seed=seed)
    T = table_frame(completions)
    planned = items_of(completions, capture.truth, seed=seed)
    stage = World([_body(item.name, item.completion, T) for item in planned])
    stage.settle()
    items, frames = [], []
    for item in planned:
        outcome, film = None, []
        if item.grasps:
            best = item.grasps[0]
            outcome, film = _try(
                stage, Grasp(T @ best.T_world_gripper, best.width_m, best.quality), item.name, film=not frames
            )
        frames = frames or film
        items.append(replace(item, outcome=outcome, world="completed parts"))
    up = completions[0].detection.up.round(2) + 0.0  # no minus zero
    text = f"Up was taken as ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}) in the frame of the recording. "
    text += "The truth is unknown to the simulator: grasps were tried on the completed objects themselves."
    return write_scene(
        capture.name, text, tuple(items), folder, image=capture.view, frames=frames, stages={"completed": stage}
    )


def set_stage(sources: Sequence[ObjectSource], rng: np.random.Generator) -> tuple[World, tuple[TrueObject, ...]]:
    """The objects at rest on the table, apart from each other, at random."""
    truths = tuple(load_asset(source) for source in sources)
    poses = place_clutter(truths, rng, radius_m=0.2 if len(truths) > 1 else 0.06, gap_m=0.03)
    stage = World([SceneObject.of(truth, T) for truth, T in zip(truths, poses, strict=True)])
    stage.settle()
    return stage, truths


def take_picture(stage: World, eye: Sequence[float], rng: np.random.Generator) -> tuple[DepthImage, np.ndarray]:
    """The picture of a sensor at the eye (3,) m, and the geom id (h, w) in each pixel."""
    K, T = intrinsics(WIDTH, HEIGHT, FOV_DEG), look_at(eye, (0.0, 0.0, 0.06))
    depth, geom = render_depth(stage.model, stage.data, K=K, width=WIDTH, height=HEIGHT, T_world_camera=T)
    return apply_sensor(DepthImage(depth, K, T), SensorModel.realsense(), rng), geom


def table_frame(completions: Sequence[Completion]) -> np.ndarray:
    """T_table_world (4, 4): up is z, the support is z = 0, and the objects' middle is at x = y = 0."""
    detection = completions[0].detection
    R = rotation_between(detection.up, [0.0, 0.0, 1.0])
    vertices = np.concatenate([completion.mesh.vertices for completion in completions]) @ R.T
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    support = lowest_support(completions)
    height = support.height_m if support else vertices[:, 2].min()
    return make_T(R, [-middle[0], -middle[1], -height])


def _try(stage: World, grasp: Grasp, target: str, *, film: bool) -> tuple[Outcome, list[np.ndarray]]:
    """Try a grasp, world frame, on an object of the stage, which is put back afterwards."""
    frames: list[np.ndarray] = []
    if film:
        outcome, frames = filmed_trial(stage, grasp, target=target, alone=len(stage.names) == 1)
    else:
        outcome = run_trial(stage, grasp, target=target)
    stage.restore()
    return outcome, frames


def _truth_of(
    completion: Completion, stage: World, truths: Sequence[TrueObject], geom: np.ndarray
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
    stage: World,
    rng: np.random.Generator,
    *,
    seed: int,
    film: bool,
) -> tuple[Item, list[np.ndarray]]:
    grasps, grasp_s = plan_among(completion, completions, seed=seed)
    if truth is None:
        return Item(completion.category, completion, grasps, grasp_s=grasp_s), []
    outcome, frames = _try(stage, grasps[0], truth.name, film=film) if grasps else (None, [])
    mesh = trimesh.Trimesh(apply_T(stage.pose(truth.name), truth.mesh.vertices), truth.mesh.faces, process=False)
    errors = completion_errors(completion.mesh, mesh, rng=rng)
    return Item(truth.name, completion, grasps, outcome, "true object", mesh, errors, grasp_s), frames


def _named(item: Item, others: Sequence[Item]) -> Item:
    """The object under a name that none of the others has."""
    taken, name, number = {other.name for other in others}, item.name, 2
    while name in taken:
        name, number = f"{item.name}-{number}", number + 1
    return replace(item, name=name)


def _body(name: str, completion: Completion, T_table_world: np.ndarray) -> SceneObject:
    """The completed object as the simulator takes it, lifted out of the table that it may reach into."""
    low = min(0.0, float(apply_T(T_table_world, completion.mesh.vertices)[:, 2].min()))
    centre = apply_T(T_table_world, completion.mesh.vertices).mean(axis=0)

    def local(points: np.ndarray) -> np.ndarray:
        return apply_T(T_table_world, points) - centre

    parts = tuple(ConvexPart(local(part.vertices), part.faces) for part in completion.parts)
    visual = completion.mesh.copy()
    visual.vertices = local(completion.mesh.vertices)
    mass_kg = float(np.clip(_DENSITY * completion.mesh.volume, *_MASS_KG))
    return SceneObject(name, parts, visual, make_T(t=centre - (0.0, 0.0, low)), mass_kg, _FRICTION)
