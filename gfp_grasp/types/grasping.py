"""A grasp, the true object that it is tried on, and the outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidGrasp
from gfp_grasp.types.arrays import checked_matrix, checked_numbers, freeze
from gfp_grasp.types.result import CollisionMesh

REASONS = (
    "held",
    "collided_on_approach",
    "no_contact",
    "slipped_on_lift",
    "slipped_on_shake",
    "unstable",
    "unreachable_width",
    "no_grasp_found",
)


@dataclass(frozen=True, eq=False)
class Grasp:
    """A parallel-jaw grasp.

    Attributes:
        T_world_gripper: (4, 4): origin midway between the finger pads' centres, z the approach direction (into the
            object), y the closing axis.
        width_m: Opening of the jaws before they close, m; zero or more.
        quality: Rank, higher is better.

    Raises:
        InvalidGrasp: The pose is no finite (4, 4) matrix, or the width no finite number from 0 on.
    """

    T_world_gripper: np.ndarray
    width_m: float
    quality: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, "T_world_gripper", checked_matrix(self.T_world_gripper, (4, 4), "T_world_gripper", InvalidGrasp))
        width = checked_numbers(self.width_m, "width_m", InvalidGrasp)
        if width.shape != () or not 0 <= width < np.inf:
            raise InvalidGrasp(f"width_m of a grasp is {self.width_m!r}; an opening from 0 on, in metres, is expected")
        object.__setattr__(self, "width_m", float(width))


@dataclass(frozen=True, eq=False)
class TrueObject:
    """What the simulator holds. Never reaches a completer or a planner.

    Attributes:
        name: Name of the mesh in its data set, never a path.
        category: Class, or "" where it is unknown.
        mesh: Watertight, own frame: z up, base at z = 0.
        collision: Convex parts of the mesh.
        mass_kg: Mass of the object.
        friction: Sliding friction coefficient.
    """

    name: str
    category: str
    mesh: trimesh.Trimesh
    collision: CollisionMesh
    mass_kg: float
    friction: float


@dataclass(frozen=True)
class Outcome:
    """What came of a trial.

    Attributes:
        success: Whether the object was held to the end.
        reason: One of REASONS.
        lift_m: Height that the object had gained when the trial ended.
        slip_m: The most that the object moved in the gripper after closing.
        falls_free: Whether the object fell when the jaws opened at last; False where it was not held until then.
        settings: Numbers of the trial.
    """

    success: bool
    reason: str
    lift_m: float
    slip_m: float
    falls_free: bool = False
    settings: Mapping[str, float | str] = field(default_factory=dict)
