"""Planning a grasp among other objects, trying it in the simulator, and filming that."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.complete import Completion
from gfp_grasp.envs import run_trial
from gfp_grasp.envs.picture import shade
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.scenes.stage import Stage
from gfp_grasp.transforms import look_at
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
    commands = 0
    width, height = _FRAME_PX
    T_world_camera = _camera(grasp, alone=len(stage.names) == 1)

    def watch(data: object) -> None:
        nonlocal commands
        if commands % _COMMANDS_A_FRAME == 0:
            frames.append(shade(stage.model, data, width=width, height=height, T_world_camera=T_world_camera))
        commands += 1

    outcome = run_trial(stage.model, stage.data, grasp, target=target, on_step=watch if film else None)
    stage.restore()
    return outcome, frames


def _camera(grasp: Grasp, *, alone: bool) -> np.ndarray:
    """T_world_camera (4, 4) that looks across the closing axis, so that both jaws show."""
    closing = grasp.T_world_gripper[:3, 1] * (1.0, 1.0, 0.0)
    towards = _FRONT
    if np.linalg.norm(closing) > _UPRIGHT_JAWS:
        across = np.cross((0.0, 0.0, 1.0), closing / np.linalg.norm(closing))
        towards = across if across @ _FRONT > 0 else -across
    level, height = np.cos(_ELEVATION_RAD) * towards, np.array([0.0, 0.0, np.sin(_ELEVATION_RAD)])
    target = np.array([0.0, 0.0, _LOOK_AT_M])
    return look_at(target + (_ALONE_M if alone else _CLUTTER_M) * (level + height), target)
