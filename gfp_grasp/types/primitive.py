"""The Generic Primitive of a class, and one that is fitted to a detection."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.types.arrays import checked_matrix, checked_vector, freeze
from gfp_grasp.types.category import CategorySpec, OptionalPart, default_density

# The first two regions of every primitive; parts of the body that stand apart from it, as handles, follow.
OUTSIDE, INSIDE = 0, 1
BODY_REGIONS = ("outside", "inside")
# An open vessel has this share of its vertices inside at least; a lid that is sunk a little has less.
_HOLLOW_SHARE = 0.08
_LEAST_EXTENT = 0.1  # of the diagonal


@dataclass(frozen=True, eq=False)
class Symmetry:
    """Symmetry of a primitive in its own frame.

    Attributes:
        axis: (3,) unit, axis of rotation through the origin.
        order: Fold of the rotation; math.inf for a body of revolution, 1 for none.
        mirror_normal: (3,) unit normal of a mirror plane through the origin, or None.
    """

    axis: np.ndarray
    order: float
    mirror_normal: np.ndarray | None = None

    def __post_init__(self) -> None:
        freeze(self, "axis", checked_vector(self.axis, 3, "axis", InvalidMesh))
        if self.mirror_normal is not None:
            freeze(self, "mirror_normal", checked_vector(self.mirror_normal, 3, "mirror_normal", InvalidMesh))


@dataclass(frozen=True, eq=False)
class ConvexPart:
    """A convex polyhedron: vertices (p, 3) m, faces (q, 3), outward."""

    vertices: np.ndarray
    faces: np.ndarray

    def __post_init__(self) -> None:
        freeze(self, "vertices", np.asarray(self.vertices, dtype=np.float64))
        freeze(self, "faces", np.asarray(self.faces, dtype=np.int64))

    def to_trimesh(self) -> trimesh.Trimesh:
        """A fresh, writable trimesh of it."""
        return trimesh.Trimesh(self.vertices.copy(), self.faces.copy(), process=False)


@dataclass(frozen=True, eq=False)
class PartBinding:
    """How the p points of convex parts move with a primitive's surface, and where the primitive is hollow.

    Attributes:
        corners: (p, 3) vertices of the triangle below each point.
        weights: (p, 3) float32, where on the triangle the foot of each point is; rows sum to one.
        height_m: (p,) float32, height of each point above that triangle, along the normal.
        ends: (parts,) where the points of each part end.
        gap_m: (3,) m, centre of the widest ball that fits into the primitive, as into a cup; None where it is solid.
    """

    corners: np.ndarray
    weights: np.ndarray
    height_m: np.ndarray
    ends: np.ndarray
    gap_m: np.ndarray | None

    def __post_init__(self) -> None:
        freeze(self, "corners", np.asarray(self.corners, dtype=np.int32))
        freeze(self, "weights", np.asarray(self.weights, dtype=np.float32))
        freeze(self, "height_m", np.asarray(self.height_m, dtype=np.float32))
        freeze(self, "ends", np.asarray(self.ends, dtype=np.int32))
        count = len(self.height_m)
        if not self.corners.shape == self.weights.shape == (count, 3) or (np.diff(self.ends, prepend=0) < 0).any():
            raise InvalidMesh(
                f"a binding has corners {self.corners.shape}, weights {self.weights.shape} and ends {self.ends}; "
                f"({count}, 3) and ascending ends are expected"
            )
        if self.ends.shape[0] < 1 or self.ends[-1] != count:
            raise InvalidMesh(f"the parts of a binding end at {self.ends[-1:]}; it has {count} points")
        if self.gap_m is not None:
            freeze(self, "gap_m", checked_vector(self.gap_m, 3, "gap_m", InvalidMesh))


@dataclass(frozen=True, eq=False)
class Variant:
    """A primitive without some of its optional parts: the holes that they leave are closed.

    Attributes:
        without: Names of the parts that are left out.
        primitive: The body that is left; coefficients and scale of the whole primitive hold for it.
        vertex_map: (w,) index of each of its vertices among those of the whole primitive.
    """

    without: tuple[str, ...]
    primitive: GenericPrimitive
    vertex_map: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, "without", tuple(self.without))
        vertex_map = np.asarray(self.vertex_map, dtype=np.int64)
        if not self.without or vertex_map.shape != (len(self.primitive.vertices),):
            raise InvalidMesh(
                f"a variant without {self.without} has a vertex map of shape {vertex_map.shape}; names of parts and "
                f"({len(self.primitive.vertices)},) are expected"
            )
        freeze(self, "vertex_map", vertex_map)


@dataclass(frozen=True, eq=False)
class GenericPrimitive:
    """The Generic Primitive (GP) of a class: a mean mesh with modes of shape.

    A member of the class is T_world_object @ (scale * (vertices + sum_i coefficients_i * modes_i)).

    Attributes:
        category: Class name.
        subcategory: Name of those members that are unlike the rest of the class, as "stemmed"; "" is the class itself.
        vertices: (v, 3) float64 m, mean mesh in the primitive's frame: z up, axis through x = y = 0, base at z = 0,
            a handle towards +x.
        faces: (f, 3) int, watertight, outward.
        modes: (k, v, 3) float64 m per unit coefficient; a coefficient of one is one standard deviation.
        explained: (k,) share of the variance of each mode.
        log_scale_cov: (3, 3) covariance of the natural logarithm of scale, whose mean is zero.
        coefficient_samples: (s, k + 3) coefficients and log scales of the members it was built from.
        symmetry: Rotation axis, order and mirror plane.
        up: (3,) upright axis, (0, 0, 1).
        regions: (v,) uint8, index into `region_names`.
        region_names: "outside", "inside", then the parts that stand out of the body, as "handle".
        parts: Convex parts of the mean mesh, in the same frame, p at the finest level.
        part_merges: (p - 1, 2) which of them become one first, see `collision.levels`; empty where that is not stored.
        part_errors_m: (p, 2) m, mean and 95 % distance between the mean mesh and its parts where 1 .. p are left; or
            empty.
        binding: How the parts of the default level move with the surface; None where that is not stored: it is found
            at their first use then, which takes a fifth of a second.
        variants: The same body without some of its optional parts, for each set of parts that it may lack.
        licence: Licence of the meshes it was built from.
        card: How it was built: command, seed, data, metrics.
        spec: What is known of the class beside its shape; None makes the default from the arrays above.
        prototypes: (p, c) float32 embeddings of the members by which the classifier knows the class; (0, 0) for none.
    """

    category: str
    vertices: np.ndarray
    faces: np.ndarray
    modes: np.ndarray
    explained: np.ndarray
    log_scale_cov: np.ndarray
    coefficient_samples: np.ndarray
    symmetry: Symmetry
    up: np.ndarray
    regions: np.ndarray
    parts: tuple[ConvexPart, ...] = ()
    region_names: tuple[str, ...] = BODY_REGIONS
    variants: tuple[Variant, ...] = ()
    licence: str = ""
    card: Mapping[str, object] = field(default_factory=dict)
    subcategory: str = ""
    part_merges: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    part_errors_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    binding: PartBinding | None = None
    spec: CategorySpec = None  # pyright: ignore[reportAssignmentType]
    prototypes: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        vertices = np.asarray(self.vertices, dtype=np.float64)
        modes = np.asarray(self.modes, dtype=np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise InvalidMesh(f"primitive vertices have shape {vertices.shape}; (v, 3) is expected")
        if modes.ndim != 3 or modes.shape[1:] != vertices.shape:
            raise InvalidMesh(f"modes have shape {modes.shape}; (k, {len(vertices)}, 3) is expected")
        freeze(self, "vertices", vertices)
        freeze(self, "modes", modes)
        freeze(self, "faces", np.asarray(self.faces, dtype=np.int64))
        freeze(self, "explained", np.asarray(self.explained, dtype=np.float64))
        freeze(self, "log_scale_cov", checked_matrix(self.log_scale_cov, (3, 3), "log_scale_cov", InvalidMesh))
        freeze(self, "coefficient_samples", np.asarray(self.coefficient_samples, dtype=np.float64))
        freeze(self, "up", checked_vector(self.up, 3, "up", InvalidMesh))
        freeze(self, "regions", np.asarray(self.regions, dtype=np.uint8))
        object.__setattr__(self, "region_names", tuple(self.region_names))
        if self.region_names[:2] != BODY_REGIONS or self.regions.max(initial=0) >= len(self.region_names):
            raise InvalidMesh(
                f"region_names are {self.region_names}, regions are up to {self.regions.max(initial=0)}; "
                f"{BODY_REGIONS}, then a name for each part that regions point at, are expected"
            )
        freeze(self, "part_merges", np.asarray(self.part_merges, dtype=np.int64))
        freeze(self, "part_errors_m", np.asarray(self.part_errors_m, dtype=np.float64))
        prototypes = np.asarray(self.prototypes, dtype=np.float32)
        if prototypes.ndim != 2 or not np.isfinite(prototypes).all():
            raise InvalidMesh(f"prototypes have shape {prototypes.shape}; finite (p, c) is expected")
        freeze(self, "prototypes", prototypes)
        if self.binding is not None and self.binding.corners.max(initial=0) >= len(vertices):
            raise InvalidMesh(f"the binding has vertex {self.binding.corners.max()}; there are {len(vertices)}")
        if self.binding is not None and len(self.binding.ends) > len(self.parts):
            raise InvalidMesh(
                f"the binding has {len(self.binding.ends)} parts, the primitive {len(self.parts)}: other parts need "
                "another binding, or None"
            )
        if self.spec is None:
            object.__setattr__(self, "spec", default_spec(self))
        elif self.spec.category != self.name:
            raise InvalidOption(f"the spec is of {self.spec.category!r}, the primitive is of {self.name!r}")
        unknown = {part.name for part in self.spec.optional_parts} - set(self.region_names[2:])
        if unknown:
            raise InvalidOption(
                f"optional parts {sorted(unknown)} of {self.name} are no regions of it; "
                f"it has {', '.join(self.region_names[2:]) or 'none beside its body'}"
            )

    @property
    def name(self) -> str:
        """Class and subcategory, as "class.subcategory"; the class alone where it is the class itself."""
        return f"{self.category}.{self.subcategory}" if self.subcategory else self.category

    def on_region(self, name: str) -> np.ndarray:
        """(v,) bool, the vertices of a region; none where the primitive has no region of that name."""
        if name not in self.region_names:
            return np.zeros(len(self.vertices), dtype=bool)
        return self.regions == self.region_names.index(name)

    @property
    def on_part(self) -> np.ndarray:
        """(v,) bool, the vertices of all parts that stand out of the body."""
        return self.regions >= len(BODY_REGIONS)

    def without(self, parts: Iterable[str]) -> GenericPrimitive | None:
        """The same body without some of its optional parts, itself for no part; None where that is not stored."""
        wanted = set(parts)
        if not wanted:
            return self
        return next((variant.primitive for variant in self.variants if set(variant.without) == wanted), None)

    @property
    def size_m(self) -> float:
        """The size, m, that registration and deformation measure in: the geometric mean of the mean mesh's extents.

        The shipped cup, mug and bottle have 92, 99 and 97 mm; a car has 2.3 m. What is flatter than a tenth of its
        diagonal counts as that thick.
        """
        extents = np.ptp(self.vertices, axis=0)
        return float(np.cbrt(np.maximum(extents, _LEAST_EXTENT * np.linalg.norm(extents)).prod()))

    def shape(self, coefficients: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Vertices (v, 3) m in the primitive's frame for (k,) coefficients and (3,) scale."""
        return (self.vertices + np.tensordot(coefficients, self.modes, axes=1)) * scale

    def member_extents_m(self) -> np.ndarray:
        """Extents (s, 3) m of the members it was built from, along its own axes; of its mean where none are stored."""
        samples = self.coefficient_samples.reshape(-1, len(self.modes) + 3)
        if not len(samples):
            return np.ptp(self.vertices, axis=0)[None]
        shapes = (self.shape(row[:-3], np.exp(row[-3:])) for row in samples)
        return np.array([np.ptp(shape, axis=0) for shape in shapes])


