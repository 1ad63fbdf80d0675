"""Where the pads touch a surface, how squarely and how certainly, and what a grasp there can carry.

The planner works on samples of a completed surface, of its parts and of what stands about. What a grasp carries are
limits of friction and torque at its pads against the pull of the object's weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.camera import cloud_of
from gfp_grasp.grasps.config import GraspConfig, Gripper
from gfp_grasp.meshes import sample_surface
from gfp_grasp.types import Detection

_FEW = 8  # points within the gap from which on what was seen is no stray of the sensor; ours
_REACH_M = 0.35  # neighbours farther from the object than this are out of the gripper's way


class Graspable(Protocol):
    """What the planner looks at; `Completion` is one."""

    @property
    def mesh(self) -> trimesh.Trimesh: ...
    @property
    def parts(self) -> tuple[trimesh.Trimesh, ...]: ...
    @property
    def observed(self) -> np.ndarray: ...
    @property
    def sigma_m(self) -> np.ndarray: ...
    @property
    def detection(self) -> Detection: ...


@dataclass(frozen=True, eq=False)
class Surface:
    """Samples that the pads may touch.

    Attributes:
        points: (n, 3) m, world frame.
        normals: (n, 3) outward.
        certainty: (n,) how certain the points are to be real, 0 to 1.
    """

    points: np.ndarray
    normals: np.ndarray
    certainty: np.ndarray


def surface_of(completion: Graspable, config: GraspConfig, rng: np.random.Generator) -> Surface:
    """`config.num_points` samples of the completed mesh."""
    mesh = completion.mesh
    points, normals, face = sample_surface(mesh, config.num_points, rng)
    return Surface(points, normals, _certainty(completion, config)[mesh.faces[face]].mean(axis=1))


def obstacle_of(completion: Graspable, surface: Surface, config: GraspConfig, rng: np.random.Generator) -> np.ndarray:
    """Points (k, 3) m that the gripper keeps clear of, in no order.

    They lie on the mesh, its parts, what stands about, and where the object was seen and not completed.
    """
    parts = [part for part in completion.parts if part.area > 0]
    areas = np.array([part.area for part in parts])
    counts = np.ceil(config.num_points / 2 * areas / areas.sum()).astype(int) if len(parts) else []
    of_parts = [sample_surface(part, int(n), rng)[0] for part, n in zip(parts, counts, strict=True)]
    corners = [np.asarray(part.vertices) for part in completion.parts]
    seen = [_neighbours(completion.detection, config), _left_over(completion.detection, surface, config)]
    return rng.permutation(np.concatenate([surface.points, *of_parts, *corners, *seen]))


def _certainty(completion: Graspable, config: GraspConfig) -> np.ndarray:
    """How certain each vertex (v,) is to be where it was completed; 0 where nobody says how certain it is."""
    if np.isinf(config.doubt_length_m):
        return np.ones(len(completion.observed))
    guessed = np.exp(-np.nan_to_num(completion.sigma_m, nan=np.inf) / config.doubt_length_m)
    return np.where(completion.observed, 1.0, guessed)


def _neighbours(detection: Detection, config: GraspConfig) -> np.ndarray:
    """Points (n, 3) m on what else stands about: off the support, and off the object."""
    view, support = detection.view, detection.support
    if view is None or support is None:
        return np.empty((0, 3))
    points = cloud_of(view, None if detection.mask is None else ~detection.mask).points
    points = points[support.distances(points) > config.neighbour_gap_m]
    own = np.asarray(detection.cloud.points)
    points = points[np.linalg.norm(points - own.mean(axis=0), axis=1) < _REACH_M]
    if not len(points):
        return points
    return _apart(points, own, config.neighbour_gap_m)


def _left_over(detection: Detection, surface: Surface, config: GraspConfig) -> np.ndarray:
    """The object's own points (n, 3) m that its completion does not come near, but for lone ones."""
    points = _apart(np.asarray(detection.cloud.points), surface.points, config.neighbour_gap_m)
    if not len(points):
        return points
    together = KDTree(points).query_ball_point(points, config.neighbour_gap_m, return_length=True)
    return points[together >= _FEW]


def _apart(points: np.ndarray, others: np.ndarray, gap_m: float) -> np.ndarray:
    """Those of points (n, 3) m that are farther than a gap from all others (k, 3) m."""
    return points[np.isinf(KDTree(others).query(points, distance_upper_bound=gap_m)[0])]


