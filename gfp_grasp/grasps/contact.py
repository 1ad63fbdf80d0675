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
        lever_m: (p,) shortest lever with which the pads resist a turn about any axis, for a unit of grip force.
    """

    low_m: np.ndarray
    high_m: np.ndarray
    squareness: np.ndarray
    realness: np.ndarray
    lever_m: np.ndarray


def find_contacts(
    T_world_gripper: np.ndarray,
    opening_m: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    odds: np.ndarray,
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
        odds: (n,) of being real, 0 to 1.
        gripper: For the extent of its pads.
        friction: Coulomb coefficient.
    """
    count = len(T_world_gripper)
    low, high, squareness, realness, lever = (np.full(count, np.nan) for _ in range(5))
    (x0, _, z0), (x1, _, z1) = gripper.pad.low_high
    for some, local in in_gripper_frame(T_world_gripper, points):
        x, y, z = local[..., 0], local[..., 1], local[..., 2]
        between = (x >= x0) & (x <= x1) & (z >= z0) & (z <= z1) & (np.abs(y) < opening_m[some, None] / 2)
        high[some] = np.where(between, y, -np.inf).max(axis=1)
        low[some] = np.where(between, y, np.inf).min(axis=1)
        closing = T_world_gripper[some, :3, 1]
        facing = closing.astype(np.float32) @ normals.T.astype(np.float32)
        sides = [
            _Patch(between & (y >= high[some, None] - _TOUCH_M) & (facing > 0), local, normals, odds),
            _Patch(between & (y <= low[some, None] + _TOUCH_M) & (facing < 0), local, normals, odds),
        ]
        squareness[some] = np.minimum(_cosine(sides[0].normal, closing), _cosine(sides[1].normal, -closing))
        realness[some] = (sides[0].odds + sides[1].odds) / 2
        across = friction * (high[some] - low[some])
        lever[some] = np.min([side.levers_m(across, friction) for side in sides], axis=(0, 1))
    found = np.isfinite(low) & np.isfinite(high) & np.isfinite(squareness)
    return Contacts(*(np.where(found, array, np.nan) for array in (low, high, squareness, realness, lever)))


class _Patch:
    """Means over the points that one pad touches, for p poses; NaN where it touches none.

    Attributes:
        normal: (p, 3) mean normal, not of unit length.
        odds: (p,) mean odds of being real.
        variance: (p, 2) m^2 of the points along the pad's x and z.
    """

    def __init__(self, touched: np.ndarray, local: np.ndarray, normals: np.ndarray, odds: np.ndarray) -> None:
        pose, point = np.nonzero(touched)  # few points touch, so they are summed one by one
        counts = np.bincount(pose, minlength=len(touched))

        def mean(columns: np.ndarray) -> np.ndarray:
            sums = np.stack([np.bincount(pose, column, minlength=len(touched)) for column in columns.T], axis=1)
            return np.divide(sums, counts[:, None], out=np.full(sums.shape, np.nan), where=counts[:, None] > 0)

        on_pad = local[pose, point][:, [0, 2]].astype(np.float64)
        self.normal = mean(normals[point])
        self.odds = mean(odds[point, None])[:, 0]
        self.variance = np.maximum(mean(on_pad**2) - mean(on_pad) ** 2, 0.0)

    def levers_m(self, across_m: np.ndarray, friction: float) -> np.ndarray:
        """Levers (3, p) m against turns about x, z and y, of a unit force on a patch of uniform pressure.

        A turn about x or z is resisted by friction on both pads, across_m apart, and by the pressure's moving over the
        patch; one about the closing axis y by the patch's twisting alone.
        """
        extent = np.sqrt(12.0 * self.variance)
        about_y = 2.0 * friction * np.sqrt(self.variance.sum(axis=1))
        return np.stack([across_m + extent[:, 1], across_m + extent[:, 0], about_y])


def _cosine(vectors: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Cosine (p,) between vectors (p, 3) and unit axes (p, 3); NaN where there is no vector."""
    return np.einsum("pi,pi->p", vectors, axes) / np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)
