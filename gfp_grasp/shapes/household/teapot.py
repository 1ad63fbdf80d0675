"""Teapots and coffee pots with their lids on: a spout or a beak towards -x, a loop handle towards +x."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.handles import loop_handle
from gfp_grasp.shapes.lids import lid, under_lid
from gfp_grasp.shapes.loft import rounded_off, smooth_noise, smoothstep, unite
from gfp_grasp.shapes.spouts import Beak, beaked, spout

_GRID = 160
_KINDS = {"round": 0.5, "tall": 0.22, "beak": 0.28}
_SEGMENTS = 64
_BEAK = Beak(out=(0.2, 0.55), below=(0.12, 0.4), rise=(0.0, 0.35), width=(0.3, 0.5), within=0.88)


def _make(rng: np.random.Generator) -> Made:
    """One teapot, closed and modelled as a solid; its kind is that of its body or its beak."""
    kind = draw_kind(rng, _KINDS)
    height, radius = _side(rng, kind)
    rim = float(radius[-1])
    cover = lid(
        rng,
        rim,
        float(height[-1]),
        dome=rim * rng.uniform(0.15, 0.6),
        knob=float(np.clip(rim * rng.uniform(0.15, 0.32), 0.006, 0.019)),
        over=-rim * rng.uniform(0.02, 0.12) if kind == "beak" else rim * rng.uniform(-0.1, 0.06),
    )
    body = under_lid(height, radius, cover, segments=_SEGMENTS)
    handle = _handle(rng, height, radius)
    if kind == "beak":
        body.vertices = beaked(rng, np.asarray(body.vertices), float(height[-1]), rim, _BEAK)
        return Made(unite([body, handle]), kind)
    return Made(unite([body, handle, _spout(rng, height, radius)]), kind)


def _side(rng: np.random.Generator, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Heights and radius (n,) m of the outer side, from the base to the mouth."""
    half = rng.uniform(0.055, 0.095) if kind == "round" else rng.uniform(0.042, 0.075)
    slim = {"round": (1.0, 1.6), "tall": (1.9, 3.4), "beak": (1.9, 3.4)}[kind]
    height = np.linspace(0, min(half * rng.uniform(*slim), 0.21), _GRID)
    t = height / height[-1]
    if kind == "round":
        low, top, widest = rng.uniform(0.45, 0.8), rng.uniform(0.45, 0.75), rng.uniform(0.35, 0.6)
        power = rng.uniform(1.7, 3.0)
        down, up = np.clip(1 - t / widest, 0, 1), np.clip((t - widest) / (1 - widest), 0, 1)
        curve = 1 - (1 - low) * down**power - (1 - top) * up**power
    else:
        taper = rng.choice([rng.uniform(0.1, 0.45), rng.normal(0.0, 0.06)])
        curve = 1 - taper * t + rng.choice([0.0, rng.uniform(0.02, 0.2)]) * np.sin(np.pi * t ** rng.uniform(0.6, 1.2))
        if rng.random() < 0.35:
            curve = curve - rng.uniform(0.05, 0.25) * smoothstep((t - 0.7) / 0.3)
    curve = curve + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.01, 0.02]), knots=5)
    radius = half * curve / curve.max()
    edge = rng.uniform(0.001, 0.012)
    return height, radius - rounded_off(height, edge, edge)


def _spout(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray) -> trimesh.Trimesh:
    """A spout whose tip is about as high as the mouth, or tea would run out of it."""
    tall = float(height[-1])
    low = tall * rng.uniform(0.25, 0.5)
    side = float(np.interp(low, height, radius))
    thick = float(np.clip(tall * rng.uniform(0.11, 0.18), 0.011, 0.019))
    tip = side + rng.uniform(0.03, 0.065), tall * rng.uniform(0.86, 1.06)
    return spout(rng, (0.55 * side, low), tip, thick=thick, thin=rng.uniform(0.005, 0.009))


def _handle(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray) -> trimesh.Trimesh:
    tall = float(height[-1])
    along = rng.uniform(0.004, 0.0085)
    across = float(np.clip(along * rng.uniform(0.9, 2.0), 0.005, 0.014))
    high, low = tall * rng.uniform(0.74, 0.92), tall * rng.uniform(0.15, 0.36)
    along = min(along, 0.12 * (high - low))
    low, high = max(low, 2 * along + 0.002), min(high, tall - 1.6 * along)
    shape = str(rng.choice(["round", "d", "ear", "square"], p=[0.35, 0.25, 0.28, 0.12]))
    reach = rng.uniform(0.026, 0.045) + along
    return loop_handle(rng, shape, (height, radius), np.array([low, high]), reach=reach, along=along, across=across)


TEAPOT = Family(
    "teapot",
    _make,
    "household",
    spec={"alike": ("kettle", "pitcher"), "optional_parts": ()},
    variants={"beak": {}},
    members=120,
)
