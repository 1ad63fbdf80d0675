"""Cooking pots: stock pots to casseroles with two ears, open or with their lid, and saucepans with a long handle."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.family import Family, Made
from gfp_grasp.shapes.handles import bail, ears, long_handle
from gfp_grasp.shapes.household.cup import GRID, base_rounding, lip
from gfp_grasp.shapes.lids import lid
from gfp_grasp.shapes.loft import loft, rows, subtract, unite
from gfp_grasp.shapes.vessel import Vessel

_KINDS = {"open": 0.5, "lidded": 0.28, "saucepan": 0.22}
_SEGMENTS = 64
# Between the ears or a handle and the rim.
_BELOW_RIM_M = 0.004


def _make(rng: np.random.Generator) -> Made:
    """One pot; a lidded one is a solid, its wall is zero."""
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    height, radius = _side(rng, kind)
    tall, half = float(height[-1]), float(radius.max())
    # Roasters and terrines are low and oval.
    oval = kind != "saucepan" and tall < 1.1 * half and rng.random() < 0.25
    aspect = float(rng.uniform(0.65, 0.92)) if oval else 1.0
    if kind == "saucepan":
        along = rng.uniform(0.004, 0.009)
        at = tall - along - _BELOW_RIM_M - rng.uniform(0.0, 0.25) * tall
        carriers = [
            long_handle(
                rng,
                float(np.interp(at, height, radius)),
                at,
                length=rng.uniform(0.13, 0.21),
                along=along,
                across=rng.uniform(0.009, 0.016),
            )
        ]
    else:
        at = tall - max(0.012, tall * rng.uniform(0.1, 0.26)) - _BELOW_RIM_M
        carriers = ears(rng, float(np.interp(at, height, radius)), at)
    if kind == "lidded":
        return Made(unite([*_closed(rng, height, radius, aspect), *carriers]), kind)
    vessel = _open(rng, height, radius, aspect)
    return Made(unite([vessel.mesh(), *(subtract(part, vessel.core(0.5)) for part in carriers)]), kind, vessel.wall)


def _side(rng: np.random.Generator, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Heights and radius (n,) m of the outer side: straight, or a little wider at the top or in the middle."""
    half = rng.uniform(0.062, 0.11) if kind == "saucepan" else rng.uniform(0.075, 0.165)
    slim = rng.uniform(0.7, 1.4) if kind == "saucepan" else rng.choice([rng.uniform(0.5, 1.1), rng.uniform(1.0, 2.0)])
    height = np.linspace(0, float(np.clip(half * slim, 0.055, 0.27)), GRID)
    t = height / height[-1]
    curve = 1 + rng.choice([0.0, rng.uniform(0.0, 0.18)]) * (t - 1)
    curve = curve + rng.choice([0.0, rng.uniform(0.01, 0.09)], p=[0.65, 0.35]) * np.sin(np.pi * t)
    radius = half * curve / curve.max()
    edge = min(rng.uniform(0.002, 0.03), 0.35 * float(height[-1]))
    radius = radius - edge * (1 - np.sqrt(1 - np.clip(1 - height / edge, 0, 1) ** 2))
    return height, radius - base_rounding(rng, height, radius, bowl=0.0) * 0.1


def _open(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray, aspect: float) -> Vessel:
    # Sheet metal, or cast iron and stoneware.
    wall = rng.choice([rng.uniform(0.0011, 0.0025), rng.uniform(0.0025, 0.006)], p=[0.7, 0.3])
    extra = lip(rng, height) if rng.random() < 0.5 else 0.0
    return Vessel(height, radius, float(wall), float(wall) * rng.uniform(1.0, 2.5), extra, aspect, segments=_SEGMENTS)


def _closed(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray, aspect: float) -> list[trimesh.Trimesh]:
    """The body under its lid, whose knob is turned or a strap."""
    rim, strap = float(radius[-1]), rng.random() < 0.2
    knob = 0.0 if strap else float(np.clip(rim * rng.uniform(0.13, 0.24), 0.012, 0.028))
    dome = rim * rng.choice([rng.uniform(0.03, 0.15), rng.uniform(0.15, 0.42)])
    cover = lid(rng, rim, float(height[-1]), dome=dome, knob=knob)
    # The knob stays round, whatever the body is.
    lid_aspect = np.where(cover[:, 0] > 0.4 * rim, aspect, 1.0)
    rings = [rows([1e-6], [0.0]), rows(radius, height, aspect=aspect)]
    rings.append(rows(cover[:, 0], cover[:, 1], aspect=lid_aspect))
    body = loft(np.concatenate(rings), segments=_SEGMENTS)
    if not strap:
        return [body]
    span, top = rng.uniform(0.026, 0.05), float(cover[:, 1].max())
    low = float(np.interp(span, cover[::-1, 0], cover[::-1, 1])) - 0.004
    along, across = rng.uniform(0.003, 0.006), rng.uniform(0.005, 0.011)
    return [body, bail(rng, span, low, top + rng.uniform(0.024, 0.04), along=along, across=across)]


POT = Family(
    "pot",
    _make,
    "household",
    spec={"alike": ("pan", "bowl"), "optional_parts": (), "density_kg_m3": (2000.0, 7900.0)},
    variants={"lidded": {"hollow": False, "density_kg_m3": (150.0, 1500.0)}, "saucepan": {}},
    members=120,
)