# Surface this close to the first touch counts as touched: pads and real surfaces give way by about as much.
_TOUCH_M = 1e-3
# Poses times points that are looked at at once.
_CHUNK = 2_000_000
_NONE = np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contact of p grasps.

    Attributes:
        low_m: (p,) where the jaw at -y first touches, along y from the grasp's origin; NaN where nothing is between.
        high_m: (p,) the same for the jaw at +y.
        squareness: (p,) cosine between closing axis and mean normal, the worse of both patches.
        certainty: (p,) mean over both patches of how certain the points are to be where they seem, 0 to 1.
        levers_m: (p, 3, 3) m, symmetric: the pads resist a torque t, in the gripper's frame, up to |levers^-1 t| of 1
            for a unit of grip force; those of the pad that has the smaller ones.
    """

    low_m: np.ndarray
    high_m: np.ndarray
    squareness: np.ndarray
    certainty: np.ndarray
    levers_m: np.ndarray

    def take(self, which: np.ndarray) -> Contacts:
        """Contacts of some of the grasps."""
        return Contacts(*(array[which] for array in vars(self).values()))


def find_contacts(
    T_world_gripper: np.ndarray,
    opening_m: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    certainty: np.ndarray,
    *,
    gripper: Gripper,
    friction: float,
) -> Contacts:
    """Close the jaws on surface samples.

    Args:
        T_world_gripper: (p, 4, 4).
        opening_m: (p,) m.
        points: (n, 3) m, world frame.
        normals: (n, 3) outward.
        certainty: (n,) how certain the points are to be real, 0 to 1.
        gripper: Has the extent of the pads.
        friction: Coulomb coefficient.
    """
    near = _between_pads(T_world_gripper, opening_m, points, gripper)
    low, high = near.extreme(np.minimum), near.extreme(np.maximum)
    closing = T_world_gripper[:, :3, 1]
    facing = np.einsum("ki,ki->k", closing[near.pose], normals[near.point])
    sides = [
        _Patch(near.take((near.local[:, 1] >= high[near.pose] - _TOUCH_M) & (facing > 0)), normals, certainty),
        _Patch(near.take((near.local[:, 1] <= low[near.pose] + _TOUCH_M) & (facing < 0)), normals, certainty),
    ]
    squareness = np.minimum(_cosine(sides[0].normal, closing), _cosine(sides[1].normal, -closing))
    certainty = (sides[0].certainty + sides[1].certainty) / 2
    both = np.stack([side.levers_m(friction * (high - low), friction) for side in sides])
    smaller = np.argmin(np.trace(both, axis1=2, axis2=3), axis=0)
    levers = both[smaller, np.arange(len(closing))]
    missed = ~(np.isfinite(low) & np.isfinite(high) & np.isfinite(squareness))
    for array in (low, high, squareness, certainty, levers):
        array[missed] = np.nan
    return Contacts(low, high, squareness, certainty, levers)


@dataclass(frozen=True, eq=False)
class _Near:
    """Pairs of a pose and a point between its pads, by pose.

    Attributes:
        num_poses: p, the number of poses, those without a pair among them.
        pose: (k,) numbers, ascending.
        point: (k,) numbers.
        local: (k, 3) m, in the pose's frame.
    """

    num_poses: int
    pose: np.ndarray
    point: np.ndarray
    local: np.ndarray

    def take(self, which: np.ndarray) -> _Near:
        return _Near(self.num_poses, self.pose[which], self.point[which], self.local[which])

    def extreme(self, largest_or_least: np.ufunc) -> np.ndarray:
        """Largest or least y, m, for each pose (p,); NaN where nothing is between its pads."""
        found = np.full(self.num_poses, np.nan)
        if len(self.pose):
            starts = np.flatnonzero(np.diff(self.pose, prepend=-1))
            found[self.pose[starts]] = largest_or_least.reduceat(self.local[:, 1], starts)
        return found

    def means(self, rows: np.ndarray) -> np.ndarray:
        """Means of rows (k, c) for each pose (p, c); NaN where it has none."""
        counts = np.bincount(self.pose, minlength=self.num_poses)[:, None]
        sums = np.stack([np.bincount(self.pose, column, minlength=self.num_poses) for column in rows.T], axis=1)
        return np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)


def _between_pads(T: np.ndarray, opening_m: np.ndarray, points: np.ndarray, gripper: Gripper) -> _Near:
    """Points that closing jaws sweep; most are ruled out by their place along the pad, in single precision."""
    low, high = gripper.pad.low_high
    step = max(1, _CHUNK // max(len(points), 1))
    single = points.astype(np.float32).T
    found = []
    for begin in range(0, len(T), step):
        some = T[begin : begin + step]
        on_pad = np.ones((len(some), len(points)), dtype=bool)
        for axis in (0, 2):
            along = some[:, :3, axis].astype(np.float32) @ single
            origin = np.einsum("pi,pi->p", some[:, :3, axis], some[:, :3, 3])
            on_pad &= along >= (origin + low[axis])[:, None].astype(np.float32)
            on_pad &= along <= (origin + high[axis])[:, None].astype(np.float32)
        pose, point = np.nonzero(on_pad)
        found.append((pose + begin, point))
    pose, point = (np.concatenate(numbers) for numbers in zip(*found, strict=True)) if found else _NONE
    local = np.einsum("kij,ki->kj", T[pose, :3, :3], points[point] - T[pose, :3, 3])
    return _Near(len(T), pose, point, local).take(np.abs(local[:, 1]) < opening_m[pose] / 2)


class _Patch:
    """Means over the points that one pad touches, for p poses; NaN where it touches none.

    Attributes:
        normal: (p, 3) mean normal, not of unit length.
        certainty: (p,) mean certainty of the points.
        covariance: (p, 2, 2) m^2 of the points along the pad's x and z.
    """

    def __init__(self, touched: _Near, normals: np.ndarray, certainty: np.ndarray) -> None:
        x, z = touched.local[:, 0], touched.local[:, 2]
        self.normal = touched.means(normals[touched.point])
        self.certainty = touched.means(certainty[touched.point, None])[:, 0]
        mean_x, mean_z, xx, xz, zz = touched.means(np.stack([x, z, x * x, x * z, z * z], axis=1)).T
        xx, xz, zz = np.maximum(xx - mean_x**2, 0.0), xz - mean_x * mean_z, np.maximum(zz - mean_z**2, 0.0)
        self.covariance = np.stack([xx, xz, xz, zz], axis=1).reshape(-1, 2, 2)

    def levers_m(self, across_m: np.ndarray, friction: float) -> np.ndarray:
        """Levers (p, 3, 3) m against turns, for a unit force on a patch of uniform pressure; see `Contacts`.

        A turn about x or z is resisted by friction on both pads, across_m apart, and by the pressure, which moves over
        the patch: not at all about the patch's own line where it is one, however that lies on the pad. A turn about
        the closing axis y is resisted by the friction of the twisting patch alone.
        """
        extent = np.sqrt(12.0) * _root(self.covariance)
        levers = np.zeros((len(across_m), 3, 3))
        levers[:, 0, 0] = across_m + extent[:, 1, 1]
        levers[:, 0, 2] = levers[:, 2, 0] = -extent[:, 0, 1]
        levers[:, 2, 2] = across_m + extent[:, 0, 0]
        levers[:, 1, 1] = 2.0 * friction * np.sqrt(np.trace(self.covariance, axis1=1, axis2=2))
        return levers


def _root(matrices: np.ndarray) -> np.ndarray:
    """Square roots (p, 2, 2) of symmetric matrices without negative eigenvalues; NaN where these are."""
    trace = np.trace(matrices, axis1=1, axis2=2)
    product = matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] ** 2
    root = np.sqrt(np.maximum(product, 0.0))
    scale = np.sqrt(trace + 2.0 * root)
    return (matrices + root[:, None, None] * np.eye(2)) / np.maximum(scale, 1e-12)[:, None, None]


def _cosine(vectors: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Cosine (p,) between vectors (p, 3) and unit axes (p, 3); NaN where there is no vector."""
    return np.einsum("pi,pi->p", vectors, axes) / np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)


