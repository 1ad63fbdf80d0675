"""Generic Fitted Shapes: a primitive as an active contour that is drawn onto points along its normals.

The internal energy is that of the displacement from the fitted shape, elastic and bending, not of the shape itself:
rims and thin walls are sharp and must stay so. The external energy pulls each vertex along
its normal to the nearest point whose normal agrees. One step is semi-implicit (Kass, Witkin and Terzopoulos, "Snakes:
Active contour models", IJCV 1988, eq. 19-20). Source of the method: Cocias et al., "Generic Fitted Shapes (GFS)",
Robotics and Autonomous Systems 2013.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import factorized
from scipy.spatial import KDTree

from gfp_grasp.errors import InvalidOption
from gfp_grasp.meshes import graph_laplacian, vertex_normals

_MIN_NORMAL_COSINE = 0.5
# Opposite walls are kept apart: a difference of normals of one unit counts like this distance, in patch units.
_NORMAL_LENGTH = 0.5


@dataclass(frozen=True)
class SnakeConfig:
    """How stiff the contour is and how far it looks.

    Attributes:
        steps: Semi-implicit steps.
        elastic: Weight of the first-order internal energy.
        bending: Weight of the second-order internal energy.
        pull: Weight of the external energy.
        reach: A vertex with no agreeing point within this is not pulled; in units of `patch_unit_m`.
        tangential: Share of the pull that acts along the surface too.
        smooth: How many nearest points draw a vertex, by their mean.
    """

    steps: int = 12
    elastic: float = 0.3
    bending: float = 0.3
    pull: float = 1.0
    reach: float = 0.5
    tangential: float = 0.0
    smooth: int = 4

    def __post_init__(self) -> None:
        if self.steps < 1 or self.smooth < 1:
            raise InvalidOption(f"steps is {self.steps}, smooth is {self.smooth}; both must be at least 1")
        if min(self.elastic, self.bending, self.pull) < 0 or self.reach <= 0:
            raise InvalidOption("elastic, bending and pull must not be negative; reach must be positive")


def evolve(
    vertices: np.ndarray,
    faces: np.ndarray,
    points: np.ndarray,
    normals: np.ndarray,
    *,
    unit_m: float,
    config: SnakeConfig = SnakeConfig(),
) -> np.ndarray:
    """Draw a mesh onto points.

    Args:
        vertices: (v, 3) m, the fitted shape.
        faces: (f, 3).
        points: (n, 3) m, same frame.
        normals: (n, 3) unit, outward.
        unit_m: The primitive's `patch_unit_m`.
        config: Energies.

    Returns:
        (v, 3) m, the evolved vertices; vertices that nothing pulls follow their neighbours.
    """
    if len(points) == 0:
        return vertices.copy()
    L = graph_laplacian(faces, len(vertices))
    solve = factorized(sparse.csc_matrix(sparse.eye(len(vertices)) + config.elastic * L + config.bending * (L.T @ L)))
    normal_length_m = _NORMAL_LENGTH * unit_m
    tree = KDTree(np.hstack([points, normal_length_m * normals]))
    count = min(config.smooth, len(points))
    displacement = np.zeros_like(vertices)
    for _ in range(config.steps):
        moved = vertices + displacement
        facing = vertex_normals(moved, faces)
        _, near = tree.query(np.hstack([moved, normal_length_m * facing]), k=count)
        near = np.reshape(near, (len(moved), count))
        agrees = np.einsum("vi,vki->vk", facing, normals[near]) > _MIN_NORMAL_COSINE
        gap = points[near] - moved[:, None]
        agrees &= np.linalg.norm(gap, axis=2) < config.reach * unit_m
        weight = agrees / np.maximum(agrees.sum(axis=1, keepdims=True), 1)
        # Point to plane: the height of the vertex over the plane of each of its points.
        height = np.einsum("vki,vki,vk->v", gap, normals[near], weight)
        force = height[:, None] * facing
        if config.tangential:
            force = force + config.tangential * np.einsum("vki,vk->vi", gap, weight)
        displacement = np.column_stack([solve(column) for column in (displacement + config.pull * force).T])
    return vertices + displacement
