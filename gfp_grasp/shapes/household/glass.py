"""Drinking glasses without a stem: tumblers, highballs, pints, shot glasses, whisky glasses, stemless wine glasses."""

from __future__ import annotations

import numpy as np

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import rounded_off, smooth_noise, smoothstep
from gfp_grasp.shapes.vessel import Vessel

_GRID = 240
_COUNTS = (8, 40, 6, 34, 8)
_KINDS = {"tumbler": 0.3, "highball": 0.2, "pint": 0.16, "shot": 0.1, "whisky": 0.14, "stemless": 0.1}


def _make(rng: np.random.Generator) -> Made:
    kind = draw_kind(rng, _KINDS)
    tall, half = _size(rng, kind)
    height = np.linspace(0, tall, _GRID)
    radius = half * _side(rng, height / tall, kind)
    radius = radius - _base_edge(rng, height, radius, kind)
    wall = float(np.exp(rng.uniform(np.log(0.001), np.log(0.005 if kind in ("whisky", "shot") else 0.0035))))
    dent = rng.uniform(0.0005, 0.003) if rng.random() < 0.4 else 0.0
    power: float = 2.0
    if kind in ("tumbler", "whisky", "highball") and rng.random() < 0.12:
        power, radius = rng.uniform(2.5, 5.0), 0.92 * radius
    flutes = (int(rng.integers(6, 16)), rng.uniform(0.004, 0.018)) if rng.random() < 0.12 else (0, 0.0)
    vessel = Vessel(height, radius, wall, _floor(rng, kind, tall, wall, dent), 0.0, 1.0, power, dent, flutes)
    return Made(vessel.matched_mesh(_COUNTS), kind, wall)


def _size(rng: np.random.Generator, kind: str) -> tuple[float, float]:
    """Height and greatest half-width, m."""
    tall, half = {
        "tumbler": ((0.075, 0.125), (0.03, 0.046)),
        "highball": ((0.115, 0.185), (0.026, 0.038)),
        "pint": ((0.135, 0.235), (0.034, 0.047)),
        "shot": ((0.042, 0.1), (0.019, 0.028)),
        "whisky": ((0.075, 0.11), (0.036, 0.047)),
        "stemless": ((0.085, 0.13), (0.036, 0.052)),
    }[kind]
    return rng.uniform(*tall), rng.uniform(*half)


def _side(rng: np.random.Generator, t: np.ndarray, kind: str) -> np.ndarray:
    """Relative radius (n,) over t in 0 .. 1, 1 where the glass is widest."""
    tapers = {"pint": rng.uniform(0.15, 0.38), "shot": rng.uniform(0.05, 0.35), "stemless": 0.0}
    other = float(rng.choice([rng.uniform(-0.03, 0.08), rng.uniform(0.05, 0.3)]))
    taper = tapers.get(kind, other)
    curve = 1 + taper * (t ** rng.uniform(0.7, 1.6) - 1)
    if kind == "stemless":
        widest = rng.uniform(0.3, 0.5)
        curve = curve - rng.uniform(0.1, 0.3) * (np.clip(t - widest, 0, 1) / (1 - widest)) ** rng.uniform(1.6, 2.4)
    if kind == "pint" and rng.random() < 0.5:
        # The ring to hold it by, or the narrow waist of a wheat beer glass.
        place, spread = rng.uniform(0.72, 0.84), rng.uniform(0.05, 0.09)
        curve = curve + rng.choice([rng.uniform(0.04, 0.09), 0.0]) * np.exp(-(((t - place) / spread) ** 2))
        curve = curve - rng.uniform(0.0, 0.22) * np.exp(-(((t - 0.28) / 0.2) ** 2))
    if kind in ("tumbler", "whisky") and rng.random() < 0.3:
        curve = curve + rng.uniform(0.02, 0.14) * np.sin(np.pi * t ** rng.uniform(0.7, 1.3))
    if rng.random() < 0.15:
        curve = curve + rng.uniform(0.02, 0.1) * smoothstep((t - rng.uniform(0.6, 0.8)) / 0.35)
    curve = curve + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.006]), knots=5)
    return curve / curve.max()


def _base_edge(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray, kind: str) -> np.ndarray:
    """What the rounding of the bottom edge takes off the radius, (n,) m."""
    if kind == "stemless":
        reach, depth = rng.uniform(0.3, 0.5) * height[-1], rng.uniform(0.35, 0.6) * float(radius.min())
    else:
        reach = rng.uniform(0.0008, 0.008 if rng.random() < 0.7 else 0.02)
        depth = min(reach, 0.3 * float(radius.min()))
    return rounded_off(height, reach, depth)


def _floor(rng: np.random.Generator, kind: str, tall: float, wall: float, dent: float) -> float:
    """Height of the inner bottom, m: heavy glasses have as much glass below the drink as around it."""
    thick = {"whisky": rng.uniform(0.007, 0.024), "shot": rng.uniform(0.004, 0.018)}.get(
        kind, rng.uniform(0.002, 0.012) if rng.random() < 0.7 else rng.uniform(0.01, 0.02)
    )
    return dent + float(np.clip(thick, 1.2 * wall, 0.3 * tall))


GLASS = Family("glass", _make, "household", spec={"alike": ("cup", "mug", "wine_glass")})
