"""What a completer is, and completions that no primitive was fitted for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from gfp_grasp.completion import Completion
from gfp_grasp.level import mark_observed
from gfp_grasp.types import CollisionMesh, CompletedShape, Detection

Completer = Callable[[Detection], Completion]


@dataclass(frozen=True, eq=False)
class CompletionInParts(Completion):
    """A completion whose convex parts are known from the start; they cost nothing.

    Attributes:
        known_parts: The parts, world frame.
    """

    known_parts: CollisionMesh

    @cached_property
    def collision(self) -> CollisionMesh:
        """The known parts."""
        return self.known_parts


def mark_shape(mesh: trimesh.Trimesh, detection: Detection) -> CompletedShape:
    """A mesh in the world frame as a completed shape: which vertices were observed, and a rough sigma for each."""
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    observed, sigma = mark_observed(
        vertices,
        faces,
        detection.cloud,
        sensor_sigma_m=detection.sensor_sigma_m,
        sigma_m=np.full(len(vertices), np.nan),
    )
    return CompletedShape(mesh, observed, sigma)
