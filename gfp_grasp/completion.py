"""What a completion gives back: the shape, what it came from, and its collision parts at first access; and scenes."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, overload

import numpy as np
import trimesh

from gfp_grasp.collision import CollisionConfig
from gfp_grasp.errors import InvalidOption
from gfp_grasp.overlap import GaveWay, make_way
from gfp_grasp.types import (
    CollisionMesh,
    CompletedShape,
    DepthImage,
    Detection,
    FittedPrimitive,
    RangeImage,
    SupportPlane,
    default_density,
)

if TYPE_CHECKING:
    from gfp_grasp.export import Body


@dataclass(frozen=True, eq=False)
class Completion:
    """A completed object with what it was completed from.

    Attributes:
        shape: The completed surface, what of it was seen, and how sure the rest is.
        detection: The observation.
        collision_config: Budget of its collision parts.
        bounds: (k, 4) half-spaces that its parts keep to, unit normal and offset: normal @ x <= offset, m.
    """

    shape: CompletedShape
    detection: Detection
    collision_config: CollisionConfig = field(default_factory=CollisionConfig, kw_only=True)
    bounds: np.ndarray = field(default_factory=lambda: np.empty((0, 4)), kw_only=True)

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
        """Class whose primitive was fitted, or the detection's; `gfp_grasp.types.UNKNOWN` for a thing of no class."""
        return self.shape.fit.primitive.category if self.shape.fit else self.detection.category

    @property
    def made_by(self) -> str:
        """ "primitive", "classfree", "hull" or "other", see `CompletedShape`."""
        return self.shape.made_by

    @property
    def note(self) -> str:
        """Why it is not what the likeliest class's primitive would have been; "" where it is."""
        return self.shape.note

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
        from gfp_grasp.collision import collision_of, within_bounds

        return within_bounds(collision_of(self.shape, config=config), self.bounds)

    @property
    def parts(self) -> tuple[trimesh.Trimesh, ...]:
        """Convex parts, m, in the input's frame."""
        return self._part_meshes

    @cached_property
    def _part_meshes(self) -> tuple[trimesh.Trimesh, ...]:
        return tuple(part.to_trimesh() for part in self.collision.parts)

    def export(
        self,
        path: str | Path,
        *,
        name: str | None = None,
        assets: Literal["embedded", "files"] = "embedded",
        contact: bool = True,
    ) -> Path:
        """Write the completion; the suffix chooses: .obj .ply .stl .glb (mesh), .xml (MJCF), .urdf.

        Its mass is that of the class's mean density: over the walls of an open vessel, over the whole of what is solid.

        Args:
            path: Where to; folders are made.
            name: Name of the body; None takes the class.
            assets: Where .xml has its meshes: in itself, or in files beside it as .urdf always does.
            contact: Parts in .xml carry contact parameters with which things stand still at MuJoCo's default options.

        Returns:
            The path written.

        Raises:
            InvalidOption: Another suffix; the message lists these.
        """
        from gfp_grasp.export import export_completion, legal_name, needs_parts

        return export_completion(
            self.mesh,
            self.parts if needs_parts(path) else (),
            Path(path),
            name=name or legal_name(self.category or "object"),
            density=self.density_kg_m3,
            up=self.detection.up,
            assets=assets,
            contact=contact,
        )

    def add_to(self, spec: Any, prefix: str = "", *, name: str | None = None, contact: bool = True) -> str:
        """Add the completion to a user's own scene as a body that is free to move.

        Args:
            spec: The scene, a mujoco.MjSpec; its world is the input's frame.
            prefix: Goes before all names that are added.
            name: Name of the body; None takes the class, with a number where that is taken.
            contact: As in `export`.

        Returns:
            The name of the body, with its prefix.

        Raises:
            InvalidOption: An illegal name, or one that is taken.
        """
        from gfp_grasp.export import legal_name
        from gfp_grasp.scenes import add_body

        taken = {body.name for body in spec.bodies}
        if name is None:
            own = {body.removeprefix(prefix) for body in taken if body.startswith(prefix)}
            name = free_name(legal_name(self.category or "object"), own)
        elif prefix + name in taken:
            raise InvalidOption(f"the scene has a body {prefix + name!r} already: give another name or prefix")
        add_body(spec, self.body(name), prefix=prefix, contact=contact)
        return prefix + name

    def body(self, name: str) -> Body:
        """What is written of it: meshes in a frame that stands in the middle of its foot, and its weight."""
        from gfp_grasp.export import foot_pose, make_body

        T = foot_pose(self.mesh, self.parts, self.detection.up)
        return make_body(self.mesh, self.parts, name=name, density=self.density_kg_m3, T_world_body=T)

    @property
    def density_kg_m3(self) -> float:
        """The mean density of its class; of something solid where no primitive was fitted."""
        fit = self.shape.fit
        low, high = default_density(hollow=False) if fit is None else fit.primitive.spec.density_kg_m3
        return (low + high) / 2


