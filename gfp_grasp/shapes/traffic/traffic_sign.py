"""Traffic signs: a plate of any of the usual outlines on a pole, facing +x."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import trimesh

from gfp_grasp.shapes.family import Family, Made
from gfp_grasp.shapes.loft import loft, rounded, rows, skin, unite

_KINDS = {
    "round": 0.26, "triangle": 0.16, "yield": 0.08, "octagon": 0.1, "square": 0.12, "diamond": 0.1, "rectangle": 0.18,
}  # fmt: skip
_CORNERS = {"triangle": (3, 90.0), "yield": (3, -90.0), "octagon": (8, 22.5), "square": (4, 45.0), "diamond": (4, 0.0)}
_SIDE_POINTS = 12


def _make(rng: np.random.Generator) -> Made:
    """One sign: the pole's axis is z, the plate stands before it."""
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    outline = _outline(rng, kind)
    low, high = outline[:, 1].min(), outline[:, 1].max()
    tall = rng.uniform(1.8, 3.5)
    top = rng.uniform(-0.05, 0.12)  # of the pole over the plate
    lift = tall - max(top, 0.0) - high
    pole, thick = rng.uniform(0.025, 0.045), rng.uniform(0.022, 0.04)
    plate = _plate(rng, outline + np.array([0.0, lift]), thick, 0.75 * pole)
    end = max(lift + high + top, lift + 0.3 * high + 0.7 * low)
    return Made(unite([plate, _pole(rng, pole, end)], longest_m=0.07), kind)


def _outline(rng: np.random.Generator, kind: str) -> np.ndarray:
    """Outline (n, 2) m of y and z, turning left, its rounded corners finely divided."""
    if kind == "round":
        turn = np.linspace(0, 2 * np.pi, 73)[:-1]
        return rng.uniform(0.2, 0.48) * np.column_stack([np.cos(turn), np.sin(turn)])
    if kind == "rectangle":
        wide, tall = _rectangle(rng)
        corners = np.array([[wide, -tall], [wide, tall], [-wide, tall], [-wide, -tall]]) / 2
    else:
        count, start = _CORNERS[kind]
        reach = rng.uniform(0.38, 0.62) if count == 3 else rng.uniform(0.28, 0.55)
        turn = np.radians(start) + 2 * np.pi * np.arange(count) / count
        corners = reach * np.column_stack([np.cos(turn), np.sin(turn)])
    bend = rng.uniform(0.01, 0.06)
    middle = (corners[-1] + corners[0]) / 2
    closed = np.concatenate([[middle], corners, [middle]])
    line = rounded(closed, [0, *([bend] * len(corners)), 0])
    return _divided(line)


def _rectangle(rng: np.random.Generator) -> tuple[float, float]:
    """Width and height, m: upright or, more often than not, level."""
    short, long = rng.uniform(0.3, 0.75), rng.uniform(1.15, 2.4)
    return (short, min(short * long, 1.1)) if rng.random() < 0.5 else (min(short * long, 1.3), short)


def _divided(line: np.ndarray) -> np.ndarray:
    """The closed line (n, 2) with points at most so far apart as a twelfth of its longest side."""
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    step = np.diff(length).max() / _SIDE_POINTS
    pieces = [np.linspace(a, b, max(int(np.ceil((b - a) / step)), 1) + 1)[:-1] for a, b in pairwise(length)]
    at = np.concatenate(pieces)
    return np.column_stack([np.interp(at, length, line[:, i]) for i in (0, 1)])


def _plate(rng: np.random.Generator, outline: np.ndarray, thick: float, start: float) -> trimesh.Trimesh:
    """The plate from x = start on, its edges slightly rounded."""
    middle = outline.mean(axis=0)
    bend = 0.3 * thick
    rings = []
    for shrink, x in ((0.5, 0.0), (bend, 0.0), (0.0, bend), (0.0, thick - bend), (bend, thick), (0.5, thick)):
        reach = np.linalg.norm(outline - middle, axis=1, keepdims=True)
        scale = 0.5 if shrink == 0.5 else 1 - shrink / reach
        rings.append(np.column_stack([np.full(len(outline), start + x), middle + (outline - middle) * scale]))
    return skin(np.array(rings))


def _pole(rng: np.random.Generator, radius: float, end: float) -> trimesh.Trimesh:
    """A round post, or a square one, perhaps in a sleeve at its foot."""
    z = np.linspace(0, end, 60)
    sleeve = (rng.random() < 0.4) * rng.uniform(0.003, 0.02) * (z < rng.uniform(0.1, 0.3))
    power = 2.0 if rng.random() < 0.8 else rng.uniform(4.0, 7.0)
    return loft(
        np.concatenate([rows([1e-6], [0.0]), rows(radius + sleeve, z, power=power), rows([1e-6], [end])]),
        segments=24,
        longest_m=0.06,
    )


TRAFFIC_SIGN = Family(
    "traffic_sign",
    _make,
    "traffic",
    spec={"rests": {"upright": 1.0}, "density_kg_m3": (200.0, 2500.0)},
    members=80,
)
