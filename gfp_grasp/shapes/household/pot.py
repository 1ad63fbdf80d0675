"""Cooking pots: stock pots to casseroles with two ears, open or with their lid, and saucepans with a long handle."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.grafts import PATCH_ROWS, SEGMENTS, with_ears, with_long_handle
from gfp_grasp.shapes.handles import long_handle
from gfp_grasp.shapes.household.cup import GRID, lip
from gfp_grasp.shapes.lids import knobbed
from gfp_grasp.shapes.loft import rounded_off, rows
from gfp_grasp.shapes.matched import matched, space_discs
from gfp_grasp.shapes.vessel import Vessel

_KINDS = {"open": 0.68, "lidded": 0.18, "saucepan": 0.14}
# Rings of a disc, as the underside and the floor are, and of the underside, of the side below, at and above the ears.
_DISC = 12
_SIDE = (_DISC, 18, PATCH_ROWS, 6)
_RINGS = (*_SIDE, 5, 16, _DISC)
_FIRST_ROW = _SIDE[0] + _SIDE[1] - 1
# Between the ears or a handle and the rim.
_BELOW_RIM_M = 0.004


def _make(rng: np.random.Generator) -> Made:
    """One pot; a lidded one is a solid, its wall is zero."""
    kind = draw_kind(rng, _KINDS)
    height, radius = _side(rng, kind)
    if kind == "saucepan":
        vessel = _open(rng, height, radius, 1.0)
        return Made(_with_handle(rng, vessel), kind, vessel.wall)
    tall, half = float(height[-1]), float(radius.max())
    # Roasters and terrines are low and oval.
    oval = tall < 1.1 * half and rng.random() < 0.25
    aspect = float(rng.uniform(0.65, 0.92)) if oval else 1.0
    across = rng.uniform(0.0035, 0.0085)
    at = tall - across - _BELOW_RIM_M - max(0.006, tall * rng.uniform(0.0, 0.35))
    breaks = (at - across, at + across)
    if kind == "lidded":
        return Made(_eared(rng, _closed(rng, height, radius, aspect, breaks), half * aspect, across), kind)
    vessel = _open(rng, height, radius, aspect)
    return Made(_eared(rng, _body(vessel, breaks), half * aspect, across), kind, vessel.wall)


def _side(rng: np.random.Generator, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Heights and radius (n,) m of the outer side: straight, or a little wider at the top or in the middle."""
    half = rng.uniform(0.062, 0.11) if kind == "saucepan" else rng.uniform(0.075, 0.165)
    slim = rng.uniform(0.7, 1.4) if kind == "saucepan" else rng.choice([rng.uniform(0.5, 1.1), rng.uniform(1.0, 2.0)])
    height = np.linspace(0, float(np.clip(half * slim, 0.055, 0.27)), GRID)
    t = height / height[-1]
    curve = 1 + rng.choice([0.0, rng.uniform(0.0, 0.18)]) * (t - 1)
    curve = curve + rng.choice([0.0, rng.uniform(0.01, 0.09)], p=[0.65, 0.35]) * np.sin(np.pi * t)
    edge = min(rng.uniform(0.002, 0.03), 0.35 * float(height[-1]))
    return height, half * curve / curve.max() - rounded_off(height, edge, edge)


def _open(rng: np.random.Generator, height: np.ndarray, radius: np.ndarray, aspect: float) -> Vessel:
    # Sheet metal, or cast iron and stoneware.
    wall = rng.choice([rng.uniform(0.0011, 0.0025), rng.uniform(0.0025, 0.006)], p=[0.7, 0.3])
    extra = lip(rng, height) if rng.random() < 0.5 else 0.0
    return Vessel(height, radius, float(wall), float(wall) * rng.uniform(1.0, 2.5), extra, aspect, segments=SEGMENTS)


def _body(vessel: Vessel, breaks: tuple[float, float]) -> trimesh.Trimesh:
    body = vessel.matched_mesh(_RINGS, breaks_m=breaks)
    space_discs(body, _DISC, segments=SEGMENTS, floor=True)
    return body


def _closed(
    rng: np.random.Generator, height: np.ndarray, radius: np.ndarray, aspect: float, breaks: tuple[float, float]
) -> trimesh.Trimesh:
    """The body under its lid, whose knob stays round, whatever the body is."""
    rim = float(radius[-1])
    dome = rim * rng.choice([rng.uniform(0.03, 0.15), rng.uniform(0.15, 0.42)])
    knob = float(np.clip(rim * rng.uniform(0.13, 0.24), 0.012, 0.028))
    cover, top = knobbed(rng, rim, float(height[-1]), dome=dome, knob=knob, over=rng.uniform(0.0, 0.004))
    side = rows(radius, height, aspect=aspect)
    low, high = np.searchsorted(height, breaks)
    stretches = [side[: low + 1], side[low : high + 1], side[high:]]
    lid = rows(cover[:, 0], cover[:, 1], aspect=np.where(cover[:, 0] > 1.8 * knob, aspect, 1.0))
    pieces = [np.concatenate([rows([1e-6], [0.0]), side[:1]]), *stretches, lid, rows(top[:, 0], top[:, 1])]
    body = matched(pieces, (*_SIDE, 17, 15), segments=SEGMENTS)
    space_discs(body, _DISC, segments=SEGMENTS, floor=False)
    return body


def _eared(rng: np.random.Generator, body: trimesh.Trimesh, depth: float, across: float) -> trimesh.Trimesh:
    half, along = float(np.clip(depth * rng.uniform(0.3, 0.45), 0.026, 0.055)), rng.uniform(0.003, 0.0075)
    return with_ears(
        body,
        _FIRST_ROW,
        half=half,
        reach=rng.uniform(0.024, 0.045),
        along=along,
        across=across,
        power=rng.uniform(2.1, 4.5),
        rise=rng.choice([0.0, rng.uniform(0.0, 0.5)]),
    )


def _with_handle(rng: np.random.Generator, vessel: Vessel) -> trimesh.Trimesh:
    along, tall = rng.uniform(0.004, 0.009), float(vessel.height[-1])
    at = tall - along - _BELOW_RIM_M - rng.uniform(0.0, 0.25) * tall
    handle = long_handle(rng, length=rng.uniform(0.13, 0.21), along=along, across=rng.uniform(0.009, 0.016))
    body = _body(vessel, (at - handle.along[0], at + handle.along[0]))
    return with_long_handle(body, _RINGS, handle)


POT = Family(
    "pot",
    _make,
    "household",
    spec={"alike": ("pan", "bowl"), "optional_parts": (), "density_kg_m3": (2000.0, 7900.0)},
    variants={"lidded": {"hollow": False, "density_kg_m3": (150.0, 1500.0)}, "saucepan": {}},
    members=120,
)
