"""Mugs: a cup's body and a handle towards +x."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.handles import loop_handle
from gfp_grasp.shapes.household.cup import GRID, base_rounding, lip, side
from gfp_grasp.shapes.loft import subtract, unite
from gfp_grasp.shapes.vessel import Vessel

_HANDLES = {"round": 0.34, "d": 0.26, "ear": 0.24, "square": 0.16}
_BODIES = {"straight": 0.45, "tapered": 0.2, "bulged": 0.25, "square": 0.1}


def _make(rng: np.random.Generator) -> Made:
    """One mug; its kind is that of its handle."""
    kind = draw_kind(rng, _HANDLES)
    vessel = _body(rng)
    # Cut off half way into the wall, the handle can neither poke into the cavity nor lie flush with a surface.
    handle = subtract(_handle(rng, vessel, kind), vessel.core(0.5))
    return Made(unite([vessel.mesh(), handle]), kind, vessel.wall)


def _body(rng: np.random.Generator) -> Vessel:
    kind = draw_kind(rng, _BODIES)
    tall = rng.uniform(0.07, 0.128)
    half = np.clip(tall * rng.uniform(0.32, 0.62), 0.03, 0.053)
    height = np.linspace(0, tall, GRID)
    radius = half * side(rng, height / tall, kind)
    if rng.random() < 0.12:
        radius = radius[::-1].copy()
    radius = radius - base_rounding(rng, height, radius, bowl=0.12)
    wall = rng.uniform(0.0018, 0.006)
    power = rng.uniform(3.0, 6.0) if kind == "square" else 2.0
    extra = lip(rng, height) if rng.random() < 0.2 else 0.0
    dent = rng.uniform(0.001, 0.003) if rng.random() < 0.5 else 0.0
    floor = dent + wall * rng.uniform(1.0, 1.8)
    return Vessel(height, radius * (0.9 if kind == "square" else 1.0), wall, floor, extra, 1.0, power, dent)


def _handle(rng: np.random.Generator, vessel: Vessel, kind: str) -> trimesh.Trimesh:
    """A tube whose ends reach well into the body."""
    tall = float(vessel.height[-1])
    along = float(np.exp(rng.uniform(np.log(0.0024), np.log(0.0068))))
    across = float(np.clip(along * rng.uniform(0.9, 2.6), 0.0035, 0.011))
    span = np.clip(tall * rng.uniform(0.42, 0.78), 0.034 + 2 * along, tall - 4 * along - 0.006)
    low = rng.uniform(2 * along + 0.002, tall - span - 2 * along - 0.002)
    heights = np.array([low, low + span])
    reach = rng.uniform(0.02, 0.038) + along
    profile = vessel.height, vessel.radius
    return loop_handle(rng, kind, profile, heights, reach=reach, along=along, across=across)


MUG = Family(
    "mug",
    _make,
    "household",
    spec={"alike": ("cup", "glass"), "names": {"shapenet": ("03797390",)}},
    members=120,
)
