"""A user's own recording: completed, and grasped in a simulation of what was completed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gfp_grasp.captures import Capture, complete_capture
from gfp_grasp.complete import Completion
from gfp_grasp.demo.attempt import attempt, plan_among
from gfp_grasp.demo.files import write_files
from gfp_grasp.demo.story import Item, Story
from gfp_grasp.metrics import completion_errors
from gfp_grasp.scenes import SceneObject
from gfp_grasp.scenes.stage import Stage
from gfp_grasp.transforms import apply_T, make_T, rotation_between
from gfp_grasp.types import ConvexPart, Grasp

# Of objects that nobody has weighed: a plastic wall, half a bottle of water; skin of plastic.
_DENSITY, _FRICTION = 500.0, 0.7
_MASS_KG = (0.03, 0.8)


def recorded_story(capture: Capture, *, folder: Path, category: str | None = None, seed: int = 0) -> Story:
    """Complete a recording, try the best grasp of each object on the completed objects, and write the files."""
    completions = complete_capture(capture, category=category, seed=seed)
    T = table_frame(completions)
    names = [f"{completion.category}-{i + 1}" for i, completion in enumerate(completions)]
    stage = Stage([_body(name, completion, T) for name, completion in zip(names, completions, strict=True)])
    rng = np.random.default_rng(seed)
    items, frames = [], []
    for name, completion in zip(names, completions, strict=True):
        grasps, grasp_s = plan_among(completion, completions, seed=seed)
        outcome, film = None, []
        if grasps:
            turned = Grasp(T @ grasps[0].T_world_gripper, grasps[0].width_m, grasps[0].quality)
            outcome, film = attempt(stage, turned, name, film=not frames)
        frames = frames or film
        truth = capture.truth if len(completions) == 1 else None
        errors = completion_errors(completion.mesh, truth, rng=rng) if truth is not None else None
        items.append(Item(name, completion, grasps, outcome, "completed parts", truth, errors, grasp_s))
    up = completions[0].detection.up.round(2) + 0.0  # no minus zero
    text = f"Up was taken as ({up[0]:.2f}, {up[1]:.2f}, {up[2]:.2f}) in the frame of the recording. "
    text += "The truth is unknown to the simulator: grasps were tried on the completed objects themselves."
    return write_files(
        capture.name, text, tuple(items), folder, image=capture.view, frames=frames, stages={"completed": stage}
    )


def table_frame(completions: Sequence[Completion]) -> np.ndarray:
    """T_table_world (4, 4): up is z, the support is z = 0, and the objects' middle is at x = y = 0."""
    detection = completions[0].detection
    R = rotation_between(detection.up, [0.0, 0.0, 1.0])
    vertices = np.concatenate([completion.mesh.vertices for completion in completions]) @ R.T
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    height = detection.support.height_m if detection.support else vertices[:, 2].min()
    return make_T(R, [-middle[0], -middle[1], -height])


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
