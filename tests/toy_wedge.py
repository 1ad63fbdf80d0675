"""A wedge without any symmetry, with modes, and what a made-up sensor says of it: for answers known by hand."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from gfp_grasp.register import PoseShape
from gfp_grasp.register.state import surface_samples
from gfp_grasp.transforms import make_T
from gfp_grasp.types import (
    OUTSIDE,
    TABLETOP,
    DepthImage,
    GenericPrimitive,
    LevelView,
    PointCloud,
    Silhouette,
    Symmetry,
)

NUM_SAMPLES = 60
NUM_MODES = 3
UP = np.array([0.0, 0.0, 1.0])  # as in every level view


@lru_cache(maxsize=1)
def wedge_primitive() -> GenericPrimitive:
    """A sheared box of 12 x 8 x 5 cm that is thicker at one end, off its own axis, with three modes."""
    box = trimesh.creation.box(extents=(0.12, 0.08, 0.05))
    for _ in range(3):
        box = box.subdivide()
    x, y, z = (np.asarray(box.vertices) + np.array([0.0, 0.0, 0.025])).T
    vertices = np.column_stack([x + 0.02, y + 0.3 * z - 0.01, z * (1.3 + 5.0 * x)])
    monomials = np.column_stack([x, y, z, x * y / 0.05, y * z / 0.05, z * x / 0.05])
    modes = np.einsum("vm,kmd->kvd", monomials, np.random.default_rng(7).normal(scale=0.04, size=(NUM_MODES, 6, 3)))
    A = np.array([[0.15, 0.03, -0.02], [0.0, 0.12, 0.05], [0.0, 0.0, 0.1]])
    return GenericPrimitive(
        category="wedge",
        vertices=vertices,
        faces=np.asarray(box.faces),
        modes=modes,
        explained=np.array([0.5, 0.3, 0.2]),
        log_scale_cov=A @ A.T,
        coefficient_samples=np.random.default_rng(8).normal(size=(30, NUM_MODES + 3)) * 0.1,
        symmetry=Symmetry(np.array([0.0, 0.0, 1.0]), 1),
        up=np.array([0.0, 0.0, 1.0]),
        regions=np.full(len(vertices), OUTSIDE, dtype=np.uint8),
    )


def wedge_state(**changes: object) -> PoseShape:
    """A state in general position: turned, moved, stretched, with all modes."""
    R = Rotation.from_rotvec([0.7, -0.4, 1.1]).as_matrix()
    values: dict[str, object] = {
        "R": R,
        "t": np.array([0.31, -0.12, 0.47]),
        "log_scale": np.array([0.2, -0.15, 0.1]),
        "coefficients": np.array([0.8, -0.5, 0.3]),
        "axis_world": R @ Rotation.from_rotvec([0.03, 0.05, 0.0]).as_matrix()[:, 2],
        "axis_sigma_rad": 0.1,
        "hypothesis": "upright",
    }
    return PoseShape(**{**values, **changes})  # type: ignore[arg-type]


def positions(state: PoseShape, primitive: GenericPrimitive) -> np.ndarray:
    """(NUM_SAMPLES, 3) m, world: the samples of the surface in a state."""
    return state.world(surface_samples(primitive, NUM_SAMPLES).local(state.coefficients))


def face_normals(state: PoseShape, primitive: GenericPrimitive) -> np.ndarray:
    """(NUM_SAMPLES, 3): unit normals of the moved faces on which the samples lie."""
    a, b, c = state.world(primitive.shape(state.coefficients, np.ones(3)))[
        primitive.faces[surface_samples(primitive, NUM_SAMPLES).face]
    ].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def perturbed(state: PoseShape, step: np.ndarray) -> PoseShape:
    """The state after a step (9 + k,): turn in the world, shift, logarithm of scale, modes."""
    return PoseShape(
        R=Rotation.from_rotvec(step[:3]).as_matrix() @ state.R,
        t=state.t + step[3:6],
        log_scale=state.log_scale + step[6:9],
        coefficients=state.coefficients + step[9:],
        axis_world=state.axis_world,
        axis_sigma_rad=state.axis_sigma_rad,
        hypothesis=state.hypothesis,
    )


def derivative(function, state: PoseShape, *, size: float = 1e-6) -> np.ndarray:
    """(..., 9 + k) of a function of the state, by central differences."""
    steps = size * np.eye(9 + len(state.coefficients))
    return np.stack(
        [(function(perturbed(state, e)) - function(perturbed(state, -e))) / (2 * size) for e in steps], axis=-1
    )


def toy_evidence(
    points: np.ndarray,
    normals: np.ndarray | None = None,
    *,
    viewpoint: np.ndarray | None = None,
    oriented: bool = True,
    **changes: object,
) -> LevelView:
    """A level view of points (n, 3), without a floor or a silhouette unless told.

    Where normals are oriented and no viewpoint is told, it is far away.
    """
    normals = np.tile(UP, (len(points), 1)) if normals is None else normals
    if viewpoint is None and oriented:
        viewpoint = np.array([500.0, 300.0, 400.0])
    values: dict[str, object] = {
        "T_world_level": np.eye(4),
        "cloud": PointCloud(points, viewpoint),
        "dense_points": points,
        "dense_normals": normals,
        "points": points,
        "normals": normals,
        "floor_m": 0.0,
        "floor_sigma_m": (0.002, 0.002),
        "floor_seen": True,
        "silhouette": None,
        "sensor": TABLETOP,
        "sigma_m": 0.0013,
    }
    return LevelView(**{**values, **changes})  # type: ignore[arg-type]


def with_viewpoint(view: LevelView, viewpoint: np.ndarray | None) -> LevelView:
    """The same view from another place, or from none."""
    return replace(view, cloud=PointCloud(view.cloud.points, viewpoint))


def corner_silhouette(
    T_world_camera: np.ndarray,
    *,
    corner: tuple[int, int],
    free_range_m: float | np.ndarray = np.inf,
    certain: bool = True,
    shape: tuple[int, int] = (120, 160),
    K: np.ndarray = np.array([[150.0, 0.0, 70.3], [0.0, 190.0, 55.6], [0.0, 0.0, 1.0]]),
) -> Silhouette:
    """A picture whose object fills all pixels up to a row and a column, so that the way back is known by hand."""
    row, column = np.indices(shape)
    inside = (row <= corner[0]) & (column <= corner[1])
    offset = np.stack([np.minimum(corner[0] - row, 0), np.minimum(corner[1] - column, 0)]).astype(np.float64)
    free = np.where(inside, 0.0, free_range_m)
    view = DepthImage(np.zeros(shape), K, T_world_camera)
    return Silhouette(view, free, certain, offset, margin_m=0.006)


def camera_at(viewpoint: np.ndarray, target: np.ndarray, roll_rad: float = 0.4) -> np.ndarray:
    """T_world_camera (4, 4) of a rolled camera that looks at a target."""
    z = (target - viewpoint) / np.linalg.norm(target - viewpoint)
    x = np.cross(z, (0.3, 0.9, 0.2))
    x /= np.linalg.norm(x)
    R = np.column_stack([x, np.cross(z, x), z]) @ Rotation.from_rotvec([0, 0, roll_rad]).as_matrix()
    return make_T(R, viewpoint)
