"""The smallest upright box around points."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from gfp_grasp.transforms import make_T, rotation_between
from gfp_grasp.types import OrientedBox


def upright_box(points: np.ndarray, up: np.ndarray) -> OrientedBox:
    """Box with its z along up and the smallest ground area, around all of (n, 3) points, m.

    Its x runs along the longer ground side.
    """
    R = rotation_between(up, (0.0, 0.0, 1.0))
    level = points @ R.T
    axes, low, high = smallest_rectangle(level[:, :2])
    z = np.array([level[:, 2].min(), level[:, 2].max()])
    centre = np.append(axes.T @ ((low + high) / 2), z.mean())
    turn = np.eye(3)
    turn[:2, :2] = axes.T
    return OrientedBox(make_T(R.T @ turn, R.T @ centre), np.append(high - low, z[1] - z[0]))


def smallest_rectangle(ground: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rectangle of smallest area around (n, 2) points; one of its sides lies along an edge of their hull.

    Returns:
        axes (2, 2), a right-handed pair of rows, the longer side first; low (2,) and high (2,) along them.
    """
    try:
        corners = ground[ConvexHull(ground).vertices]
    except QhullError:  # a line or a point: the axes of its spread
        corners = ground
        edges = np.linalg.svd(ground - ground.mean(axis=0), full_matrices=False)[2][:1]
    else:
        edges = np.roll(corners, -1, axis=0) - corners
    edges = edges / np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), 1e-12)
    frames = np.stack([edges, np.column_stack([-edges[:, 1], edges[:, 0]])], axis=1)
    along = np.einsum("fij,nj->fin", frames, corners)
    low, high = along.min(axis=2), along.max(axis=2)
    best = int(np.argmin(np.prod(high - low, axis=1)))
    axes, low, high = frames[best], low[best], high[best]
    if high[0] - low[0] >= high[1] - low[1]:
        return axes, low, high
    # A quarter turn: the second axis becomes the first, and the first, reversed, the second.
    return np.stack([axes[1], -axes[0]]), np.array([low[1], -high[0]]), np.array([high[1], -low[0]])
