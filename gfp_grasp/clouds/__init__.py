"""Bare points: their order, thinning, and normals."""

from gfp_grasp.clouds.normals import estimate_normals, local_axes
from gfp_grasp.clouds.ordering import MAX_POINTS, distinct_points, order_points
from gfp_grasp.clouds.thinning import thin, thin_index, voxel_grid

__all__ = [
    "MAX_POINTS",
    "distinct_points",
    "estimate_normals",
    "local_axes",
    "order_points",
    "thin",
    "thin_index",
    "voxel_grid",
]
