"""Flasks: thermos flasks with a cup cap, drinking flasks; hip flasks and laboratory flasks are variants."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.closed import Closed, even_side
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import rounded_off, smooth_noise, smoothstep
from gfp_grasp.shapes.vessel import Vessel

_GRID = 160
_KINDS = {"thermos": 0.44, "drinking": 0.34, "hip": 0.12, "laboratory": 0.1}
# Hip flasks have another mesh than the round ones: a mean of both would be neither.
_SEGMENTS_OF_FLAT = 64


def _make(rng: np.random.Generator) -> Made:
    """One flask; a closed one is a solid, its wall is zero."""
    kind = draw_kind(rng, _KINDS)
    if kind == "laboratory":
        return Made(*_laboratory(rng))
    return Made({"thermos": _thermos, "drinking": _drinking, "hip": _hip}[kind](rng), kind)


def _straight(rng: np.random.Generator, amount: float) -> np.ndarray:
    """Relative radius (n,) of a side that is straight, or tapered and waisted by up to an amount."""
    t = np.linspace(0, 1, _GRID)
    curve = 1 + rng.choice([0.0, rng.uniform(-amount, amount)]) * (t - 0.5)
    if rng.random() < 0.25:
        curve = curve - rng.uniform(0.0, amount) * np.exp(-(((t - rng.uniform(0.4, 0.75)) / 0.25) ** 2))
    return curve + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.006]), knots=6)


def _thermos(rng: np.random.Generator) -> trimesh.Trimesh:
    """A tall cylinder whose cap is a cup, nearly as wide as the body."""
    tall = rng.uniform(0.19, 0.36)
    half = float(np.clip(tall * rng.uniform(0.12, 0.2), 0.03, 0.058))
    lid_tall = tall * rng.uniform(0.16, 0.32)
    shoulder = tall * rng.uniform(0.01, 0.08)
    side = even_side(tall - lid_tall - shoulder, half, _straight(rng, 0.08))
    top = float(side[-1, 0])
    neck = top * rng.uniform(0.8, 0.96)
    lid = max(top * rng.uniform(0.82, 1.04), neck + 0.0006)
    upper = lid * rng.uniform(0.78, 1.0)
    return Closed(
        side,
        edge=rng.uniform(0.001, 0.008),
        neck=neck,
        shoulder=shoulder,
        bend=rng.uniform(1.0, 2.2),
        groove=rng.uniform(0.0008, 0.006),
        lid=(lid, upper),
        lid_tall=lid_tall,
        lid_edge=rng.uniform(0.001, 0.012),
        dome=rng.choice([0.0005, rng.uniform(0.001, 0.008)]),
        knob=(upper * rng.uniform(0.3, 0.7), rng.choice([0.0003, rng.uniform(0.0006, 0.004)])),
        dent=rng.choice([0.0, rng.uniform(0.0005, 0.004)]),
    ).mesh()


def _drinking(rng: np.random.Generator) -> trimesh.Trimesh:
    """A steel flask to drink from: a long shoulder, and a cap narrower than the body."""
    tall = rng.uniform(0.18, 0.31)
    half = float(np.clip(tall * rng.uniform(0.12, 0.19), 0.029, 0.05))
    lid_tall = rng.uniform(0.018, 0.055)
    shoulder = tall * rng.uniform(0.06, 0.28)
    knob_tall = rng.uniform(0.006, 0.02) if rng.random() < 0.25 else 0.0003
    side = even_side(tall - lid_tall - shoulder - knob_tall, half, _straight(rng, 0.12))
    neck = float(side[-1, 0]) * rng.uniform(0.36, 0.78)
    lid = neck * rng.uniform(1.03, 1.18) + 0.0006
    upper = lid * rng.uniform(0.85, 1.0)
    return Closed(
        side,
        edge=rng.uniform(0.001, 0.01),
        neck=neck,
        shoulder=shoulder,
        bend=rng.uniform(1.3, 2.6),
        groove=rng.uniform(0.0008, 0.008),
        lid=(lid, upper),
        lid_tall=lid_tall,
        lid_edge=rng.uniform(0.001, 0.008),
        dome=rng.choice([0.0005, rng.uniform(0.001, 0.008)]),
        knob=(upper * rng.uniform(0.25, 0.7), knob_tall),
        dent=rng.choice([0.0, rng.uniform(0.0005, 0.004)]),
    ).mesh()


def _hip(rng: np.random.Generator) -> trimesh.Trimesh:
    """A flat flask for the pocket, with a small round cap."""
    tall = rng.uniform(0.085, 0.17)
    half, aspect = tall * rng.uniform(0.3, 0.42), rng.uniform(0.24, 0.42)
    lid_tall, shoulder = rng.uniform(0.01, 0.022), tall * rng.uniform(0.06, 0.22)
    side = even_side(tall - lid_tall - shoulder, half, _straight(rng, 0.14))
    neck = min(rng.uniform(0.007, 0.011), 0.85 * aspect * float(side[-1, 0]))
    lid = neck + rng.uniform(0.0008, 0.003)
    upper = lid * rng.uniform(0.9, 1.0)
    return Closed(
        side,
        edge=rng.uniform(0.001, 0.012),
        neck=neck,
        shoulder=shoulder,
        bend=rng.uniform(1.6, 3.5),
        groove=rng.uniform(0.0008, 0.004),
        lid=(lid, upper),
        lid_tall=lid_tall,
        lid_edge=rng.uniform(0.0008, 0.003),
        dome=rng.choice([0.0003, rng.uniform(0.0005, 0.002)]),
        knob=(upper * rng.uniform(0.25, 0.5), 0.0003),
        aspect=aspect,
        power=rng.uniform(2.0, 5.0),
        segments=_SEGMENTS_OF_FLAT,
    ).mesh()


def _laboratory(rng: np.random.Generator) -> tuple[trimesh.Trimesh, str, float]:
    """A conical flask, or a round one with a flat bottom, with an open neck."""
    tall, slender = rng.uniform(0.08, 0.24), rng.uniform(0.24, 0.36)
    half = tall * slender
    start = rng.uniform(0.58, 0.76)
    t = np.concatenate([start * np.linspace(0, 1, 240)[:-1], np.linspace(start, 1, 120)])
    up = np.clip(t / start, 0, 1)
    neck = float(np.clip(half * rng.uniform(0.24, 0.5), 0.008, 0.028)) / half
    if rng.random() < 0.6:
        corner = rng.uniform(0.05, 0.22)
        cone = 1 - (1 - neck) * np.clip((up - corner) / (1 - corner), 0, 1)
        body = cone - rounded_off(up, corner, 0.3)
    else:
        standing = rng.uniform(0.3, 0.6)
        depth = np.sqrt(1 - standing**2)
        # A sphere from its standing ring to where the neck begins.
        body = np.sqrt(np.clip(1 - (up * (depth + np.sqrt(1 - neck**2)) - depth) ** 2, 0, 1))
    # A soft maximum: glass is drawn from the body into the neck without a crease.
    radius = half * (body**8 + neck**8) ** (1 / 8) / (1 + neck**8) ** (1 / 8)
    flare = rng.uniform(0.0008, 0.004) * smoothstep((t - 1 + 0.006 / tall) * tall / 0.006)
    wall = rng.uniform(0.0012, 0.0028)
    vessel = Vessel(t * tall, radius, wall, wall * rng.uniform(1.2, 2.0), flare)
    return vessel.matched_mesh((8, 34, 16, 6, 44, 8), breaks_m=(start * tall,)), "laboratory", wall


FLASK = Family(
    "flask",
    _make,
    "household",
    spec={"alike": ("bottle",), "rests": {"upright": 0.9, "lying": 0.09, "upside_down": 0.01}},
    variants={"hip": {}, "laboratory": {"hollow": True}},
)
