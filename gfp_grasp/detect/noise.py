"""Noise of the sensor, read off the cloud itself."""

from __future__ import annotations

import numpy as np

from gfp_grasp.clouds import local_axes
from gfp_grasp.types import TABLETOP, SensorProfile

_NEIGHBOURS = 16
_SAMPLE = 400


def estimate_sigma(
    points: np.ndarray, viewpoint: np.ndarray | None = None, *, sensor: SensorProfile = TABLETOP
) -> float:
    """Standard deviation of the depth noise, m, from the residuals of small planes.

    The median over neighbourhoods of 16 points, so that edges and flying pixels do not count. Residuals are taken
    along the ray to the viewpoint where that is known, else along the local normal. Noise that neighbouring pixels
    share does not show here: the figure is a lower bound for such sensors.

    Args:
        points: (n, 3) m.
        viewpoint: (3,) m.
        sensor: What noise is believed.

    Returns:
        Within the sensor's `sigma_range_m`: between 0.5 and 6 mm for depth cameras over a table.
    """
    least_m, most_m = sensor.sigma_range_m
    if len(points) < 2 * _NEIGHBOURS:
        return least_m
    chosen = points[:: -(-len(points) // _SAMPLE)]
    variance, axes = local_axes(points, chosen, num_neighbours=_NEIGHBOURS)
    # Three degrees of freedom go into the plane.
    residual = np.sqrt(np.maximum(variance[:, 0], 0.0) / (_NEIGHBOURS - 3))
    if viewpoint is not None:
        rays = chosen - viewpoint
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        residual = residual / np.maximum(np.abs(np.einsum("ni,ni->n", rays, axes[:, :, 0])), 0.3)
    return float(np.clip(np.median(residual), least_m, most_m))
