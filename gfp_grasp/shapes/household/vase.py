"""Vases: cylinders, trumpets, balusters, globes, cones; those with a narrow neck are a variant."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import smooth_noise, smoothstep
from gfp_grasp.shapes.vessel import Vessel

_GRID = 320
# Rings of the underside, the foot, the side, the rim, the inside and the floor.
_COUNTS = (9, 4, 46, 6, 44, 8)
_KINDS = {"cylinder": 0.16, "trumpet": 0.16, "cone": 0.12, "baluster": 0.22, "globe": 0.14, "narrow": 0.2}


def _make(rng: np.random.Generator) -> Made:
    kind = draw_kind(rng, _KINDS)
    tall = rng.uniform(0.09, 0.35)
    slender = {"globe": (0.32, 0.52), "narrow": (0.16, 0.36)}.get(kind, (0.15, 0.4))
    half = float(np.clip(tall * rng.uniform(*slender), 0.028, 0.125))
    foot = rng.choice([0.001, rng.uniform(0.003, 0.08 * tall)], p=[0.6, 0.4])
    height = np.concatenate([np.linspace(0, foot, 20)[:-1], np.linspace(foot, tall, _GRID)])
    radius = half * _side(rng, np.clip((height - foot) / (tall - foot), 0, 1), kind)
    radius = np.maximum(radius, 0.008)
    if foot > 0.002:
        radius = np.where(height < foot, radius[-_GRID] * rng.uniform(0.75, 1.0), radius)
    radius = radius - rng.uniform(0.2, 0.8) * 0.001 * (1 - np.minimum(height / 0.001, 1)) ** 2
    wall = rng.uniform(0.0018, 0.0025 + 0.012 * tall)
    wall = min(wall, 0.45 * float(radius.min()))
    extra = rng.choice([0.0, rng.uniform(0.0005, 0.004)]) * np.exp(
        -(((tall - height) / rng.uniform(0.002, 0.006)) ** 2)
    )
    power = rng.uniform(2.6, 6.0) if kind in ("cylinder", "cone") and rng.random() < 0.25 else 2.0
    aspect = rng.uniform(0.55, 0.95) if rng.random() < 0.08 else 1.0
    flutes = (int(rng.integers(6, 20)), rng.uniform(0.004, 0.025)) if rng.random() < 0.1 else (0, 0.0)
    dent = rng.choice([0.0, rng.uniform(0.0008, 0.003)])
    floor = max(dent + wall * rng.uniform(1.2, 3.0), foot + 0.5 * wall if foot > 0.002 else 0.0)
    vessel = Vessel(height, radius, wall, floor, extra, aspect, power, dent, flutes)
    return Made(vessel.matched_mesh(_COUNTS, breaks_m=(foot,)), kind, wall)


def _side(rng: np.random.Generator, t: np.ndarray, kind: str) -> np.ndarray:
    """Relative radius (n,) over t in 0 .. 1 above the foot: smooth through a base, a belly, a neck and a mouth."""
    u = rng.uniform
    places, radii = {
        "cylinder": lambda: ([0, 0.5, 1], [1, 1 + u(-0.08, 0.08), 1 + u(-0.1, 0.1)]),
        "trumpet": lambda: ([0, u(0.2, 0.5), 0.75, 1], [u(0.4, 0.8), u(0.3, 0.6), u(0.5, 0.75), 1]),
        "cone": lambda: ([0, 0.5, 1], [(low := u(0.45, 0.85)), (1 + low) / 2 + u(-0.06, 0.08), 1]),
        "baluster": lambda: (
            [0, u(0.4, 0.72), u(0.8, 0.92), 1], [u(0.35, 0.75), 1, u(0.4, 0.7), u(0.4, 0.95)]
        ),
        "globe": lambda: ([0, u(0.38, 0.55), u(0.85, 0.95), 1], [u(0.35, 0.65), 1, u(0.4, 0.75), u(0.4, 0.85)]),
        "narrow": lambda: (
            [0, u(0.2, 0.4), (neck := u(0.5, 0.8)), (neck + 1) / 2, 1],
            [u(0.3, 0.75), 1, (thin := u(0.1, 0.35)), thin * u(0.85, 1.1), thin * u(1.0, 2.2)],
        ),
    }[kind]()  # fmt: skip
    curve = PchipInterpolator(places, radii)(t)
    if kind in ("globe", "baluster", "narrow"):
        # Full towards the foot, as what is thrown on a wheel.
        full = np.clip(t / places[1], 0, 1)
        round_base = radii[0] + (radii[1] - radii[0]) * np.sqrt(1 - (1 - full) ** 2)
        curve = np.where(t < places[1], curve + u(0.0, 0.9) * (round_base - curve), curve)
    curve = curve + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.008]), knots=6) * smoothstep(6 * t)
    return curve / curve.max()


VASE = Family(
    "vase",
    _make,
    "household",
    spec={"alike": ("jar", "glass"), "names": {"modelnet": ("vase",)}},
    variants={"narrow": {}},
)
