"""Cups without handles: straight, tapered, bulged, square, stemmed, footed, rimmed, lidded."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.lids import under_lid
from gfp_grasp.shapes.loft import rounded, rounded_off, smooth_noise, smoothstep
from gfp_grasp.shapes.vessel import Vessel

GRID = 240
_KINDS = {
    "tapered": 0.30,
    "straight": 0.16,
    "bulged": 0.16,
    "square": 0.12,
    "stemmed": 0.06,
    "footed": 0.06,
    "lidded": 0.14,
}


def _make(rng: np.random.Generator) -> Made:
    """One cup; a lidded cup is a solid, its wall is zero."""
    kind = draw_kind(rng, _KINDS)
    if kind == "lidded":
        return Made(_lidded(rng), kind)
    vessel = _stemmed(rng) if kind == "stemmed" else _plain(rng, kind)
    return Made(vessel.mesh(), kind, vessel.wall)


def side(rng: np.random.Generator, t: np.ndarray, kind: str) -> np.ndarray:
    """Relative radius (n,) of a cup's side over t in 0 .. 1, about 1 where it is widest."""
    taper = {"tapered": rng.uniform(0.12, 0.42), "lidded": rng.uniform(0.1, 0.35)}.get(kind, rng.normal(0.04, 0.05))
    curve = 1 + taper * (t ** rng.uniform(0.7, 1.5) - 1)
    if kind == "bulged":
        curve = curve + rng.uniform(0.08, 0.3) * np.sin(np.pi * t ** rng.uniform(0.6, 1.5))
    elif rng.random() < 0.2:
        curve = curve - rng.uniform(0.02, 0.12) * np.exp(-(((t - rng.uniform(0.3, 0.7)) / rng.uniform(0.12, 0.3)) ** 2))
    if rng.random() < 0.3:
        # A side that flares at the mouth.
        curve = curve + rng.uniform(0.03, 0.2) * smoothstep((t - rng.uniform(0.5, 0.8)) / 0.4) * t
    curve = curve + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.01, 0.025]), knots=int(rng.integers(4, 7)))
    return curve / curve.max()


def base_rounding(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray, *, bowl: float) -> np.ndarray:
    """What a rounded bottom edge takes off the radius, (n,) m; with chance `bowl` it reaches far up the side."""
    smallest = float(radius.min())
    if rng.random() < bowl:
        reach, depth = rng.uniform(0.2, 0.6) * height[-1], rng.uniform(0.25, 0.6) * smallest
    else:
        reach = rng.uniform(0.0008, 0.012)
        depth = min(reach, 0.35 * smallest)
    return rounded_off(height, reach, depth)


def lip(rng: np.random.Generator, height: np.ndarray) -> np.ndarray:
    """A rolled or banded edge at the mouth, (n,) m outside of the wall."""
    size, reach = rng.uniform(0.0006, 0.0025), rng.uniform(0.0015, 0.006)
    from_top = (height[-1] - height) / reach
    if rng.random() < 0.5:
        return size * np.sqrt(np.clip(1 - (from_top - 1) ** 2, 0, None)) * (from_top < 2)
    return size * (1 - smoothstep((from_top - 1) * 4))


def _plain(rng: np.random.Generator, kind: str) -> Vessel:
    tall = rng.uniform(0.05, 0.18)
    half = np.clip(tall * rng.uniform(0.25, 0.75), 0.025, 0.06) * rng.uniform(0.9, 1.0)
    height = np.linspace(0, tall, GRID)
    t = height / tall
    radius = half * side(rng, t, kind)
    wall = float(np.exp(rng.uniform(np.log(0.001), np.log(0.006))))
    radius = radius - base_rounding(rng, height, radius, bowl=0.25 if kind == "bulged" else 0.12)
    power: np.ndarray | float = 2.0
    if kind == "square":
        power = rng.uniform(3.5, 7.0) + (rng.random() < 0.4) * (2.2 - 3.5) * smoothstep(t * 1.2)
        radius = radius * 0.88
    extra = np.zeros(GRID)
    if rng.random() < 0.35:
        extra += lip(rng, height)
    if kind == "footed":
        extra += _foot(rng, height, radius)
    flutes = (int(rng.integers(6, 25)), rng.uniform(0.004, 0.02)) if rng.random() < 0.1 else (0, 0.0)
    aspect = rng.uniform(0.8, 0.97) if rng.random() < 0.08 else 1.0
    dent = rng.uniform(0.0008, 0.003) if rng.random() < 0.35 else 0.0
    floor = dent + np.clip(wall * rng.uniform(0.9, 2.5), 0.0012, 0.012)
    return Vessel(height, radius, wall, floor, extra, aspect, power, dent, flutes)


