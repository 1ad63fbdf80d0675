"""Tubes for toothpaste, cream and paint: standing on their cap, the crimped end up and widest along x."""

from __future__ import annotations

import numpy as np

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import rounded, rows, smooth_noise
from gfp_grasp.shapes.matched import cut, matched

# Rings of the cap's end, its side, its shoulder, the neck, the tube's shoulder, the body, the crimp and its end.
_COUNTS = (6, 10, 5, 3, 6, 34, 6, 3)
_SEGMENTS = 56
_KINDS = {"toothpaste": 0.32, "cream": 0.34, "paint": 0.16, "cosmetic": 0.18}
# Half-width of the round end and length without the cap, m.
_SIZES = {
    "toothpaste": ((0.014, 0.021), (0.1, 0.165)),
    "cream": ((0.012, 0.027), (0.075, 0.16)),
    "paint": ((0.008, 0.02), (0.055, 0.14)),
    "cosmetic": ((0.009, 0.019), (0.06, 0.13)),
}


def _make(rng: np.random.Generator) -> Made:
    kind = draw_kind(rng, _KINDS)
    half, tall = (rng.uniform(*span) for span in _SIZES[kind])
    cap = _cap(rng, kind, half)
    body = _body(rng, half, tall, float(cap[-1][-1, 1]))
    crimp = body[-1]
    end = crimp[-1].copy()
    end[:2] = 1e-6
    pieces = [rows(p[:, 0], p[:, 1]) for p in cap]
    return Made(matched([*pieces, *body, np.stack([crimp[-1], end])], _COUNTS, segments=_SEGMENTS), kind)


def _cap(rng: np.random.Generator, kind: str, half: float) -> list[np.ndarray]:
    """Profile (n, 2) m of the cap and the shoulder: as wide as the tube to stand on, or a small screw cap."""
    wide = {"toothpaste": 0.5, "cream": 0.75, "paint": 0.1, "cosmetic": 0.8}[kind] > rng.random()
    out = half * (rng.uniform(0.85, 1.04) if wide else rng.uniform(0.32, 0.7))
    tall = rng.uniform(0.012, 0.035) if wide else rng.uniform(0.007, 0.022)
    base = out * (rng.uniform(0.92, 1.05) if wide else rng.uniform(0.65, 1.0))
    neck = out * (rng.uniform(0.82, 0.95) if wide else rng.uniform(0.6, 0.92))
    bare, rise = rng.uniform(0.0008, 0.003), (half - neck) * rng.uniform(0.15, 0.75) + 0.0008
    corners = np.array([
        [1e-6, 0.0], [base, 0.0], [out, tall], [neck, tall + 0.0008], [neck, tall + 0.0008 + bare],
        [half, tall + 0.0008 + bare + rise],
    ])  # fmt: skip
    curve = rounded(corners, [0, rng.uniform(0.0006, 0.004), rng.uniform(0.0004, 0.002), 0.0003, 0.0005, 0])
    start = [corners[1], [out - 0.1 * (out - base), 0.9 * tall], corners[3], corners[4]]
    return cut(curve, start)


def _body(rng: np.random.Generator, half: float, tall: float, low: float) -> list[np.ndarray]:
    """Rings from the round shoulder to the flat crimp: the way around stays the same, so that the flat end is wide."""
    t = np.linspace(0, 1, 120)
    flat = rng.uniform(0.0005, 0.0011)
    # Full tubes stay round for long; a squeezed one is flat early.
    narrow = flat + (half - flat) * (1 - t ** rng.uniform(0.75, 2.2))
    narrow = narrow * (1 + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.03]), knots=5) * np.sin(np.pi * t))
    narrow = np.clip(narrow, flat, half)
    wide = _wide(half, narrow)
    wide = half + (wide - half) * rng.uniform(0.75, 1.0)
    power = 2.0 + rng.uniform(0.0, 1.5) * t**3
    side = np.stack([wide, narrow, low + tall * t, power], axis=1)
    length = rng.uniform(0.003, 0.012)
    crimp = np.repeat(side[-1:], 12, axis=0)
    crimp[:, 2] += np.linspace(0, length, 12)
    return [side, crimp]


def _wide(half: float, narrow: np.ndarray) -> np.ndarray:
    """Greater half-width (n,) m of the ellipse as long around as a circle, from the smaller one, by bisection."""
    low, high = np.full(len(narrow), half), np.full(len(narrow), 1.6 * half)
    for _ in range(30):
        middle = (low + high) / 2
        # Ramanujan's first approximation of the perimeter over pi.
        around = 3 * (middle + narrow) - np.sqrt((3 * middle + narrow) * (middle + 3 * narrow))
        low, high = np.where(around < 2 * half, middle, low), np.where(around < 2 * half, high, middle)
    return (low + high) / 2


TUBE = Family("tube", _make, "household", spec={"alike": ("bottle",), "rests": {"lying": 0.7, "upright": 0.3}})
