"""Trigger sprayers: window cleaner, kitchen and garden sprayers, their head towards +x."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.caps import trigger_head
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.household.bottle import Plan, body_rings, foot_rings, shoulder_rings
from gfp_grasp.shapes.loft import loft, unite

_KINDS = {"conical": 0.4, "shouldered": 0.25, "oval": 0.25, "garden": 0.1}
# Share of the height of body and shoulder that is shoulder.
_SHOULDERS = {"conical": (0.3, 0.6), "shouldered": (0.06, 0.25), "oval": (0.1, 0.5), "garden": (0.3, 0.55)}


def _make(rng: np.random.Generator) -> Made:
    """One sprayer, closed and modelled as a solid; its kind is that of its body."""
    kind = draw_kind(rng, _KINDS)
    plan = _plan(rng, kind)
    body = body_rings(rng, plan)
    rising = np.concatenate([body, shoulder_rings(rng, plan, body[-1])])
    top, parts = trigger_head(rng, plan.neck_half, rising)
    mesh: trimesh.Trimesh = loft(np.concatenate([foot_rings(rng, body), rising, top]))
    return Made(unite([mesh, *parts]), kind)


def _plan(rng: np.random.Generator, kind: str) -> Plan:
    neck = rng.uniform(0.12, 0.245)
    shoulder = rng.uniform(*_SHOULDERS[kind])
    half = float(np.clip(neck * rng.uniform(0.17, 0.28), 0.026, 0.062 if kind == "garden" else 0.05))
    aspect, power = 1.0, 2.0
    if kind == "oval":
        aspect, power = rng.uniform(0.5, 0.9), rng.choice([2.2, rng.uniform(3.0, 6.0)])
        half = min(1.15 * half, 0.055)
    neck_half = min(rng.uniform(0.0105, 0.0145), 0.75 * half * aspect)
    return Plan(neck * (1 - shoulder), half, neck, neck_half, float(aspect), float(power))


SPRAY_BOTTLE = Family(
    "spray_bottle",
    _make,
    "household",
    spec={"alike": ("bottle",), "rests": {"upright": 0.93, "lying": 0.07}},
    members=120,
)
