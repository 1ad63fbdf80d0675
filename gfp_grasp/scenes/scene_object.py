"""An object as a scene takes it: convex parts that collide, a mesh that is seen, a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidScene
from gfp_grasp.transforms import make_T
from gfp_grasp.types import ConvexPart, TrueObject

TARGET = "object"  # the name of the object that a trial grasps, unless it is told another


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object of a scene.

    Attributes:
        name: Name of its body in the simulator; unique in the scene.
        parts: Convex parts that collide, in the object's frame, m.
        visual: What cameras see and what gives the inertia, watertight, in the object's frame; None shows the parts.
        T_world_object: (4, 4) pose at the start.
        mass_kg: Mass.
        friction: Sliding friction coefficient of its contacts, whatever touches it.
        fixed: Stuck to the world.
    """

    name: str
    parts: tuple[ConvexPart, ...]
    visual: trimesh.Trimesh | None
    T_world_object: np.ndarray
    mass_kg: float
    friction: float
    fixed: bool = False

    def __post_init__(self) -> None:
        T = np.array(self.T_world_object, dtype=np.float64)
        if (
            T.shape != (4, 4)
            or not np.isfinite(T).all()
            or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6)
        ):
            raise InvalidScene(f"{self.name}: T_world_object must be a finite rigid (4, 4) transform, got\n{T}")
        if not self.parts:
            raise InvalidScene(f"{self.name} has no convex parts: it would fall through the table")
        if not (0 < self.mass_kg < np.inf and 0 <= self.friction < np.inf):
            raise InvalidScene(
                f"{self.name}: mass {self.mass_kg} kg must be positive, friction {self.friction} not negative"
            )
        T.setflags(write=False)
        object.__setattr__(self, "T_world_object", T)

    @classmethod
    def of(cls, truth: TrueObject, T_world_object: np.ndarray, *, name: str | None = None) -> SceneObject:
        """A true object at a pose, under its own name or another."""
        return cls(name or truth.name, truth.collision.parts, truth.mesh, T_world_object, truth.mass_kg, truth.friction)

    @classmethod
    def of_parts(
        cls, parts: tuple[ConvexPart, ...], mass_kg: float, friction: float, *, name: str = TARGET
    ) -> SceneObject:
        """Convex parts in the world frame, lifted out of the table where they reach below z = 0.

        Raises:
            InvalidScene: There are no parts.
        """
        if not parts:
            raise InvalidScene(f"{name} has no convex parts: it would fall through the table")
        points = np.concatenate([part.vertices for part in parts])
        centre = points.mean(axis=0)
        local = tuple(ConvexPart(part.vertices - centre, part.faces) for part in parts)
        sunk = min(0.0, float(points[:, 2].min()))
        return cls(name, local, None, make_T(t=centre - (0.0, 0.0, sunk)), mass_kg, friction)
