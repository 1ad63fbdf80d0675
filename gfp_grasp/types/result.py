"""What a completion gives back: the shape, and the convex parts that stand for it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidMesh
from gfp_grasp.types.arrays import freeze
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
    """

    mesh: trimesh.Trimesh
    observed: np.ndarray
    sigma_m: np.ndarray
    fit: FittedPrimitive | None = None
    timings_s: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        num_vertices = len(self.mesh.vertices)
        observed, sigma = np.asarray(self.observed, dtype=bool), np.asarray(self.sigma_m, dtype=np.float64)
        if observed.shape != (num_vertices,) or sigma.shape != (num_vertices,):
            raise InvalidMesh(f"observed {observed.shape} and sigma_m {sigma.shape} must be ({num_vertices},)")
        freeze(self, "observed", observed)
        freeze(self, "sigma_m", sigma)


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
