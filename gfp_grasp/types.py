"""One frozen type for each stage of the data's way, from depth picture to grasp outcome.

World is z up, metres; camera frames are OpenCV's (x right, y down, z forward). Arrays are checked once, here, and are
read-only afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidCloud, InvalidMesh, InvalidView
from gfp_grasp.transforms import is_rotation

OUTSIDE, INSIDE, HANDLE = 0, 1, 2
REGION_NAMES = ("outside", "inside", "handle")

_FARTHEST_M = 50.0  # depth cameras end at 10 m; a picture in millimetres begins at 100

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
class DepthImage:
    """One depth picture.

    Attributes:
        depth_m: (h, w) float32 m along the optical axis; 0 where nothing came back.
        K: (3, 3) float64 px, pinhole intrinsics; pixel centres are at whole numbers.
        T_world_camera: (4, 4) float64, pose of the OpenCV camera frame.
    """

    depth_m: np.ndarray
    K: np.ndarray
    T_world_camera: np.ndarray

    def __post_init__(self) -> None:
        with np.errstate(over="ignore"):
            depth = _numbers(self.depth_m, "depth_m", InvalidView).astype(np.float32)
        if depth.ndim != 2 or depth.size == 0:
            raise InvalidView(f"depth_m has shape {depth.shape}; an (h, w) picture in metres is expected")
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
        far = float(np.median(depth[depth > 0])) if depth.any() else 0.0
        if far > _FARTHEST_M:
            raise InvalidView(f"depth_m has a median of {far:.4g} and metres are expected: divide millimetres by 1000")
        _freeze(self, "depth_m", depth)
        K = _matrix(self.K, (3, 3), "K", InvalidView)
        if K[0, 0] <= 0 or K[1, 1] <= 0:
            raise InvalidView(f"focal lengths are {K[0, 0]}, {K[1, 1]} px; both must be positive")
        _freeze(self, "K", K)
        T = _matrix(self.T_world_camera, (4, 4), "T_world_camera", InvalidView)
        if not is_rotation(T[:3, :3]):
            raise InvalidView("T_world_camera is no rigid motion: a rotation without scale or mirror is expected")
        _freeze(self, "T_world_camera", T)


@dataclass(frozen=True, eq=False)
class PointCloud:
    """Points of one frame.

    Attributes:
        points: (n, 3) float64 m, world frame, finite.
        viewpoint: (3,) float64 m, where the camera stood, or None.
    """

    points: np.ndarray
    viewpoint: np.ndarray | None = None

    def __post_init__(self) -> None:
        points = np.asarray(self.points, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise InvalidCloud(f"points have shape {points.shape}; (n, 3) in metres is expected")
        if not np.isfinite(points).all():
            raise InvalidCloud("points are not all finite: drop the rows with NaN first")
        _freeze(self, "points", points)
        if self.viewpoint is not None:
            _freeze(self, "viewpoint", _vector(self.viewpoint, 3, "viewpoint", InvalidCloud))


@dataclass(frozen=True, eq=False)
class OrientedBox:
    """A box: T_world_box (4, 4), origin at its centre; extents (3,) m along its axes."""

    T_world_box: np.ndarray
    extents: np.ndarray

    def __post_init__(self) -> None:
        _freeze(self, "T_world_box", _matrix(self.T_world_box, (4, 4), "T_world_box", InvalidCloud))
        _freeze(self, "extents", _vector(self.extents, 3, "extents", InvalidCloud))


@dataclass(frozen=True, eq=False)
class SupportPlane:
    """The plane that objects rest on: points x with normal @ x == height_m; the normal (3,) is unit and points up."""

    normal: np.ndarray
    height_m: float

    def __post_init__(self) -> None:
        normal = _vector(self.normal, 3, "normal", InvalidCloud)
        length = float(np.linalg.norm(normal))
        if length < 1e-9:
            raise InvalidCloud("the support normal is zero: give the direction that is up, e.g. (0, 0, 1)")
        _freeze(self, "normal", normal / length)
        object.__setattr__(self, "height_m", float(self.height_m))

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Signed distance (n,) m of (n, 3) points, positive above."""
        return points @ self.normal - self.height_m


