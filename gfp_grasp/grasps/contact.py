"""Where the pads touch: the patches on either side, how squarely they are met and how certain they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gfp_grasp.grasps.gripper import Gripper

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
        levers_m: (p, 3) m with which the pads resist a turn about the gripper's x, y and z, for a unit of grip force;
            the smaller of what the two pads have.
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
    levers = np.minimum(*(side.levers_m(friction * (high - low), friction) for side in sides))
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
        variance: (p, 2) m^2 of the points along the pad's x and z.
    """

    def __init__(self, touched: _Near, normals: np.ndarray, certainty: np.ndarray) -> None:
        on_pad = touched.local[:, [0, 2]]
        self.normal = touched.means(normals[touched.point])
        self.certainty = touched.means(certainty[touched.point, None])[:, 0]
        self.variance = np.maximum(touched.means(on_pad**2) - touched.means(on_pad) ** 2, 0.0)

    def levers_m(self, across_m: np.ndarray, friction: float) -> np.ndarray:
        """Levers (p, 3) m against turns about x, y and z, for a unit force on a patch of uniform pressure.

        A turn about x or z is resisted by friction on both pads, across_m apart, and by the pressure, which moves over
        the patch; a turn about the closing axis y is resisted by the friction of the twisting patch alone.
        """
        extent = np.sqrt(12.0 * self.variance)
        about_y = 2.0 * friction * np.sqrt(self.variance.sum(axis=1))
        return np.stack([across_m + extent[:, 1], about_y, across_m + extent[:, 0]], axis=1)


def _cosine(vectors: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Cosine (p,) between vectors (p, 3) and unit axes (p, 3); NaN where there is no vector."""
    return np.einsum("pi,pi->p", vectors, axes) / np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