@dataclass(frozen=True, eq=False)
class CompletedScene(Sequence[Completion]):
    """The completed objects of one picture or scan, largest first.

    Attributes:
        completions: The objects.
        view: The picture, or the scan.
        support: What they stand on; None where a detector does not tell.
        gave_way: Which objects were cut back where they reached into others.
    """

    completions: tuple[Completion, ...]
    view: DepthImage | RangeImage
    support: SupportPlane | None
    gave_way: tuple[GaveWay, ...] = ()

    @classmethod
    def of(cls, completions: Sequence[Completion], view: DepthImage | RangeImage) -> CompletedScene:
        """A scene of the completions of a picture, cut back where they reach into each other."""
        if not completions:
            return cls((), view, None)
        detections = [completion.detection for completion in completions]
        support = lowest_support(completions)
        apart = make_way(
            [completion.shape for completion in completions],
            up=detections[0].up if support is None else support.normal,
            floors_m=[None if found.support is None else found.support.height_m for found in detections],
            sigma_m=detections[0].sensor.sigma_m,
        )
        made = tuple(
            replace(completion, shape=shape, bounds=bounds)
            for completion, shape, bounds in zip(completions, apart.shapes, apart.bounds, strict=True)
        )
        return cls(made, view, support, tuple(apart.gave_way))

    @overload
    def __getitem__(self, index: int) -> Completion: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Completion, ...]: ...
    def __getitem__(self, index: int | slice) -> Completion | tuple[Completion, ...]:
        """One completion, or several."""
        return self.completions[index]

    def __len__(self) -> int:
        """Number of objects."""
        return len(self.completions)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """A name of its own for each object: its class, with a number from the second of a class on."""
        from gfp_grasp.export import legal_name

        names: list[str] = []
        for completion in self.completions:
            names.append(free_name(legal_name(completion.category or "object"), set(names)))
        return tuple(names)

    @property
    def up(self) -> np.ndarray:
        """(3,) normal of what the objects stand on, a road's mean under them; z where nothing is known of it."""
        if isinstance(self.view, RangeImage):
            normals = [one.detection.support.normal for one in self.completions if one.detection.support is not None]
            if normals:
                return np.sum(normals, axis=0) / np.linalg.norm(np.sum(normals, axis=0))
        if self.support is not None:
            return self.support.normal
        return self.completions[0].detection.up if self.completions else np.array([0.0, 0.0, 1.0])

    def export(
        self, path: str | Path, *, assets: Literal["embedded", "files"] = "embedded", contact: bool = True
    ) -> Path:
        """Write all objects into one file; the suffix chooses: .xml (MJCF), .urdf, .glb, and .obj .ply .stl (one mesh).

        In .xml the objects of a LiDAR's scan stand on the road as it is below each: on a floor that touches its lowest
        place, or on slabs `<name>_road` above that.

        Args:
            path: Where to; folders are made.
            assets: Where .xml has its meshes: in itself, or in files beside it as .urdf always does.
            contact: As in `Completion.export`.

        Returns:
            The path written.

        Raises:
            InvalidOption: Another suffix; the message lists these.
        """
        from gfp_grasp.export import export_bodies, roads_under

        bodies, slabs = self.bodies(), ()
        floor_m = None if self.support is None else self.support.height_m
        if isinstance(self.view, RangeImage):
            slabs, floor_m = roads_under(bodies, [one.detection.support for one in self.completions], self.up)
        return export_bodies(bodies, path, up=self.up, floor_m=floor_m, slabs=slabs, assets=assets, contact=contact)

    def add_to(self, spec: Any, prefix: str = "", *, contact: bool = True) -> tuple[str, ...]:
        """Add all objects to a mujoco.MjSpec as free bodies and return their names; see `Completion.add_to`."""
        return tuple(completion.add_to(spec, prefix, contact=contact) for completion in self.completions)

    def bodies(self) -> list[Body]:
        """What is written of each object."""
        return [completion.body(name) for name, completion in zip(self.names, self.completions, strict=True)]


def lowest_support(completions: Sequence[Completion]) -> SupportPlane | None:
    """The support below all objects, for some may stand on others; None where none is known."""
    known = [
        found.support for found in (completion.detection for completion in completions) if found.support is not None
    ]
    return min(known, key=lambda support: support.height_m, default=None)


def free_name(name: str, taken: Container[str]) -> str:
    """The name, or the name with the first number from 2 on that is not taken."""
    if name not in taken:
        return name
    return next(numbered for numbered in (f"{name}_{i}" for i in count(2)) if numbered not in taken)