@dataclass(frozen=True, eq=False)
class Detection:
    """One object in the cloud.

    Attributes:
        cloud: Points of this object only, world frame.
        up: (3,) unit, the support's normal (not the object's axis).
        support: The plane it rests on, or None where it is unknown.
        category: Best class; "" where no class was asked for.
        scores: Probability of each class that is known, sums to one; empty where no class was asked for.
        box: Oriented box of the observed points, its z along up.
        view: The whole depth picture, for free space, or None.
        mask: (h, w) bool, this object's pixels in the view, or None.
        sensor_sigma_m: Standard deviation of the depth noise, as given or estimated.
    """

    cloud: PointCloud
    up: np.ndarray
    support: SupportPlane | None
    category: str
    scores: Mapping[str, float]
    box: OrientedBox
    view: DepthImage | None = None
    mask: np.ndarray | None = None
    sensor_sigma_m: float = 0.0015

    def __post_init__(self) -> None:
        _freeze(self, "up", _vector(self.up, 3, "up", InvalidCloud))
        if self.mask is not None:
            if self.view is None:
                raise InvalidView("a mask came without its view: give both, or neither")
            mask = np.asarray(self.mask, dtype=bool)
            if mask.shape != self.view.depth_m.shape:
                raise InvalidView(f"mask has shape {mask.shape}, the depth picture {self.view.depth_m.shape}")
            _freeze(self, "mask", mask)


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
        _freeze(self, "axis", _vector(self.axis, 3, "axis", InvalidMesh))
        if self.mirror_normal is not None:
            _freeze(self, "mirror_normal", _vector(self.mirror_normal, 3, "mirror_normal", InvalidMesh))


@dataclass(frozen=True, eq=False)
class ConvexPart:
    """A convex polyhedron: vertices (p, 3) m, faces (q, 3), outward."""

    vertices: np.ndarray
    faces: np.ndarray

    def __post_init__(self) -> None:
        _freeze(self, "vertices", np.asarray(self.vertices, dtype=np.float64))
        _freeze(self, "faces", np.asarray(self.faces, dtype=np.int64))

    def to_trimesh(self) -> trimesh.Trimesh:
        """A fresh, writable trimesh of it."""
        return trimesh.Trimesh(self.vertices.copy(), self.faces.copy(), process=False)


