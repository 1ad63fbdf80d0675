"""Planning a grasp among other objects, trying it in the simulator, and filming that."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from gfp_grasp.complete import Completion
from gfp_grasp.envs import run_trial
from gfp_grasp.envs.picture import shade
from gfp_grasp.envs.settings import TrialSettings
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.scenes.stage import Stage
from gfp_grasp.transforms import look_at, rotation_about
from gfp_grasp.types import Detection, Grasp, Outcome

_NUM_GRASPS = 16
# A neighbour whose box comes closer than this to the object's can be in the gripper's way.
_NEIGHBOUR_M = 0.15
# 160 ms of simulation between two frames, which are shown for 80 ms each.
_COMMANDS_A_FRAME = 16
_FRAME_PX = (400, 300)
# The camera looks down by this much, from the front right unless the jaws close along its sight, and has the object in
# view where it stands and the whole gripper at the top of the lift.
_FRONT, _ELEVATION_RAD, _LOOK_AT_M = np.array([0.76, -0.65, 0.0]), np.deg2rad(20.0), 0.24
_ALONE_M, _CLUTTER_M = 0.92, 1.0
_UPRIGHT_JAWS = 0.3  # jaws that close with less than this along the level look the same from every side
_FROM_THE_SIDE, _OBLIQUE_RAD, _UP = 0.5, np.deg2rad(55.0), np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class _Among:
    """A completion whose neighbours' parts are in the gripper's way too."""

    mesh: trimesh.Trimesh
    parts: tuple[trimesh.Trimesh, ...]
    observed: np.ndarray
    sigma_m: np.ndarray
    detection: Detection


def plan_among(
    completion: Completion, all_of_them: Sequence[Completion], *, seed: int
) -> tuple[tuple[Grasp, ...], float]:
    """Grasps on one completion that stay clear of the others, best first, and the seconds of planning."""
    low, high = completion.mesh.bounds
    parts = list(completion.parts)
    for other in all_of_them:
        near = (other.mesh.bounds[0] < high + _NEIGHBOUR_M).all() and (other.mesh.bounds[1] > low - _NEIGHBOUR_M).all()
        if other is not completion and near:
            parts += other.parts
    start = time.perf_counter()
    scene = _Among(completion.mesh, tuple(parts), completion.observed, completion.sigma_m, completion.detection)
    return plan_grasps(scene, _NUM_GRASPS, seed=seed), time.perf_counter() - start


def attempt(stage: Stage, grasp: Grasp, target: str, *, film: bool = False) -> tuple[Outcome, list[np.ndarray]]:
    """Try a grasp on the stage, which is restored first.

    Args:
        stage: Objects at rest.
        grasp: World frame.
        target: Name of the object.
        film: Whether to take pictures.

    Returns:
        What happened, and frames (h, w, 3) uint8.
    """
    stage.restore()
    frames: list[np.ndarray] = []
    if film:
        outcome, frames = filmed_trial(stage.model, stage.data, grasp, target=target, alone=len(stage.names) == 1)
    else:
        outcome = run_trial(stage.model, stage.data, grasp, target=target)
    stage.restore()
    return outcome, frames


def filmed_trial(
    model: Any,
    data: Any,
    grasp: Grasp,
    settings: TrialSettings | None = None,
    *,
    target: str,
    alone: bool,
    commands_a_frame: int = _COMMANDS_A_FRAME,
) -> tuple[Outcome, list[np.ndarray]]:
    """Run a trial as `gfp_grasp.envs.run_trial` does, and take pictures of it.

    Args:
        model: Scene with the gripper.
        data: Its state, which is moved on.
        grasp: World frame.
        settings: Numbers of the attempt.
        target: Name of the object.
        alone: Whether nothing else stands on the table: the camera is nearer then.
        commands_a_frame: Between two pictures.

    Returns:
        What happened, and frames (h, w, 3) uint8; the last one shows how it ended.
    """
    width, height = _FRAME_PX
    T_world_camera = _camera(grasp, alone=alone)
    frames: list[np.ndarray] = []
    commands = 0

    def shoot() -> None:
        frames.append(shade(model, data, width=width, height=height, T_world_camera=T_world_camera))

    def watch(_: object) -> None:
        nonlocal commands
        if commands % commands_a_frame == 0:
            shoot()
        commands += 1

    outcome = run_trial(model, data, grasp, settings, target=target, on_step=watch)
    shoot()
    return outcome, frames


def _camera(grasp: Grasp, *, alone: bool) -> np.ndarray:
    """T_world_camera (4, 4) that looks across the closing axis, so that both jaws show.

    A gripper that comes from the side is looked at obliquely from behind, so that neither it nor the object is hidden.
    """
    closing = grasp.T_world_gripper[:3, 1] * (1.0, 1.0, 0.0)
    behind = -grasp.T_world_gripper[:3, 2] * (1.0, 1.0, 0.0)
    towards = _FRONT
    if np.linalg.norm(behind) > _FROM_THE_SIDE:
        sides = [rotation_about(_UP, sign * _OBLIQUE_RAD) @ behind / np.linalg.norm(behind) for sign in (-1.0, 1.0)]
        towards = max(sides, key=lambda side: float(side @ _FRONT))
    elif np.linalg.norm(closing) > _UPRIGHT_JAWS:
        across = np.cross((0.0, 0.0, 1.0), closing / np.linalg.norm(closing))
        towards = across if across @ _FRONT > 0 else -across
    level, height = np.cos(_ELEVATION_RAD) * towards, np.array([0.0, 0.0, np.sin(_ELEVATION_RAD)])
    target = np.array([0.0, 0.0, _LOOK_AT_M])
    return look_at(target + (_ALONE_M if alone else _CLUTTER_M) * (level + height), target)
