"""Kettles: for the stove with a bail over the top, electric jugs, and faceted espresso makers."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.handles import bail, even_path, loop_handle
from gfp_grasp.shapes.lids import lid, sunk_lid, under_lid
from gfp_grasp.shapes.loft import rounded, smooth_noise, smoothstep, sweep, unite
from gfp_grasp.shapes.spouts import Beak, beaked, spout

_GRID = 160
_KINDS = {"stove": 0.66, "electric": 0.18, "moka": 0.16}
_SEGMENTS = 64
_BEAK = Beak(out=(0.25, 0.6), below=(0.12, 0.35), rise=(0.0, 0.3), width=(0.28, 0.5), within=0.9)


def _make(rng: np.random.Generator) -> Made:
    """One kettle, closed and modelled as a solid."""
    kind = draw_kind(rng, _KINDS)
    return Made(unite({"stove": _stove, "electric": _electric, "moka": _moka}[kind](rng)), kind)


def _stove(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A squat dome on a flat base, a short spout, and a bail that leaves the hand its room above the lid."""
    half = rng.uniform(0.08, 0.118)
    height = np.linspace(0, half * rng.uniform(0.95, 1.6), _GRID)
    t, tall = height / height[-1], float(height[-1])
    mouth, widest, power = rng.uniform(0.42, 0.68), rng.uniform(0.06, 0.35), rng.uniform(1.3, 2.8)
    curve = 1 - (1 - mouth) * np.clip((t - widest) / (1 - widest), 0, 1) ** power
    curve = curve - rng.uniform(0.02, 0.15) * np.clip(1 - t / widest, 0, 1) ** 2
    radius = half * (curve + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.01]), knots=5))
    rim = float(radius[-1])
    knob = float(np.clip(rim * rng.uniform(0.2, 0.34), 0.009, 0.018))
    cover = lid(rng, rim, tall, dome=rim * rng.uniform(0.1, 0.4), knob=knob, over=rim * rng.uniform(-0.08, 0.04))
    low = tall * rng.uniform(0.42, 0.65)
    side = float(np.interp(low, height, radius))
    thin = rng.uniform(0.008, 0.014)
    tip = side + rng.uniform(0.022, 0.05), min(low + rng.uniform(0.03, 0.075), 1.1 * tall)
    pour = spout(rng, (0.5 * side, low - 0.01), tip, thick=thin * rng.uniform(1.3, 1.9), thin=thin)
    foot = tall * rng.uniform(0.7, 0.92)
    high = float(cover[:, 1].max()) + rng.uniform(0.032, 0.065)
    arch = bail(
        rng,
        float(np.interp(foot, height, radius)) * rng.uniform(0.86, 0.96),
        foot - 0.006,
        high,
        along=rng.uniform(0.0035, 0.008),
        across=rng.uniform(0.007, 0.0135),
    )
    return [under_lid(height, radius, cover, segments=_SEGMENTS), pour, arch]


