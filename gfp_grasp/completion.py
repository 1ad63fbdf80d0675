"""What a completion gives back: the shape, what it came from, and its collision parts at first access."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh

from gfp_grasp.collision import CollisionConfig
from gfp_grasp.types import CollisionMesh, CompletedShape, Detection, FittedPrimitive


@dataclass(frozen=True, eq=False)
class Completion:
    """A completed object with what it was completed from.

    Attributes:
        shape: The completed surface, what of it was seen, and how sure the rest is.
        detection: The observation.
        collision_config: Budget of its collision parts.
    """

    shape: CompletedShape
    detection: Detection
    collision_config: CollisionConfig = field(default_factory=CollisionConfig, kw_only=True)

    @property
    def mesh(self) -> trimesh.Trimesh:
        """Watertight mesh, m, in the input's frame."""
        return self.shape.mesh

    @property
    def fit(self) -> FittedPrimitive | None:
        """The registered primitive; None where none was used."""
        return self.shape.fit

    @property
    def category(self) -> str:
        """Class whose primitive was fitted, or the detection's."""
        return self.shape.fit.primitive.category if self.shape.fit else self.detection.category

    @property
    def scores(self) -> Mapping[str, float]:
        """Probability of each known class."""
        return self.detection.scores

    @property
    def T_world_object(self) -> np.ndarray:
        """(4, 4) pose of the primitive, or of the observed box where none was fitted."""
        return self.shape.fit.T_world_object if self.shape.fit else self.detection.box.T_world_box

    @property
    def scale(self) -> np.ndarray:
        """(3,) scale along the primitive's axes; ones where none was fitted."""
        return self.shape.fit.scale if self.shape.fit else np.ones(3)

    @property
    def observed(self) -> np.ndarray:
        """(v,) bool, seen from the viewpoint and within three sensor sigmas of a point."""
        return self.shape.observed

    @property
    def sigma_m(self) -> np.ndarray:
        """(v,) m, standard deviation of the surface's position."""
        return self.shape.sigma_m

    @property
    def timings_s(self) -> Mapping[str, float]:
        """Seconds by stage."""
        return self.shape.timings_s

    @cached_property
    def collision(self) -> CollisionMesh:
        """Convex parts with their figures, made at first access."""
        return self.collide(self.collision_config)

    def collide(self, config: CollisionConfig) -> CollisionMesh:
        """Convex parts within another budget than the completion's own."""
        from gfp_grasp.collision import collision_of

        return collision_of(self.shape, config=config)

    @property
    def parts(self) -> tuple[trimesh.Trimesh, ...]:
        """Convex parts, m, in the input's frame."""
        return self._part_meshes

    @cached_property
    def _part_meshes(self) -> tuple[trimesh.Trimesh, ...]:
        return tuple(part.to_trimesh() for part in self.collision.parts)

    def export(self, path: str | Path, *, assets: Literal["embedded", "files"] = "embedded") -> Path:
        """Write the completion; the suffix chooses: .obj .ply .stl .glb (mesh), .xml (MJCF), .urdf.

        Args:
            path: Where to; folders are made.
            assets: Where .xml has its meshes: in itself, or in files beside it as .urdf always does.

        Returns:
            The path written.

        Raises:
            InvalidOption: Another suffix; the message lists these.
        """
        from gfp_grasp.export import export_completion, legal_name, needs_parts

        parts = self.parts if needs_parts(path) else ()
        name = legal_name(self.category or "object")
        return export_completion(self.mesh, parts, Path(path), name=name, up=self.detection.up, assets=assets)
