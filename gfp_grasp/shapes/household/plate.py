"""Plates: for bread, dinner and soup; with a rim or curved throughout; round, oval and square."""

from __future__ import annotations

import numpy as np

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import inset, rounded, rows, smoothstep
from gfp_grasp.shapes.matched import cut, matched

_GRID = 500
# Rings of the underside within the foot, the foot, the underside outside of it, the edge, the rim and the well.
_COUNTS = (12, 8, 18, 6, 16, 16)
_SEGMENTS = 64
_KINDS = {"dinner": 0.32, "bread": 0.18, "deep": 0.16, "coupe": 0.18, "square": 0.1, "platter": 0.06}
_HALF_M = {
    "dinner": (0.11, 0.16), "bread": (0.065, 0.11), "deep": (0.095, 0.135), "coupe": (0.075, 0.16),
    "square": (0.07, 0.14), "platter": (0.12, 0.16),
}  # fmt: skip


def _make(rng: np.random.Generator) -> Made:
    """One plate; its wall is the thickness of the body."""
    kind = draw_kind(rng, _KINDS)
    half = rng.uniform(*_HALF_M[kind])
    wall = float(np.exp(rng.uniform(np.log(0.0018), np.log(0.0065)))) * min(1.0, half / 0.09)
    well, upper = _upper(rng, kind, half)
    radius = np.linspace(0, half, _GRID)
    top = np.interp(radius, upper[:, 0], upper[:, 1])
    bottom = inset(top, radius, wall)
    foot, width, drop = well * rng.uniform(0.72, 0.95), rng.uniform(0.002, 0.006), rng.uniform(0.0006, 0.0035)
    bottom = bottom - drop * smoothstep(2 * (1 - np.abs(radius - foot) / width))
    marks = (foot - width, foot + width)
    turn = np.linspace(0, np.pi, 9)[1:-1]
    edge_z = (bottom[-1] + top[-1]) / 2 - (top[-1] - bottom[-1]) / 2 * np.cos(turn)
    edge = np.stack([half + 0.4 * wall * np.sin(turn), edge_z], axis=1)
    below, above = np.stack([radius, bottom], axis=1), np.stack([radius, top], axis=1)[::-1]
    profiles = [
        *cut(below, [(mark, np.interp(mark, radius, bottom)) for mark in marks]),
        np.concatenate([below[-1:], edge, above[:1]]),
        *cut(above, [(well, np.interp(well, radius, top))]),
    ]
    aspect = {"platter": rng.uniform(0.6, 0.85)}.get(kind, rng.uniform(0.6, 0.97) if rng.random() < 0.08 else 1.0)
    power = {"square": rng.uniform(3.0, 8.0)}.get(kind, 2.0)
    pieces = [rows(np.maximum(p[:, 0], 1e-6), p[:, 1], aspect=aspect, power=power) for p in profiles]
    return Made(matched(pieces, _COUNTS, segments=_SEGMENTS), kind, wall)


def _upper(rng: np.random.Generator, kind: str, half: float) -> tuple[float, np.ndarray]:
    """Half-width m of the well, and the upper surface (n, 2) m from the axis to the edge."""
    deep = kind == "deep"
    tall = half * (rng.uniform(0.25, 0.45) if deep else rng.uniform(0.09, 0.24))
    if kind == "coupe" or rng.random() < 0.12:
        well = half * rng.uniform(0.5, 0.88)
        t = np.linspace(0, 1, 60)[:, None]
        side = np.hstack([well + (half - well) * t, tall * t ** rng.uniform(1.2, 2.6)])
        return well, np.concatenate([[[0, 0]], side])
    well = half * (rng.uniform(0.45, 0.68) if deep else rng.uniform(0.55, 0.78))
    step = tall * (rng.uniform(0.6, 0.95) if deep else rng.uniform(0.3, 0.8))
    rim = well + max((half - well) * rng.uniform(0.12, 0.5), 0.6 * step)
    rim = min(rim, half - 0.25 * (half - well))
    sag = rng.uniform(-0.1, 0.25) * (tall - step)
    corners = [[0, 0], [well, 0], [rim, step], [(rim + half) / 2, (step + tall) / 2 - sag], [half, tall]]
    return well, rounded(corners, [0, rng.uniform(0.006, 0.03), rng.uniform(0.006, 0.03), 0.05, 0], steps=16)


PLATE = Family("plate", _make, "household", spec={"alike": ("bowl",), "rests": {"upright": 0.97, "upside_down": 0.03}})