def _electric(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A tall jug on its base plate, with a beak at the rim and a thick handle."""
    half = rng.uniform(0.065, 0.09)
    height = np.linspace(0, half * rng.uniform(2.0, 2.9), _GRID)
    t, tall = height / height[-1], float(height[-1])
    curve = 1 - rng.uniform(0.0, 0.4) * t ** rng.uniform(0.8, 1.8)
    curve = curve + rng.choice([0.0, rng.uniform(0.02, 0.15)]) * np.sin(np.pi * t)
    radius = half * curve / curve.max()
    plate = rng.uniform(0.015, 0.03)
    # The joint between the kettle and its plate.
    radius = radius - rng.uniform(0.0008, 0.004) * np.exp(-(((height - plate) / 0.0025) ** 2))
    rim = float(radius[-1])
    if rng.random() < 0.4:
        cover = sunk_lid(rng, rim, tall)
    else:
        knob = rng.choice([0.0, rng.uniform(0.008, 0.014)])
        cover = lid(rng, rim, tall, dome=rng.uniform(0.004, 0.03), knob=knob, over=-rng.uniform(0.001, 0.006))
    body = under_lid(height, radius, cover, segments=_SEGMENTS)
    body.vertices = beaked(rng, np.asarray(body.vertices), tall, rim, _BEAK)
    along, across = rng.uniform(0.007, 0.013), rng.uniform(0.01, 0.018)
    heights = np.array([tall * rng.uniform(0.12, 0.35), tall * rng.uniform(0.8, 0.96) - along])
    shape = str(rng.choice(["d", "ear", "square"], p=[0.4, 0.3, 0.3]))
    reach = rng.uniform(0.034, 0.05) + along
    return [body, loop_handle(rng, shape, (height, radius), heights, reach=reach, along=along, across=across)]


def _moka(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A boiler that narrows to a waist, a faceted jug above it, and a handle that hangs from the top."""
    half = rng.uniform(0.03, 0.058)
    tall = half * rng.uniform(2.5, 3.3)
    waist, narrow = rng.uniform(0.42, 0.54), rng.uniform(0.62, 0.78)
    ring = narrow + rng.uniform(0.02, 0.12)
    top = rng.uniform(0.85, 1.1)
    profile = rounded(
        [[1.0, 0], [narrow, waist - 0.04], [ring, waist - 0.03], [ring, waist + 0.03], [narrow, waist + 0.04],
         [top, 0.97], [top, 1.0]],
        [0, 0.01, 0.01, 0.01, 0.01, 0.02, 0],
    )  # fmt: skip
    radius, height = half * profile[:, 0], tall * profile[:, 1]
    rim = float(radius[-1])
    knob = rim * rng.uniform(0.13, 0.22)
    cover = lid(rng, rim, tall, dome=rim * rng.uniform(0.08, 0.35), knob=knob, over=-rim * rng.uniform(0.01, 0.05))
    facets = int(rng.choice([8, 10, 12], p=[0.75, 0.15, 0.1])) if rng.random() < 0.85 else 0
    body = under_lid(height, radius, cover, segments=6 * facets if facets else 48)
    vertices = _faceted(np.asarray(body.vertices), facets, 1.4 * knob) if facets else np.asarray(body.vertices)
    body.vertices = beaked(rng, vertices, tall, rim, _BEAK)
    return [body, _hanging_handle(rng, rim, tall, half)]


def _faceted(vertices: np.ndarray, facets: int, within: float) -> np.ndarray:
    """The round body with so many flat sides; its knob of radius `within` stays round."""
    reach = np.hypot(vertices[:, 0], vertices[:, 1])
    turn = np.mod(np.arctan2(vertices[:, 1], vertices[:, 0]), 2 * np.pi / facets) - np.pi / facets
    share = smoothstep((reach - within) / (0.5 * within))
    scale = 1 + share * (np.cos(np.pi / facets) / np.cos(turn) - 1)
    return vertices * np.stack([scale, scale, np.ones_like(scale)], axis=1)


def _hanging_handle(rng: np.random.Generator, rim: float, tall: float, half: float) -> trimesh.Trimesh:
    """A grip that goes out from the rim and down, and ends freely."""
    along, across = half * rng.uniform(0.11, 0.17), half * rng.uniform(0.12, 0.2)
    out, drop = half * rng.uniform(0.65, 1.0), tall * rng.uniform(0.3, 0.48)
    z = tall * 0.97 - along
    corner, end = rim + out, rim + out * rng.uniform(0.55, 0.95)
    up = rng.uniform(0.0, 0.12) * half
    plane = rounded(
        [[0.6 * rim, z], [corner, z + up], [end, z - drop]], [0, 1.8 * along + half * rng.uniform(0.0, 0.4), 0]
    )
    path = even_path(plane, 36)
    t = np.linspace(0, 1, 36)
    swell = 0.85 + 0.3 * smoothstep((t - 0.3) / 0.4) - 0.3 * smoothstep((t - 0.9) / 0.1)
    return sweep(path, across * swell, along * swell, power=rng.choice([2.4, 4.0]), segments=20)


KETTLE = Family(
    "kettle",
    _make,
    "household",
    spec={"alike": ("teapot", "pitcher"), "optional_parts": ()},
    variants={"electric": {}, "moka": {}},
    members=120,
)
