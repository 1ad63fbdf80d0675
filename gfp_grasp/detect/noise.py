"""Noise of the sensor, read off the cloud itself."""

from __future__ import annotations

import numpy as np

from gfp_grasp.clouds import local_axes

LEAST_M, MOST_M = 0.0005, 0.006  # what depth cameras at arm's length show
_NEIGHBOURS = 16
_SAMPLE = 400


def estimate_sigma(points: np.ndarray, viewpoint: np.ndarray | None = None) -> float:
    """Standard deviation of the depth noise, m, from the residuals of small planes.

    The median over neighbourhoods of 16 points, so that edges and flying pixels do not count. Residuals are taken
    along the ray to the viewpoint where that is known, else along the local normal. Noise that neighbouring pixels
    share does not show here: the figure is a lower bound for such sensors.

    Args:
        points: (n, 3) m.
        viewpoint: (3,) m.

    Returns:
        Between 0.5 and 6 mm.
    """
    if len(points) < 2 * _NEIGHBOURS:
        return LEAST_M
    chosen = points[:: -(-len(points) // _SAMPLE)]
    variance, axes = local_axes(points, chosen, num_neighbours=_NEIGHBOURS)
    # Three degrees of freedom go into the plane.
    residual = np.sqrt(np.maximum(variance[:, 0], 0.0) / (_NEIGHBOURS - 3))
    if viewpoint is not None:
        rays = chosen - viewpoint
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        residual = residual / np.maximum(np.abs(np.einsum("ni,ni->n", rays, axes[:, :, 0])), 0.3)
    return float(np.clip(np.median(residual), LEAST_M, MOST_M))
