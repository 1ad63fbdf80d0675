"""Bowls: for soup, cereal, salad, dips and dough; round, oval and square, on a foot ring or flat."""

from __future__ import annotations

import numpy as np

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import smooth_noise, smoothstep
from gfp_grasp.shapes.vessel import Vessel

_GRID = 300
# Rings of the underside, the foot, the side, the rim, the inside and the floor.
_COUNTS = (10, 4, 34, 6, 32, 10)
_SEGMENTS = 56
_KINDS = {"soup": 0.22, "cereal": 0.26, "salad": 0.16, "mixing": 0.14, "dip": 0.08, "footed": 0.06, "square": 0.08}
_HALF_M = {
    "soup": (0.065, 0.115), "cereal": (0.058, 0.088), "salad": (0.095, 0.16), "mixing": (0.075, 0.16),
    "dip": (0.032, 0.055), "footed": (0.055, 0.14), "square": (0.06, 0.13),
}  # fmt: skip
# Height over greatest half-width.
_DEPTH = {"soup": (0.35, 0.9), "mixing": (0.7, 1.2), "salad": (0.45, 1.05), "dip": (0.4, 1.2)}


def _make(rng: np.random.Generator) -> Made:
    kind = draw_kind(rng, _KINDS)
    half = rng.uniform(*_HALF_M[kind])
    tall = half * rng.uniform(*_DEPTH.get(kind, (0.5, 1.05)))
    foot = rng.choice([0.001, rng.uniform(0.002, 0.009)])
    if kind == "footed":
        foot = min(rng.uniform(0.01, 0.035), 0.28 * tall)
    height = np.concatenate([np.linspace(0, foot, 24)[:-1], foot + (tall - foot) * np.linspace(0, 1, _GRID) ** 1.8])
    standing = rng.uniform(0.25, 0.42) if kind == "footed" else rng.uniform(0.28, 0.72)
    radius = half * _side(rng, np.clip((height - foot) / (tall - foot), 0, 1), standing)
    radius = radius - _foot_waist(rng, height, foot, radius[0])
    wall = float(np.exp(rng.uniform(np.log(0.0012), np.log(0.006))))
    extra = _lip(rng, height) if rng.random() < 0.3 else np.zeros(len(height))
    power = rng.uniform(3.0, 6.0) if kind == "square" else 2.0
    aspect = rng.uniform(0.65, 0.95) if rng.random() < 0.1 else 1.0
    flutes = (int(rng.integers(8, 25)), rng.uniform(0.004, 0.018)) if rng.random() < 0.06 else (0, 0.0)
    dent = rng.uniform(0.3, 0.8) * foot
    floor = dent + wall * rng.uniform(1.25, 2.2) + (foot - dent if kind == "footed" else 0.0)
    vessel = Vessel(height, radius, wall, floor, extra, aspect, power, dent, flutes, _SEGMENTS)
    return Made(vessel.matched_mesh(_COUNTS, breaks_m=(foot,)), kind, wall)


def _side(rng: np.random.Generator, t: np.ndarray, standing: float) -> np.ndarray:
    """Relative radius (n,) over t in 0 .. 1 above the foot, from `standing` to 1: conical, round or steep."""
    p, q = rng.choice([rng.uniform(1.0, 1.4), rng.uniform(1.6, 2.6)]), rng.uniform(1.0, 2.4)
    rise = (1 - (1 - t) ** p) ** (1 / q)
    if rng.random() < 0.2:
        # Almost flat underneath, then steep.
        rise = 0.8 * (1 - (1 - np.clip(t / rng.uniform(0.15, 0.4), 0, 1)) ** 2) ** 0.5 + 0.2 * t
    curve = standing + (1 - standing) * rise
    if rng.random() < 0.3:
        curve = curve + rng.uniform(0.03, 0.2) * smoothstep((t - rng.uniform(0.65, 0.85)) / 0.3)
    elif rng.random() < 0.2:
        curve = curve - rng.uniform(0.02, 0.12) * t**4
    curve = curve + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.008]), knots=5)
    return curve / curve.max()


def _foot_waist(rng: np.random.Generator, height: np.ndarray, foot: float, standing: float) -> np.ndarray:
    """What the side of the foot ring lies behind its upper and lower edge, (n,) m."""
    within = np.clip(height / foot, 0, 1)
    depth = rng.uniform(0.05, 0.4) * min(foot, 0.06 * standing)
    return depth * np.sin(np.pi * within) + 0.3 * min(foot, 0.003) * (1 - np.sqrt(within)) ** 2


def _lip(rng: np.random.Generator, height: np.ndarray) -> np.ndarray:
    """A rolled edge outside of the rim, (n,) m."""
    size, reach = rng.uniform(0.0006, 0.004), rng.uniform(0.002, 0.006)
    return size * (1 - smoothstep(((height[-1] - height) / reach - 1) * 2))


BOWL = Family(
    "bowl",
    _make,
    "household",
    spec={"alike": ("plate", "cup"), "names": {"modelnet": ("bowl",), "shapenet": ("02880940",)}},
)
