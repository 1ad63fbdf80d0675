"""Plane curves that bodies are turned of: rounded polylines, insets, smooth noise, thinning.

A profile is (m, 2) of radius and height in metres, from the axis at the bottom, up and outside, to the axis again.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline


def smooth_noise(rng: np.random.Generator, t: np.ndarray, *, amplitude: float, knots: int) -> np.ndarray:
    """Smooth random curve (n,) over t in 0 .. 1, a natural cubic spline through normal values at even knots."""
    values = rng.normal(0.0, amplitude, knots)
    return CubicSpline(np.linspace(0, 1, knots), values, bc_type="natural")(t)


def smoothstep(t: np.ndarray) -> np.ndarray:
    """0 to 1 with level ends; t is clipped to 0 .. 1."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3 - 2 * t)


def rounded(corners: np.ndarray | list, radii: np.ndarray | list, *, steps: int = 6) -> np.ndarray:
    """Polyline (n, 2) with its inner corners replaced by arcs.

    Args:
        corners: (m, 2) m.
        radii: (m,) m, wanted radius at each corner; limited by what the neighbouring edges leave. The ends stay.
        steps: Points of an arc.
    """
    corners = np.asarray(corners, dtype=np.float64)
    points = [corners[:1]]
    for i in range(1, len(corners) - 1):
        here, back, ahead = corners[i], corners[i - 1] - corners[i], corners[i + 1] - corners[i]
        room = 0.49 * min(np.linalg.norm(back), np.linalg.norm(ahead))
        if radii[i] <= 0 or room < 1e-6:
            points.append(here[None])
            continue
        back, ahead = back / np.linalg.norm(back), ahead / np.linalg.norm(ahead)
        half = np.arccos(np.clip(back @ ahead, -1, 1)) / 2
        cut = min(radii[i] / max(np.tan(half), 1e-6), room)
        t = np.linspace(0, 1, steps)[:, None]
        # A quadratic Bezier arc: within a few per cent of the circle, and it cannot overshoot.
        points.append((1 - t) ** 2 * (here + cut * back) + 2 * t * (1 - t) * here + t**2 * (here + cut * ahead))
    return np.concatenate([*points, corners[-1:]])


def inset(radius: np.ndarray, height: np.ndarray, wall_m: float) -> np.ndarray:
    """Radius (n,) of the curve at a distance of wall_m inside radius(height): erosion by a disc.

    Args:
        radius: (n,) m over rising heights; beyond the ends it goes on as it ended.
        height: (n,) m, rising.
        wall_m: Distance, m.
    """
    steps = np.linspace(-1, 1, 33)
    shifted = np.interp(height[:, None] + wall_m * steps[None], height, radius)
    return (shifted - wall_m * np.sqrt(1 - steps**2)[None]).min(axis=1)


def thinned(points: np.ndarray, *, tolerance: float, longest: float) -> np.ndarray:
    """Indices of the points that keep a polyline within a tolerance (Douglas-Peucker), no two further than `longest`.

    Args:
        points: (n, d) m.
        tolerance: m.
        longest: m.

    Returns:
        (k,) int, rising, with both ends.
    """
    keep = np.zeros(len(points), dtype=bool)
    keep[[0, -1]] = True
    stack = [(0, len(points) - 1)]
    while stack:
        first, last = stack.pop()
        if last - first < 2:
            continue
        chord, inner = points[last] - points[first], points[first + 1 : last] - points[first]
        t = np.clip(inner @ chord / max(chord @ chord, 1e-18), 0, 1)
        distance = np.linalg.norm(inner - t[:, None] * chord, axis=1)
        far = int(distance.argmax()) + 1
        if distance[far - 1] <= tolerance:
            if np.linalg.norm(chord) <= longest:
                continue
            far = (last - first) // 2
        keep[first + far] = True
        stack += [(first, first + far), (first + far, last)]
    return np.flatnonzero(keep)
