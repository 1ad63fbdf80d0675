"""What comes out: the completed shape and its convex parts; a grasp, the true object it is tried on, the outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidGrasp, InvalidMesh
from gfp_grasp.transforms import apply_T
from gfp_grasp.types.arrays import checked_matrix, checked_numbers, freeze
from gfp_grasp.types.primitive import ConvexPart, FittedPrimitive


@dataclass(frozen=True, eq=False)
class CompletedShape:
    """A completed object in the frame of its input.

    Attributes:
        mesh: Watertight, outward; treat as read-only.
        observed: (v,) bool, seen from the viewpoint and within three sensor sigmas of a point.
        sigma_m: (v,) standard deviation of the surface's position, m.
        fit: The fit that it came from; None where no primitive was used.
        timings_s: Seconds by stage.
        made_by: "primitive", "classfree" (the network that knows no class), "peer" (another network), "hull" (of what
            was seen), or "other".
        note: Why it is not what the likeliest class's primitive would have been; "" where it is.
    """

    mesh: trimesh.Trimesh
    observed: np.ndarray
    sigma_m: np.ndarray
    fit: FittedPrimitive | None = None
    timings_s: Mapping[str, float] = field(default_factory=dict)
    made_by: Literal["primitive", "classfree", "peer", "hull", "other"] = "other"
    note: str = ""

    def __post_init__(self) -> None:
        num_vertices = len(self.mesh.vertices)
        observed, sigma = np.asarray(self.observed, dtype=bool), np.asarray(self.sigma_m, dtype=np.float64)
        if observed.shape != (num_vertices,) or sigma.shape != (num_vertices,):
            raise InvalidMesh(f"observed {observed.shape} and sigma_m {sigma.shape} must be ({num_vertices},)")
        freeze(self, "observed", observed)
        freeze(self, "sigma_m", sigma)

    def moved(self, T: np.ndarray) -> CompletedShape:
        """The same in another frame, T_new_old (4, 4)."""
        vertices = apply_T(T, np.asarray(self.mesh.vertices))
        fit = None if self.fit is None else replace(self.fit, T_world_object=T @ self.fit.T_world_object)
        return replace(self, mesh=trimesh.Trimesh(vertices, self.mesh.faces.copy(), process=False), fit=fit)


@dataclass(frozen=True, eq=False)
class CollisionMesh:
    """Convex parts that stand for a mesh.

    Attributes:
        parts: Convex, world frame of the mesh.
        error_m: Mean, 95 % and largest two-sided distance between the surface of the union and the mesh; NaN where
            it was not measured.
        made_by: "carried", "coacd", "cuts", "hull" or "vhacd".
        seconds: Time it took.
        notes: Figures and warnings: attempts, dropped slivers, volume ratio.
    """

    parts: tuple[ConvexPart, ...]
    error_m: tuple[float, float, float]
    made_by: Literal["carried", "coacd", "cuts", "hull", "vhacd"]
    seconds: float
    notes: Mapping[str, object] = field(default_factory=dict)


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
        least_friction: Least coefficient of the object's friction at which the same grasp holds, within the width that
            `envs.least_friction` states; inf where it holds at none, None where nobody asked.
    """

    success: bool
    reason: str
    lift_m: float
    slip_m: float
    falls_free: bool = False
    settings: Mapping[str, float | str] = field(default_factory=dict)
    least_friction: float | None = None