def default_spec(primitive: GenericPrimitive) -> CategorySpec:
    """What a primitive itself tells of its class: sizes of the members, hollow or solid, and which parts it has."""
    extents = primitive.member_extents_m()
    hollow = bool((primitive.regions == INSIDE).mean() >= _HOLLOW_SHARE) if len(primitive.regions) else False
    return CategorySpec(
        category=primitive.name,
        parent=primitive.category if primitive.subcategory else None,
        size_range_m=(tuple(extents.min(axis=0)), tuple(extents.max(axis=0))),
        hollow=hollow,
        density_kg_m3=default_density(hollow=hollow),
        optional_parts=tuple(OptionalPart(name) for name in primitive.region_names[2:]),
    )


@dataclass(frozen=True, eq=False)
class FittedPrimitive:
    """A primitive with pose, scale and modes fitted to one detection.

    Attributes:
        primitive: The primitive that was fitted.
        T_world_object: (4, 4) rigid.
        scale: (3,) along the primitive's own axes.
        coefficients: (k,) in standard deviations.
        residual_m: Trimmed mean distance of the observed points to the fitted surface.
        hypothesis: "upright", "upside_down" or "lying": how the object rests on the support.
        margin: Cost of the second best hypothesis over the best, at least 1; inf where there was one only.
        cost: Negative log posterior up to a constant, comparable between primitives fitted to the same evidence.
        spread_m: (v,) m, standard deviation of the vertices over all lengths that the object may have, where something
            hides how far it goes on; else None.
    """

    primitive: GenericPrimitive
    T_world_object: np.ndarray
    scale: np.ndarray
    coefficients: np.ndarray
    residual_m: float
    hypothesis: str = "upright"
    margin: float = float("inf")
    cost: float = 0.0
    spread_m: np.ndarray | None = None

    def __post_init__(self) -> None:
        freeze(self, "T_world_object", checked_matrix(self.T_world_object, (4, 4), "T_world_object", InvalidMesh))
        freeze(self, "scale", checked_vector(self.scale, 3, "scale", InvalidMesh))
        num_modes = len(self.primitive.modes)
        freeze(self, "coefficients", checked_vector(self.coefficients, num_modes, "coefficients", InvalidMesh))
        if self.spread_m is not None:
            num_vertices = len(self.primitive.vertices)
            freeze(self, "spread_m", checked_vector(self.spread_m, num_vertices, "spread_m", InvalidMesh))

    def vertices_world(self) -> np.ndarray:
        """(v, 3) m, world frame."""
        local = self.primitive.shape(self.coefficients, self.scale)
        return local @ self.T_world_object[:3, :3].T + self.T_world_object[:3, 3]
