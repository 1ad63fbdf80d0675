"""Pitchers: jugs with a handle towards +x and a pouring lip towards -x, open, or under a lid."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.handles import loop_handle
from gfp_grasp.shapes.household.cup import GRID, base_rounding, lip
from gfp_grasp.shapes.lids import lid, sunk_lid, under_lid
from gfp_grasp.shapes.loft import smooth_noise, smoothstep, subtract, unite
from gfp_grasp.shapes.spouts import Beak, beaked
from gfp_grasp.shapes.vessel import Vessel

_KINDS = {"straight": 0.38, "bellied": 0.24, "waisted": 0.12, "lidded": 0.26}
_SEGMENTS = 56
_LIP = Beak(out=(0.08, 0.4), below=(0.1, 0.3), rise=(-0.1, 0.5), width=(0.35, 0.6))
_LIP_UNDER_LID = replace(_LIP, rise=(0.0, 0.0), within=0.8)


def _make(rng: np.random.Generator) -> Made:
    """One pitcher; a lidded one is a solid, its wall is zero."""
    kind = draw_kind(rng, _KINDS)
    height, radius = _side(rng, kind)
    handle = _handle(rng, height, radius)
    if kind == "lidded":
        body = _lidded(rng, height, radius)
        return Made(unite([body, handle]), kind)
    vessel = _open(rng, height, radius)
    body = vessel.mesh()
    body.vertices = beaked(rng, np.asarray(body.vertices), float(height[-1]), float(radius[-1]), _LIP)
    return Made(unite([body, subtract(handle, vessel.core(0.5))]), kind, vessel.wall)


def _side(rng: np.random.Generator, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Heights and radius (n,) m of the outer side."""
    tall = rng.uniform(0.19, 0.28) if kind == "lidded" else rng.uniform(0.11, 0.27)
    half = float(np.clip(tall * rng.uniform(0.24, 0.42), 0.04, 0.085))
    height = np.linspace(0, tall, GRID)
    t = height / tall
    if kind == "bellied":
        belly, neck = rng.uniform(0.25, 0.45), rng.uniform(0.72, 0.9)
        curve = 0.7 + 0.3 * np.sin(np.pi * np.clip(t / (2 * belly), 0, 0.5))
        narrow = rng.uniform(0.15, 0.4)
        curve = curve - narrow * smoothstep((t - belly) / (neck - belly))
        curve = curve + rng.uniform(0.0, 0.8) * narrow * smoothstep((t - neck) / (1.02 - neck))
    elif kind == "waisted":
        curve = 1 - rng.uniform(0.08, 0.25) * np.exp(-(((t - rng.uniform(0.45, 0.8)) / rng.uniform(0.15, 0.3)) ** 2))
    else:
        curve = 1 + rng.choice([rng.uniform(0.05, 0.4), rng.normal(0.0, 0.08)]) * (t - 0.5)
        curve = curve + rng.choice([0.0, rng.uniform(0.02, 0.15)]) * np.sin(np.pi * t)
    curve = curve + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.01, 0.02]), knots=int(rng.integers(4, 7)))
    radius = half * curve / curve.max()
    return height, radius - base_rounding(rng, height, radius, bowl=0.15)


def _open(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray) -> Vessel:
    wall = float(np.exp(rng.uniform(np.log(0.0016), np.log(0.0055))))
    extra = lip(rng, height) if rng.random() < 0.3 else 0.0
    dent = rng.uniform(0.001, 0.004) if rng.random() < 0.5 else 0.0
    floor = dent + wall * rng.uniform(1.0, 1.8)
    return Vessel(height, radius, wall, floor, extra, dent=dent, segments=_SEGMENTS)


def _lidded(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray) -> trimesh.Trimesh:
    """The closed body: what is under the lid is out of sight."""
    top, rim = float(height[-1]), float(radius[-1])
    if rng.random() < 0.6:
        cover = sunk_lid(rng, rim, top)
    else:
        knob = rng.choice([0.0, rng.uniform(0.008, 0.016)])
        cover = lid(rng, rim, top, dome=rng.uniform(0.003, 0.025), knob=knob, over=rng.uniform(-0.006, 0.002))
    body = under_lid(height, radius, cover, segments=_SEGMENTS)
    body.vertices = beaked(rng, np.asarray(body.vertices), top, rim, _LIP_UNDER_LID)
    return body


def _handle(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray) -> trimesh.Trimesh:
    tall = float(height[-1])
    along = rng.uniform(0.004, 0.0095)
    across = float(np.clip(along * rng.uniform(0.9, 2.2), 0.005, 0.016))
    high = tall * rng.uniform(0.78, 0.97) - 1.5 * along - 0.003
    low = max(tall * rng.uniform(0.12, 0.42), 2 * along + 0.003)
    low = min(low, high - 0.055 - 2 * along)
    low = max(low, 2 * along + 0.002)
    kind = str(rng.choice(["round", "d", "ear", "square"], p=[0.25, 0.35, 0.25, 0.15]))
    reach = rng.uniform(0.026, 0.048) + along
    return loop_handle(rng, kind, (height, radius), np.array([low, high]), reach=reach, along=along, across=across)


PITCHER = Family(
    "pitcher",
    _make,
    "household",
    spec={"alike": ("mug", "vase"), "optional_parts": ()},
    variants={"lidded": {"hollow": False}},
    members=120,
)
