"""A grasp, the true object that it is tried on, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidView
from gfp_grasp.types.arrays import checked_matrix, freeze
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
        width_m: Opening of the jaws before they close.
        quality: Rank, higher is better.
    """

    T_world_gripper: np.ndarray
    width_m: float
    quality: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, "T_world_gripper", checked_matrix(self.T_world_gripper, (4, 4), "T_world_gripper", InvalidView))


@dataclass(frozen=True, eq=False)
class TrueObject:
    """What the simulator holds. Never reaches a completer or a planner.

    Attributes:
        name: Of the data set and the mesh, never a path.
        category: Class, or "" where it is unknown.
        mesh: Watertight, own frame: z up, base at z = 0.
        collision: Its convex parts.
        mass_kg: Mass.
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
    """What a grasp did.

    Attributes:
        success: Held to the end.
        reason: One of REASONS.
        lift_m: Height gained by the object when the attempt ended.
        slip_m: The most that it moved in the gripper after closing.
        falls_free: Whether it fell when the jaws opened at last; False where it was not held until then.
        settings: What it ran under.
    """

    success: bool
    reason: str
    lift_m: float
    slip_m: float
    falls_free: bool = False
    settings: Mapping[str, float | str] = field(default_factory=dict)