_NUM_SWAYS = 8  # directions around
_LEAST_LEVER_M = 1e-4


def load_ratio(
    T_world_gripper: np.ndarray,
    levers_m: np.ndarray,
    centre: np.ndarray,
    up: np.ndarray,
    *,
    friction: float,
    sway: float,
) -> np.ndarray:
    """The load that a grasp holds, over what its jaws hold of a weight that hangs between them.

    The pads' limit surface is taken for an ellipsoid (Howe and Cutkosky 1996, "Practical force-motion models for
    sliding manipulation"): a force f across the closing axis and a torque t slip once (f / (2 mu N))^2 +
    |levers^-1 t / N|^2 is 1, N the grip force. The jaws' own strength bears a force along the closing axis. The pull is
    gravity with a sway to each of eight sides; the worst of the eight counts.

    Args:
        T_world_gripper: (p, 4, 4), m.
        levers_m: (p, 3, 3) m, levers of the pads against turns, see `Contacts`.
        centre: (3,) m, the object's centre of mass.
        up: (3,) unit, against gravity.
        friction: Coulomb coefficient mu.
        sway: Sideways acceleration, as a share of gravity.

    Returns:
        (p,) from 0 to 1; NaN where the levers are.
    """
    R = T_world_gripper[:, :3, :3]
    arm = np.einsum("pji,pj->pi", R, centre - T_world_gripper[:, :3, 3])
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side /= np.linalg.norm(side)
    turns = 2.0 * np.pi * np.arange(_NUM_SWAYS) / _NUM_SWAYS
    sways = np.cos(turns)[:, None] * side + np.sin(turns)[:, None] * np.cross(up, side)
    pull = np.einsum("pji,kj->pki", R, sway * sways - up)
    torque = np.cross(arm[:, None], pull)
    slide = pull[..., 0] ** 2 + pull[..., 2] ** 2
    missing = np.isnan(levers_m)
    lengths, axes = np.linalg.eigh(np.where(missing, 0.0, levers_m))
    turn = (2.0 * friction * (torque @ axes) / np.maximum(lengths, _LEAST_LEVER_M)[:, None]) ** 2
    needed = np.sqrt(slide + turn.sum(axis=2)).max(axis=1)
    needed[missing.any(axis=(1, 2))] = np.nan
    return 1.0 / np.maximum(needed, 1.0)