@dataclass(frozen=True, eq=False)
class GenericPrimitive:
    """The Generic Primitive (GP) of a class: a mean mesh with modes of shape.

    A member of the class is T_world_object @ (scale * (vertices + sum_i coefficients_i * modes_i)).

    Attributes:
        category: Class name.
        kind: Name of a part of the class that is unlike the rest of it, as cups with stems are; "" is the class itself.
        vertices: (v, 3) float64 m, mean mesh in the primitive's frame: z up, axis through x = y = 0, base at z = 0,
            a handle towards +x.
        faces: (f, 3) int, watertight, outward.
        modes: (k, v, 3) float64 m per unit coefficient; a coefficient of one is one standard deviation.
        explained: (k,) share of the variance of each mode.
        log_scale_cov: (3, 3) covariance of the natural logarithm of scale, whose mean is zero.
        coefficient_samples: (s, k + 3) coefficients and log scales of the members it was built from.
        symmetry: Rotation axis, order and mirror plane.
        up: (3,) upright axis, (0, 0, 1).
        regions: (v,) uint8, OUTSIDE, INSIDE or HANDLE.
        parts: Convex parts of the mean mesh, in the same frame, p at the finest level.
        part_merges: (p - 1, 2) which of them become one first, see `collision.merging`; empty where that is not stored.
        part_errors_m: (p, 2) m, mean and 95 % distance between the mean mesh and its parts where 1 .. p are left; or
            empty.
        twin: For a primitive with a handle, the same body without it; its vertices are the first `twin_map`.
        twin_map: (v_twin,) index of each of the twin's vertices in `vertices`, or None.
        licence: Of the meshes it was built from.
        card: How it was built: command, seed, data, metrics.
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
    twin: GenericPrimitive | None = None
    twin_map: np.ndarray | None = None
    licence: str = ""
    card: Mapping[str, object] = field(default_factory=dict)
    kind: str = ""
    part_merges: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))
    part_errors_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        vertices = np.asarray(self.vertices, dtype=np.float64)
        modes = np.asarray(self.modes, dtype=np.float64)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise InvalidMesh(f"primitive vertices have shape {vertices.shape}; (v, 3) is expected")
        if modes.ndim != 3 or modes.shape[1:] != vertices.shape:
            raise InvalidMesh(f"modes have shape {modes.shape}; (k, {len(vertices)}, 3) is expected")
        _freeze(self, "vertices", vertices)
        _freeze(self, "modes", modes)
        _freeze(self, "faces", np.asarray(self.faces, dtype=np.int64))
        _freeze(self, "explained", np.asarray(self.explained, dtype=np.float64))
        _freeze(self, "log_scale_cov", _matrix(self.log_scale_cov, (3, 3), "log_scale_cov", InvalidMesh))
        _freeze(self, "coefficient_samples", np.asarray(self.coefficient_samples, dtype=np.float64))
        _freeze(self, "up", _vector(self.up, 3, "up", InvalidMesh))
        _freeze(self, "regions", np.asarray(self.regions, dtype=np.uint8))
        _freeze(self, "part_merges", np.asarray(self.part_merges, dtype=np.int64))
        _freeze(self, "part_errors_m", np.asarray(self.part_errors_m, dtype=np.float64))
        if self.twin_map is not None:
            _freeze(self, "twin_map", np.asarray(self.twin_map, dtype=np.int64))

    @property
    def name(self) -> str:
        """Class and kind, as "cup.stemmed"; of the class itself, the class."""
        return f"{self.category}.{self.kind}" if self.kind else self.category

    def shape(self, coefficients: np.ndarray, scale: np.ndarray) -> np.ndarray:
        """Vertices (v, 3) m in the primitive's frame for (k,) coefficients and (3,) scale."""
        return (self.vertices + np.tensordot(coefficients, self.modes, axes=1)) * scale


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
    """

    primitive: GenericPrimitive
    T_world_object: np.ndarray
    scale: np.ndarray
    coefficients: np.ndarray
    residual_m: float
    hypothesis: str = "upright"
    margin: float = float("inf")
    cost: float = 0.0

    def __post_init__(self) -> None:
        _freeze(self, "T_world_object", _matrix(self.T_world_object, (4, 4), "T_world_object", InvalidMesh))
        _freeze(self, "scale", _vector(self.scale, 3, "scale", InvalidMesh))
        num_modes = len(self.primitive.modes)
        _freeze(self, "coefficients", _vector(self.coefficients, num_modes, "coefficients", InvalidMesh))

    def vertices_world(self) -> np.ndarray:
        """(v, 3) m, world frame."""
        local = self.primitive.shape(self.coefficients, self.scale)
        return local @ self.T_world_object[:3, :3].T + self.T_world_object[:3, 3]


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
        _freeze(self, "observed", observed)
        _freeze(self, "sigma_m", sigma)


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
        _freeze(self, "T_world_gripper", _matrix(self.T_world_gripper, (4, 4), "T_world_gripper", InvalidView))


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


def _freeze(owner: object, name: str, array: np.ndarray) -> None:
    array = np.array(array)
    array.setflags(write=False)
    object.__setattr__(owner, name, array)


def _numbers(value: object, name: str, error: type[Exception]) -> np.ndarray:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, RuntimeError) as cause:
        raise error(f"{name} is a {type(value).__name__} that is no array of numbers: {cause}") from cause


def _matrix(value: object, shape: tuple[int, int], name: str, error: type[Exception]) -> np.ndarray:
    matrix = _numbers(value, name, error)
    if matrix.shape != shape or not np.isfinite(matrix).all():
        finite = bool(np.isfinite(matrix).all())
        raise error(f"{name} has shape {matrix.shape}, finite: {finite}; finite {shape} is expected")
    return matrix


def _vector(value: object, length: int, name: str, error: type[Exception]) -> np.ndarray:
    vector = _numbers(value, name, error)
    if vector.shape != (length,) or not np.isfinite(vector).all():
        finite = bool(np.isfinite(vector).all())
        raise error(f"{name} has shape {vector.shape}, finite: {finite}; finite ({length},) is expected")
    return vector
