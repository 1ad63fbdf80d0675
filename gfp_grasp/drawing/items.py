"""One object of a picture with all that is known of it: the completion, its grasps, the truth where there is one."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.completion import Completion
from gfp_grasp.grasps import Gripper, plan_grasps
from gfp_grasp.metrics import CompletionErrors, completion_errors
from gfp_grasp.transforms import apply_T
from gfp_grasp.types import Detection, Grasp, Outcome

_NUM_GRASPS = 16
# A neighbour whose box comes closer than this to the object's box can be in the gripper's way.
_NEIGHBOUR_M = 0.15


@dataclass(frozen=True, eq=False)
class Item:
    """One object of a picture.

    Attributes:
        name: Short and unlike the names of the other objects in the picture.
        completion: Completion of the object.
        grasps: Grasps planned on the completion, best first.
        outcome: Outcome of the best grasp, or None where it was not tried.
        world: Object that the grasp was tried on: "true object", or "completed parts" where the truth is unknown.
        truth: True mesh in place, or None.
        errors: Distance of the completion from the truth, or None.
        grasp_s: Time that planning took, s.
    """

    name: str
    completion: Completion
    grasps: tuple[Grasp, ...] = ()
    outcome: Outcome | None = None
    world: str = ""
    truth: trimesh.Trimesh | None = None
    errors: CompletionErrors | None = None
    grasp_s: float = 0.0

    @property
    def residual_m(self) -> float:
        """Residual of the fit, m; NaN where no primitive was fitted."""
        return self.completion.fit.residual_m if self.completion.fit else float("nan")

    @property
    def seconds(self) -> float:
        """Time that the completion took, without planning."""
        return float(sum(self.completion.timings_s.values()))


def items_of(completions: Sequence[Completion], truth: trimesh.Trimesh | None = None, *, seed: int) -> tuple[Item, ...]:
    """Objects of a recording, named by class and number, with grasps that stay clear of the other objects.

    Args:
        completions: All objects of the recording.
        truth: True mesh in place, of the only object; it is left out where there are several.
        seed: Seed of planning and of the samples that the errors are measured on.
    """
    truth = truth if len(completions) == 1 else None
    return tuple(
        make_item(f"{completion.category}-{number}", completion, completions, truth, seed=seed)
        for number, completion in enumerate(completions, start=1)
    )


def make_item(
    name: str,
    completion: Completion,
    completions: Sequence[Completion],
    truth: trimesh.Trimesh | None,
    *,
    seed: int,
) -> Item:
    """One object: plan its grasps and compare it with the truth.

    Args:
        name: Name of the object.
        completion: Its completion, one of `completions`.
        completions: All objects of the picture.
        truth: True mesh in place, or None.
        seed: Seed of planning and of the samples that the errors are measured on.
    """
    grasps, grasp_s = plan_among(completion, completions, seed=seed)
    errors = None
    if truth is not None:
        errors = completion_errors(completion.mesh, truth, rng=np.random.default_rng(seed))
    return Item(name, completion, grasps, truth=truth, errors=errors, grasp_s=grasp_s)


@dataclass(frozen=True, eq=False)
class _Among:
    """A completion whose neighbours' parts are in the gripper's way too."""

    mesh: trimesh.Trimesh
    parts: tuple[trimesh.Trimesh, ...]
    observed: np.ndarray
    sigma_m: np.ndarray
    detection: Detection


def plan_among(
    completion: Completion, completions: Sequence[Completion], *, seed: int
) -> tuple[tuple[Grasp, ...], float]:
    """Grasps on one completion that stay clear of the others, best first, and the seconds of planning."""
    low, high = completion.mesh.bounds
    parts = list(completion.parts)
    for other in completions:
        near = (other.mesh.bounds[0] < high + _NEIGHBOUR_M).all() and (other.mesh.bounds[1] > low - _NEIGHBOUR_M).all()
        if other is not completion and near:
            parts += other.parts
    start = time.perf_counter()
    among = _Among(completion.mesh, tuple(parts), completion.observed, completion.sigma_m, completion.detection)
    return plan_grasps(among, _NUM_GRASPS, seed=seed), time.perf_counter() - start


def gripper_mesh(grasp: Grasp) -> trimesh.Trimesh:
    """The open gripper at a grasp as boxes, in the world's frame, to be looked at."""
    boxes = Gripper().solids(np.array([grasp.width_m]))[0]
    mesh = joined_boxes(boxes)
    return trimesh.Trimesh(apply_T(grasp.T_world_gripper, mesh.vertices), mesh.faces, process=False)


def joined_boxes(boxes: np.ndarray) -> trimesh.Trimesh:
    """Boxes (b, 2, 3) m, each its least and its greatest corner, as one mesh with 8 vertices a box."""
    meshes = [trimesh.creation.box(bounds=box) for box in boxes]
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    faces = np.concatenate([mesh.faces + 8 * i for i, mesh in enumerate(meshes)])
    return trimesh.Trimesh(vertices, faces, process=False)
