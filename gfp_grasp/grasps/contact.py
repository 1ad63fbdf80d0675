"""Where the pads touch: the patches on either side, how squarely they are met and how real they are."""

from dataclasses import dataclass

import numpy as np

from gfp_grasp.grasps.clearance import in_gripper_frame
from gfp_grasp.grasps.gripper import Gripper

# Surface this close to the first touch counts as touched: pads and real surfaces give way by about as much.
_TOUCH_M = 1e-3


@dataclass(frozen=True, eq=False)
class Contacts:
    """Contact of p grasps.

    Attributes:
        low_m: (p,) where the jaw at -y first touches, along y from the grasp's origin; NaN where nothing is between.
        high_m: (p,) the same for the jaw at +y.
        squareness: (p,) cosine between closing axis and mean normal, the worse of both patches.
        realness: (p,) mean over both patches of the points' odds of being where they seem.
    """

    low_m: np.ndarray
    high_m: np.ndarray
    squareness: np.ndarray
    realness: np.ndarray


def find_contacts(
    T_world_gripper: np.ndarray,
    opening_m: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    odds: np.ndarray,
    *,
    gripper: Gripper,
) -> Contacts:
    """Close the jaws on surface samples.

    Args:
        T_world_gripper: (p, 4, 4).
        opening_m: (p,) m.
        points: (n, 3) m, world frame.
        normals: (n, 3) outward.
        odds: (n,) of being real, 0 to 1.
        gripper: For the extent of its pads.
    """
    count = len(T_world_gripper)
    low, high, squareness, realness = (np.full(count, np.nan) for _ in range(4))
    (x0, _, z0), (x1, _, z1) = gripper.pad.low_high
    for some, local in in_gripper_frame(T_world_gripper, points):
        x, y, z = local[..., 0], local[..., 1], local[..., 2]
        between = (x >= x0) & (x <= x1) & (z >= z0) & (z <= z1) & (np.abs(y) < opening_m[some, None] / 2)
        top = np.where(between, y, -np.inf).max(axis=1)
        bottom = np.where(between, y, np.inf).min(axis=1)
        facing = T_world_gripper[some, :3, 1].astype(np.float32) @ normals.T.astype(np.float32)
        touch_top = between & (y >= top[:, None] - _TOUCH_M) & (facing > 0)
        touch_bottom = between & (y <= bottom[:, None] + _TOUCH_M) & (facing < 0)
        closing = T_world_gripper[some, :3, 1]
        squareness[some] = np.minimum(
            _cosine(_mean(normals, touch_top), closing), _cosine(_mean(normals, touch_bottom), -closing)
        )
        realness[some] = (_mean(odds[:, None], touch_top) + _mean(odds[:, None], touch_bottom))[:, 0] / 2
        low[some], high[some] = bottom, top
    found = np.isfinite(low) & np.isfinite(high) & np.isfinite(squareness)
    return Contacts(*(np.where(found, array, np.nan) for array in (low, high, squareness, realness)))


def _mean(values: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Mean (p, c) of (n, c) values under a (p, n) mask; NaN where it is empty."""
    pose, point = np.nonzero(mask)  # few points touch, so they are summed one by one
    sums = np.stack([np.bincount(pose, column, minlength=len(mask)) for column in values[point].T], axis=1)
    counts = np.bincount(pose, minlength=len(mask))[:, None]
    return np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)


def _cosine(vectors: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Cosine (p,) between vectors (p, 3) and unit axes (p, 3); NaN where there is no vector."""
    return np.einsum("pi,pi->p", vectors, axes) / np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