def _foot(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """A foot ring that stands out from a narrower waist above it."""
    reach = rng.uniform(0.004, 0.014)
    return rng.uniform(0.05, 0.2) * radius[0] * (1 - smoothstep(height / reach - 0.4))


def _stemmed(rng: np.random.Generator) -> Vessel:
    """A goblet: foot, stem and bowl."""
    tall = rng.uniform(0.11, 0.2)
    stem_top = tall * rng.uniform(0.2, 0.5)
    half, stem = rng.uniform(0.026, 0.045), rng.uniform(0.0035, 0.008)
    foot = half * rng.uniform(0.75, 1.0)
    height = np.linspace(0, tall, 2 * GRID)
    t = np.clip((height - stem_top) / (tall - stem_top), 0, 1)
    bowl = np.sqrt(np.clip(1 - (1 - np.clip(t / rng.uniform(0.3, 0.7), 0, 1)) ** 2, 0, 1))
    bowl = half * bowl * (1 + rng.uniform(-0.35, 0.15) * t**2)
    base = stem + (foot - stem) * np.exp(-np.clip(height - 0.002, 0, None) / rng.uniform(0.002, 0.006))
    wall = rng.uniform(0.001, 0.0025)
    return Vessel(height, np.maximum(bowl, base), wall, stem_top + 0.002)


def _lidded(rng: np.random.Generator) -> trimesh.Trimesh:
    """A takeaway cup with its lid on, as one solid."""
    tall, half = rng.uniform(0.07, 0.16), rng.uniform(0.032, 0.05)
    height = np.linspace(0, tall, GRID)
    radius = half * side(rng, height / tall, "lidded")
    radius = radius - base_rounding(rng, height, radius, bowl=0.0)
    top = radius[-1]
    brim, band = top + rng.uniform(0.001, 0.004), rng.uniform(0.004, 0.012)
    rise = rng.uniform(0.004, 0.02)
    if rng.random() < 0.3:
        turn = np.linspace(0, np.pi / 2, 20)
        lid = np.stack([brim * 0.97 * np.cos(turn), tall + band + rng.uniform(0.3, 1.0) * half * np.sin(turn)], axis=1)
        lid = np.concatenate([[[brim, tall], [brim, tall + band]], lid[:-1], [[1e-6, lid[-1, 1]]]])
    else:
        inner = brim * rng.uniform(0.78, 0.95)
        sunk = rng.uniform(0, 0.7) * rise if rng.random() < 0.7 else 0.0
        crest = tall + band + rise
        corners = [
            [top, tall], [brim, tall], [brim, tall + band], [inner, tall + band], [inner * 0.97, crest],
            [inner * 0.86, crest], [inner * 0.82, crest - sunk], [1e-6, crest - sunk],
        ]  # fmt: skip
        lid = rounded(corners, [0, 0.001, 0.002, 0.001, 0.002, 0.001, 0.001, 0])
    return under_lid(height, radius, lid, segments=48)


CUP = Family(
    "cup",
    _make,
    "household",
    spec={"alike": ("mug", "glass"), "names": {"modelnet": ("cup",), "shapenet": ("03147509",)}},
    variants={"lidded": {"hollow": False}, "stemmed": {}},
    also={"stemmed": ("wine_glass",)},
    members=120,
)
