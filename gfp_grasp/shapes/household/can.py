"""Cans: food tins, flat fish tins, drinks cans with necked ends, paint and spray tins; solids with recessed ends."""

from __future__ import annotations

import numpy as np

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import rounded, rows, smoothstep
from gfp_grasp.shapes.matched import cut, matched

# Rings of the lower recess, its wall, the standing ring, the lower end, the body, the neck, the underside of the seam
# or cap, its side, its edge, the wall of the upper recess, and the recess.
_COUNTS = (9, 4, 3, 8, 22, 9, 2, 8, 3, 4, 9)
_SEGMENTS = 56
# Oblong tins have another mesh than the round ones, and a primitive of their own.
_SEGMENTS_OF_OBLONG = 64
_KINDS = {"food": 0.34, "drink": 0.3, "tuna": 0.14, "sardine": 0.05, "paint": 0.07, "spray": 0.1}
# Half-width and height, m.
_SIZES = {
    "food": ((0.026, 0.054), (0.055, 0.125)),
    "drink": ((0.0255, 0.034), (0.085, 0.17)),
    "tuna": ((0.029, 0.052), (0.022, 0.05)),
    "sardine": ((0.045, 0.062), (0.02, 0.032)),
    "paint": ((0.035, 0.09), (0.06, 0.2)),
    "spray": ((0.017, 0.034), (0.1, 0.23)),
}


def _make(rng: np.random.Generator) -> Made:
    kind = draw_kind(rng, _KINDS)
    half, tall = (rng.uniform(*span) for span in _SIZES[kind])
    bottom, top = _bottom(rng, kind, half), _top(rng, kind, half, tall)
    low, high = bottom[-1][1], top[0][1]
    t = np.linspace(0, 1, 120)
    body = np.column_stack([half - _ribs(rng, kind, t), low + (high - low) * t])
    before, after = rounded(bottom, [0, *[0.0006] * (len(bottom) - 2), 0]), rounded(top, [0, *_soft(kind), 0])
    pieces = [*cut(before, bottom[1:-1]), body, *cut(after, top[1:-1])]
    sardine = kind == "sardine"
    aspect, power = (rng.uniform(0.55, 0.8), rng.uniform(3.0, 5.0)) if sardine else (1.0, 2.0)
    if kind == "tuna" and rng.random() < 0.15:
        aspect = rng.uniform(0.6, 0.85)
    return Made(
        matched(
            [rows(p[:, 0], p[:, 1], aspect=aspect, power=power) for p in pieces],
            _COUNTS,
            segments=_SEGMENTS_OF_OBLONG if sardine else _SEGMENTS,
        ),
        kind,
    )


def _bottom(rng: np.random.Generator, kind: str, half: float) -> np.ndarray:
    """Corners (5, 2) m from the axis to the body: recess, its edge, the ring that it stands on, the end of the body."""
    if kind == "drink":
        ring = half * rng.uniform(0.68, 0.82)
        dome, rise = rng.uniform(0.006, 0.012), rng.uniform(0.006, 0.014)
        return np.array([[1e-6, dome], [0.75 * ring, 0.6 * dome], [0.9 * ring, 0.0], [ring, 0.0005], [half, rise]])
    seam = half + rng.uniform(-0.0008, 0.0014)
    depth, wide = rng.uniform(0.0008, 0.005), rng.uniform(0.001, 0.0022)
    return np.array([
        [1e-6, depth + rng.uniform(0, 0.0015)], [seam - 1.6 * wide, depth], [seam - wide, 0.0], [seam, 0.0005],
        [half, rng.uniform(0.0025, 0.0045)],
    ])  # fmt: skip


def _top(rng: np.random.Generator, kind: str, half: float, tall: float) -> np.ndarray:
    """Corners (7, 2) m from the body to the axis: neck, seam or cap, its edge, the recess."""
    if kind == "spray":
        rise, cap = half * rng.uniform(0.15, 0.9), rng.uniform(0.012, 0.05)
        out = half * rng.uniform(0.45, 0.97)
        neck = out - rng.uniform(0.0004, 0.003)
        upper = out * rng.uniform(0.75, 1.0)
        low, end = tall - cap, upper - rng.uniform(0.002, 0.004)
        return np.array([
            [half, low - rise], [neck, low], [out, low + 0.001], [upper, tall - 0.0005], [end, tall],
            [0.9 * end, tall - 0.0004], [1e-6, tall - rng.uniform(0.0005, 0.001)],
        ])  # fmt: skip
    seam_tall, wide, depth = rng.uniform(0.002, 0.004), rng.uniform(0.001, 0.0022), rng.uniform(0.0015, 0.006)
    if kind == "drink":
        seam = half * rng.uniform(0.76, 0.92)
        rise = max(half - seam, 0.004) * rng.uniform(1.2, 2.4)
        neck = seam - rng.uniform(0.0004, 0.0012)
    else:
        seam, rise = half + rng.uniform(-0.0008, 0.0014), rng.uniform(0.0008, 0.003)
        neck = min(seam - 0.0004, half)
    low = tall - seam_tall
    return np.array([
        [half, low - rise], [neck, low], [seam, low + 0.0004], [seam, tall - 0.0004], [seam - wide, tall],
        [seam - 1.6 * wide, tall - depth], [1e-6, tall - depth - rng.uniform(-0.0005, 0.001)],
    ])  # fmt: skip


def _soft(kind: str) -> list[float]:
    """Rounding m of the inner corners of the top."""
    return [0.0006, 0.0005, 0.006 if kind == "spray" else 0.0004, 0.0004, 0.0006]


def _ribs(rng: np.random.Generator, kind: str, t: np.ndarray) -> np.ndarray:
    """How deep the side lies behind its half-width, (n,) m: the beads that stiffen food tins."""
    if kind not in ("food", "paint") or rng.random() > 0.45:
        return np.zeros(len(t))
    low, high = rng.uniform(0.1, 0.35), rng.uniform(0.65, 0.9)
    window = smoothstep((t - low) / 0.08) * smoothstep((high - t) / 0.08)
    return rng.uniform(0.0004, 0.0012) * window * (1 - np.cos(2 * np.pi * t * rng.integers(6, 14))) / 2


CAN = Family(
    "can",
    _make,
    "household",
    spec={"alike": ("jar", "cup", "box"), "names": {"shapenet": ("02946921",)}},
    variants={"sardine": {}},
)
