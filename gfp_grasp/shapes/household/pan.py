"""Pans: frying pans, skillets, woks and grill pans with one long handle towards +x."""

from __future__ import annotations

import numpy as np

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.grafts import PATCH_ROWS, SEGMENTS, with_long_handle
from gfp_grasp.shapes.handles import long_handle
from gfp_grasp.shapes.household.cup import GRID, lip
from gfp_grasp.shapes.loft import rounded_off
from gfp_grasp.shapes.matched import space_discs
from gfp_grasp.shapes.vessel import Vessel

_KINDS = {"frying": 0.52, "skillet": 0.2, "wok": 0.15, "grill": 0.13}
# Rings of a disc, and of the underside, of the side below, at and above the handle, of the rim, the inside, the floor.
_DISC = 12
_RINGS = (_DISC, 14, PATCH_ROWS, 5, 4, 16, _DISC)


def _make(rng: np.random.Generator) -> Made:
    """One pan; a hole for hanging at the end of the handle is left out, so that all have one topology."""
    kind = draw_kind(rng, _KINDS)
    vessel = _vessel(rng, kind)
    tall = float(vessel.height[-1])
    along = rng.uniform(0.004, 0.0085)
    lowest = vessel.floor + along + 0.002
    at = max(tall - along - 0.003 - rng.uniform(0.0, 0.35) * tall, lowest)
    length = rng.uniform(0.14, 0.16) if kind == "skillet" else rng.uniform(0.14, 0.235)
    handle = long_handle(rng, length=length, along=along, across=rng.uniform(0.008, 0.0165))
    # A pan does not stand on a handle that hangs down.
    hangs = float((handle.along - handle.path[:, 2]).max())
    at = max(at, min(hangs + 0.001, tall - along - 0.001))
    body = vessel.matched_mesh(_RINGS, breaks_m=(at - handle.along[0], at + handle.along[0]))
    space_discs(body, _DISC, segments=SEGMENTS, floor=True)
    power = float(np.max(vessel.power))
    return Made(with_long_handle(body, _RINGS, handle, power=power), kind, vessel.wall)


def _vessel(rng: np.random.Generator, kind: str) -> Vessel:
    half = {"frying": (0.08, 0.165), "skillet": (0.075, 0.16), "wok": (0.13, 0.18), "grill": (0.11, 0.145)}[kind]
    half = rng.uniform(*half)
    tall = half * rng.uniform(0.45, 0.62) if kind == "wok" else rng.uniform(0.03, 0.065)
    height = np.linspace(0, tall, GRID)
    t = height / tall
    # The side from the edge of the floor to the rim: steep with a rounded foot, or sloping all the way.
    if kind == "wok":
        base, bend = rng.uniform(0.25, 0.5), rng.uniform(1.6, 2.4)
    else:
        base = rng.uniform(0.88, 0.98) if kind in ("skillet", "grill") else rng.uniform(0.66, 0.88)
        bend = rng.uniform(1.2, 3.0)
    radius = half * (base + (1 - base) * (1 - (1 - t) ** bend) ** (1 / rng.uniform(1.0, 1.4)))
    if kind == "frying" and rng.random() < 0.4:
        radius = radius + half * rng.uniform(0.01, 0.05) * t**4
    edge = min(rng.uniform(0.002, 0.012), 0.3 * tall)
    radius = radius - rounded_off(height, edge, edge)
    wall = rng.uniform(0.003, 0.006) if kind in ("skillet", "grill") else rng.uniform(0.0012, 0.0042)
    extra = lip(rng, height) if rng.random() < 0.35 else 0.0
    power, size = (rng.uniform(4.0, 8.0), 0.92) if kind == "grill" else (2.0, 1.0)
    floor = wall * rng.uniform(1.0, 1.6)
    return Vessel(height, size * radius, wall, floor, extra, power=power, segments=SEGMENTS)


PAN = Family(
    "pan",
    _make,
    "household",
    spec={"alike": ("pot", "bowl"), "optional_parts": (), "density_kg_m3": (1800.0, 7500.0)},
    members=120,
)
