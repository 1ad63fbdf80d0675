"""The cube that a peer sees an object in, in either way: around what was seen, or around the true box.

Within it lengths are in sides of the cube, and the origin is its middle: from -0.5 to 0.5 along each axis.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.clouds import thin
from gfp_grasp.level import level_frame
from gfp_grasp.transforms import apply_T, invert_T, make_T
from gfp_grasp.types import OrientedBox, PointCloud

# The cube around what was seen is so many times as long as the longest side of its upright box; its face towards the
# viewer lies this share of that side before the nearest points, so that the room that is left is behind.
_ENLARGED = 1.5
_IN_FRONT = 0.125
# The cube around the true box is so many times as long as the box's longest side: surfaces stay clear of its faces.
_ENLARGED_TRUE = 1.1
_OUTLIERS = 0.005  # share of the points, at either end, that the box leaves out
_NUM_POINTS = 3000  # points that a peer looks at
_NEIGHBOUR = 8  # A point is astray whose distance to this neighbour is
_ASTRAY = 3.0  # so many times the median's, as with pixels that fly off an edge.
_LEAST_M = 1e-6


@dataclass(frozen=True, eq=False)
class Cube:
    """A cube in the world.

    Attributes:
        T_world_cube: (4, 4), origin in its middle.
        side_m: Length of its edges.
    """

    T_world_cube: np.ndarray
    side_m: float

    def inward(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) m of the world in sides of the cube."""
        return apply_T(invert_T(self.T_world_cube), points) / self.side_m

    def outward(self, points: np.ndarray) -> np.ndarray:
        """Points (n, 3) in sides of the cube, in the world, m."""
        return apply_T(self.T_world_cube, self.side_m * points)


def tidied(cloud: PointCloud) -> PointCloud:
    """A cloud thinned to about 3000 points, without those that are astray; it is what both ways look at."""
    points = thin(cloud.points, _NUM_POINTS)
    if len(points) <= _NEIGHBOUR:
        return PointCloud(points, cloud.viewpoint)
    away = KDTree(points).query(points, k=_NEIGHBOUR + 1)[0][:, -1]
    return PointCloud(points[away <= _ASTRAY * np.median(away)], cloud.viewpoint)


def cube_of_seen(cloud: PointCloud, up: np.ndarray) -> Cube:
    """The cube that a user has: z along up, x towards the viewer, around the upright box of the observed points.

    Without a viewpoint x is the level direction in which the points are spread least, and the box is in the middle.
    What an occluder hides may reach out of the cube; then grids cut it off.

    Args:
        cloud: Points that are `tidied`, world frame.
        up: (3,), the support's normal.
    """
    T = level_frame(cloud.points, up, cloud.viewpoint)
    level = apply_T(invert_T(T), cloud.points)
    low, high = np.quantile(level, [_OUTLIERS, 1 - _OUTLIERS], axis=0)
    longest = max(float((high - low).max()), _LEAST_M)
    side, middle = _ENLARGED * longest, (low + high) / 2
    if cloud.viewpoint is not None:
        middle[0] = high[0] + _IN_FRONT * longest - side / 2
    return Cube(make_T(T[:3, :3], apply_T(T, middle[None])[0]), side)


def cube_of_box(box: OrientedBox) -> Cube:
    """The cube around a true box, along the box's axes."""
    return Cube(box.T_world_box, max(_ENLARGED_TRUE * float(box.extents.max()), _LEAST_M))


def true_box(mesh: trimesh.Trimesh, T_world_object: np.ndarray) -> OrientedBox:
    """The box of a true mesh, in the object's frame, along the object's axes, at its pose (4, 4)."""
    low, high = np.asarray(mesh.bounds)
    return OrientedBox(T_world_object @ make_T(None, (low + high) / 2), high - low)
