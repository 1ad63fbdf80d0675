"""Jars: for jam, honey, cream, pickles, spices and stores, with their lid on; open ones are a variant."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.closed import Closed, even_side
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import rounded_off, smooth_noise, smoothstep
from gfp_grasp.shapes.vessel import Vessel

_GRID = 160
_KINDS = {"jam": 0.2, "honey": 0.1, "cosmetic": 0.16, "pickle": 0.12, "spice": 0.12, "storage": 0.18, "open": 0.12}
# Height of all of it, half-width over height.
_SIZES = {
    "jam": ((0.06, 0.14), (0.25, 0.5)),
    "honey": ((0.07, 0.15), (0.28, 0.48)),
    "cosmetic": ((0.025, 0.085), (0.4, 0.85)),
    "pickle": ((0.12, 0.21), (0.2, 0.34)),
    "spice": ((0.07, 0.14), (0.16, 0.3)),
    "storage": ((0.09, 0.28), (0.2, 0.48)),
    "open": ((0.06, 0.26), (0.25, 0.5)),
}


def _make(rng: np.random.Generator) -> Made:
    """One jar; a closed one is a solid, its wall is zero."""
    kind = draw_kind(rng, _KINDS)
    tall, slender = _SIZES[kind]
    tall = rng.uniform(*tall)
    half = float(np.clip(tall * rng.uniform(*slender), 0.016, 0.1))
    if kind == "open":
        return Made(*_open(rng, tall, half))
    return Made(_closed(rng, kind, tall, half), kind)


def _curve(rng: np.random.Generator, t: np.ndarray, kind: str) -> np.ndarray:
    """Relative radius (n,) of the side: straight, tapered, bulged, waisted."""
    curve = 1 + rng.choice([0.0, rng.uniform(-0.25, 0.2)]) * (t - 0.5)
    if kind in ("honey", "open") or rng.random() < 0.3:
        curve = curve + rng.uniform(0.03, 0.25) * np.sin(np.pi * t ** rng.uniform(0.7, 1.4))
    elif rng.random() < 0.15:
        curve = curve - rng.uniform(0.03, 0.12) * np.exp(-(((t - rng.uniform(0.35, 0.65)) / 0.25) ** 2))
    return curve + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.01]), knots=5)


def _closed(rng: np.random.Generator, kind: str, tall: float, half: float) -> trimesh.Trimesh:
    square = rng.random() < (0.25 if kind in ("storage", "spice", "honey") else 0.1)
    power = rng.uniform(2.6, 6.0) if square else 2.0
    aspect = rng.uniform(0.6, 1.0) if square and rng.random() < 0.4 else 1.0
    lid_tall = (
        float(np.clip(tall * rng.uniform(0.08, 0.3), 0.006, 0.05))
        if kind != "cosmetic"
        else tall * rng.uniform(0.2, 0.5)
    )
    stopper = kind in ("storage", "spice") and rng.random() < 0.4
    knob_tall = tall * rng.uniform(0.05, 0.28) if stopper else 0.0003
    shoulder = tall * (rng.uniform(0.01, 0.05) if rng.random() < 0.45 else rng.uniform(0.05, 0.22))
    if kind == "cosmetic":
        shoulder = tall * rng.uniform(0.01, 0.04)
    body = max(tall - lid_tall - knob_tall - shoulder, 0.35 * tall)
    side = even_side(body, half, _curve(rng, np.linspace(0, 1, _GRID), kind))
    top = float(side[-1, 0])
    narrow = top * (rng.uniform(0.88, 0.97) if shoulder < 0.05 * tall else rng.uniform(0.45, 0.92))
    # A lid of the body's own section is as wide as the body; on a neck it is round.
    alike = narrow > 0.85 * top and (not square or rng.random() < 0.5)
    neck = narrow if alike else min(narrow, 0.92 * top * aspect)
    lid = neck + rng.uniform(0.0012, 0.006) if not alike else max(top * rng.uniform(0.97, 1.06), neck + 0.001)
    upper = lid * (rng.uniform(0.75, 1.0) if rng.random() < 0.3 else rng.uniform(0.97, 1.0))
    knob = upper * (rng.uniform(0.2, 0.85) if stopper else rng.uniform(0.25, 0.5))
    return Closed(
        side,
        edge=rng.uniform(0.001, 0.006) if rng.random() < 0.6 else rng.uniform(0.005, 0.02),
        neck=neck,
        shoulder=shoulder,
        bend=rng.uniform(1.2, 2.6),
        groove=rng.uniform(0.0008, 0.006),
        lid=(lid, upper),
        lid_tall=lid_tall,
        lid_edge=rng.uniform(0.0008, 0.004) if rng.random() < 0.6 else 0.4 * lid_tall,
        dome=rng.uniform(0.0, 0.0015) if rng.random() < 0.6 else rng.uniform(0.002, 0.25 * upper),
        knob=(knob, knob_tall),
        aspect=aspect,
        lid_aspect=aspect if alike else 1.0,
        power=power,
        lid_power=power if alike else 2.0,
        dent=rng.choice([0.0, rng.uniform(0.0005, 0.004)]),
    ).mesh()


def _open(rng: np.random.Generator, tall: float, half: float) -> tuple[trimesh.Trimesh, str, float]:
    """A jar without its lid: a wide mouth above a shoulder, with a thread, a roll or a flare at the edge."""
    height = np.linspace(0, tall, 2 * _GRID)
    t = height / tall
    side = _curve(rng, t, "open")
    side = side / side.max()
    start, mouth = rng.uniform(0.6, 0.9), rng.uniform(0.6, 0.95)
    end = start + rng.uniform(0.3, 0.9) * (1 - start)
    share = smoothstep((t - start) / (end - start))
    side = side + (mouth - side) * share
    flare = rng.choice([0.0, rng.uniform(0.05, 0.25)])
    side = side + flare * smoothstep((t - 0.5 * (start + 1)) / (0.5 * (1 - start)))
    edge = min(rng.uniform(0.001, 0.02), 0.3 * half)
    radius = half * side - rounded_off(height, edge, edge)
    from_top = tall - height
    bead = rng.uniform(0.0004, 0.002) * np.exp(-(((from_top - rng.uniform(0.002, 0.012)) / 0.0018) ** 2))
    wall = float(rng.uniform(0.0018, 0.004) if tall < 0.15 else rng.uniform(0.003, 0.008))
    dent = rng.choice([0.0, rng.uniform(0.0005, 0.003)])
    vessel = Vessel(height, radius, wall, dent + wall * rng.uniform(1.2, 2.5), bead, dent=dent)
    return vessel.matched_mesh((8, 46, 6, 40, 8)), "open", wall


JAR = Family(
    "jar",
    _make,
    "household",
    spec={"alike": ("can", "bottle"), "names": {"shapenet": ("03593526",)}},
    variants={"open": {"hollow": True}},
)
