"""Bottles: a body, a shoulder, a neck and what closes it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from gfp_grasp.shapes import caps
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.handles import even_path, half_loop
from gfp_grasp.shapes.loft import inset, loft, rounded_off, rows, smooth_noise, smoothstep, sweep, unite

_GRID = 200
_KINDS = {
    "screw": 0.26, "nozzle": 0.09, "sports": 0.08, "flip_top": 0.12, "cap_down": 0.09, "jar": 0.08,
    "pump": 0.07, "spray": 0.06, "jug": 0.06, "open": 0.09,
}  # fmt: skip
_HEIGHTS_M = {
    "jar": (0.06, 0.14),
    "pump": (0.09, 0.18),
    "jug": (0.18, 0.29),
    "spray": (0.13, 0.22),
    "flip_top": (0.1, 0.23),
}
# Half-width over the height of the body, before the neck is added.
_SLENDER = {"jar": (0.26, 0.5), "jug": (0.2, 0.32), "pump": (0.15, 0.34), "spray": (0.13, 0.24)}


@dataclass(frozen=True)
class Plan:
    """Sizes that the pieces of one bottle share, m: body height and half-width, neck base, its half-width."""

    body: float
    half: float
    neck: float
    neck_half: float
    aspect: float
    power: float


def _make(rng: np.random.Generator) -> Made:
    """One bottle; a closed one is a solid, its wall is zero."""
    kind = draw_kind(rng, _KINDS)
    plan = _plan(rng, kind)
    mesh, wall = _assembled(rng, kind, plan)
    if kind not in ("cap_down", "open"):
        _lean(rng, mesh, plan, kind)
    return Made(mesh, kind, wall)


def _assembled(rng: np.random.Generator, kind: str, plan: Plan) -> tuple[trimesh.Trimesh, float]:
    """The bottle, and its wall m."""
    body = body_rings(rng, plan)
    if kind == "cap_down":
        return _cap_down(rng, body), 0.0
    if kind in ("flip_top", "jar"):
        return loft(np.concatenate([foot_rings(rng, body), body, caps.wide(rng, body[-1], jar=kind == "jar")])), 0.0
    plan = replace(plan, neck_half=min(plan.neck_half, 0.92 * float(body[-1, :2].min())))
    rising = np.concatenate([body, shoulder_rings(rng, plan, body[-1])])
    if kind == "open":
        return _open(rng, plan, rising)
    top, extras = caps.CAPS[kind](rng, plan.neck_half, float(rising[-1, 2]))
    mesh = loft(np.concatenate([foot_rings(rng, body), rising, top]))
    if kind == "jug":
        extras = [_jug_handle(rng, plan, rising)]
    return (unite([mesh, *extras]) if extras else mesh), 0.0


def _lean(rng: np.random.Generator, mesh: trimesh.Trimesh, plan: Plan, kind: str) -> None:
    """A slanted top, or a neck beside the middle: both slide the upper part along, so nothing can cross."""
    vertices = np.array(mesh.vertices)
    top = float(vertices[:, 2].max())
    if kind == "flip_top" and rng.random() < 0.3:
        share = smoothstep((vertices[:, 2] - 0.55 * top) / (0.4 * top))
        vertices[:, 2] += rng.uniform(-0.35, 0.35) * share * vertices[:, 0]
    elif kind in ("jug", "screw", "spray") and plan.aspect < 0.97 and rng.random() < 0.3:
        share = smoothstep((vertices[:, 2] - 0.5 * plan.body) / (plan.neck - 0.5 * plan.body))
        vertices[:, 0] += (-1 if kind == "jug" else rng.choice([-1, 1])) * rng.uniform(0.1, 0.4) * plan.half * share
    mesh.vertices = vertices


def _plan(rng: np.random.Generator, kind: str) -> Plan:
    tall = rng.uniform(*_HEIGHTS_M.get(kind, (0.1, 0.31)))
    half = float(np.clip(tall * rng.uniform(*_SLENDER.get(kind, (0.11, 0.26))), 0.016, 0.065))
    section = rng.choice(["round", "oval", "rectangular"], p=[0.9, 0.02, 0.08] if kind == "jar" else [0.46, 0.28, 0.26])
    aspect = 1.0 if section == "round" else float(rng.uniform(0.42, 1.0 if section == "rectangular" else 0.9))
    power = float(rng.uniform(3.0, 8.0)) if section == "rectangular" else float(rng.uniform(2.0, 2.5))
    power = 2.0 if section == "round" else power
    if section != "round":
        half = min(half * rng.uniform(1.0, 1.25), 0.06)
    thin = half * aspect
    neck_half = float(np.clip(rng.choice([rng.uniform(0.25, 0.5), rng.uniform(0.45, 0.85)]) * thin, 0.008, 0.9 * thin))
    shoulder = rng.choice(
        [rng.uniform(0.03, 0.12), rng.uniform(0.1, 0.3), rng.uniform(0.25, 0.45)], p=[0.35, 0.4, 0.25]
    )
    if kind in ("pump", "spray"):
        # Dispensers come in a few thread sizes only.
        neck_half = float(np.clip(neck_half, 0.009, min(0.016, 0.9 * thin)))
    low = 0.92 if kind in ("flip_top", "jar", "cap_down") else 1 - shoulder - 0.08
    return Plan(tall * low, half, tall * (low + shoulder), neck_half, aspect, power)


def body_rings(rng: np.random.Generator, plan: Plan) -> np.ndarray:
    """Rings from the base, whose edge is rounded, to the shoulder."""
    t = np.linspace(0, 1, _GRID)
    curve = 1 + (rng.choice([0.0, rng.uniform(-0.35, 0.25), rng.normal(0, 0.08)]) * (t - 0.5))
    if rng.random() < 0.25:
        depth, place, spread = rng.uniform(0.05, 0.28), rng.uniform(0.3, 0.75), rng.uniform(0.1, 0.3)
        curve = curve - depth * np.exp(-(((t - place) / spread) ** 2))
    if rng.random() < 0.2:
        curve = curve + rng.uniform(0.05, 0.25) * np.sin(np.pi * t)
    curve = curve + smooth_noise(rng, t, amplitude=rng.choice([0.0, 0.012, 0.03]), knots=int(rng.integers(4, 8)))
    if rng.random() < 0.12:
        curve = curve - rng.uniform(0.01, 0.03) * _grooves(rng, t)
    radius, height = plan.half * curve / curve.max(), t * plan.body
    aspect = plan.aspect * (1 + (plan.aspect < 0.97) * smooth_noise(rng, t, amplitude=0.03, knots=4))
    if plan.aspect < 0.97 and rng.random() < 0.3:
        # Pinched for the hand across one side only, as flat sauce bottles are.
        place, spread = rng.uniform(0.4, 0.75), rng.uniform(0.08, 0.22)
        pinch = rng.uniform(0.08, 0.3) * np.exp(-(((t - place) / spread) ** 2))
        if rng.random() < 0.6:
            radius, aspect = radius * (1 - pinch), aspect / (1 - pinch)
        else:
            aspect = aspect * (1 - pinch)
    aspect = np.clip(aspect, 0.35, 1.0)
    edge = min(
        float(rng.choice([rng.uniform(0.001, 0.004), rng.uniform(0.004, 0.014)])), 0.4 * float((radius * aspect).min())
    )
    cut = rounded_off(height, edge, edge)
    return np.stack([radius - cut, radius * aspect - cut, height, np.full(_GRID, plan.power)], axis=1)


def _grooves(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Ribs around a water bottle: 0 to 1 over part of the height."""
    low, high = np.sort(rng.uniform(0.1, 0.95, 2))
    window = smoothstep((t - low) / 0.05) * smoothstep((high - t) / 0.05)
    return window * (1 - np.cos(2 * np.pi * t * rng.integers(6, 14))) / 2


def foot_rings(rng: np.random.Generator, body: np.ndarray) -> np.ndarray:
    """The underside: flat or dented."""
    dent = rng.uniform(0.001, 0.006) if rng.random() < 0.6 else 0.0
    first = body[0]
    if dent == 0:
        return rows([1e-6], [0.0])
    ring = np.repeat(first[None], 3, axis=0)
    ring[:, :2] *= np.array([0.45, 0.75, 0.88])[:, None]
    ring[:, 2] = np.array([1.0, 0.7, 0.0]) * dent
    return np.concatenate([rows([1e-6], [dent]), ring])


def shoulder_rings(rng: np.random.Generator, plan: Plan, last: np.ndarray) -> np.ndarray:
    """Rings from the top of the body to the neck's base; the section turns round on the way."""
    t = np.linspace(0, 1, 70)[1:]
    if rng.random() < 0.3:
        drop = smoothstep(t ** rng.uniform(0.7, 1.4))
    else:
        p, q = rng.uniform(1.0, 3.0), rng.uniform(1.0, 2.6)
        drop = 1 - (1 - t**p) ** (1 / q)
    drop = 0.12 * t + 0.88 * drop
    x = last[0] + (plan.neck_half - last[0]) * drop
    y = last[1] + (plan.neck_half - last[1]) * drop
    power = last[3] + (2.0 - last[3]) * smoothstep(drop)
    return np.stack([x, y, last[2] + (plan.neck - plan.body) * t, power], axis=1)


def _open(rng: np.random.Generator, plan: Plan, rising: np.ndarray) -> tuple[trimesh.Trimesh, float]:
    """A hollow bottle without a cap: neck with its rings, and the whole cavity."""
    wall, neck = (
        rng.uniform(0.0011, 0.0025),
        rng.uniform(0.008, 0.06) if plan.neck_half < 0.016 else rng.uniform(0.006, 0.02),
    )
    height = np.arange(1, int(neck / 0.0004)) * 0.0004 + rising[-1, 2]
    tube = rows(np.full(len(height), plan.neck_half), height)
    bare = np.concatenate([rising, tube])
    z = np.unique(np.concatenate([bare[:, 2], np.linspace(0, bare[-1, 2], 300)]))
    x, y, power = (np.interp(z, bare[:, 2], bare[:, i]) for i in (0, 1, 3))
    inner = np.stack([inset(x, z, wall), inset(y, z, wall), z, power], axis=1)
    floor = rng.uniform(1.5, 3.0) * wall
    foot = foot_rings(rng, rising)
    inner = inner[z > foot[0, 2] + floor][::-1]
    from_top = bare[-1, 2] - height
    size = rng.uniform(0.0008, 0.002)
    bead = size * (np.exp(-(((from_top - 0.002) / 0.0012) ** 2)) + np.exp(-(((from_top - 0.6 * neck) / 0.0012) ** 2)))
    tube[:, :2] += bead[:, None]
    turn = np.linspace(0, np.pi, 8)[1:-1, None]
    rim = (tube[-1] + inner[0]) / 2 + (tube[-1] - inner[0]) / 2 * np.cos(turn)
    rim[:, 2] = tube[-1, 2] + 0.4 * wall * np.sin(turn[:, 0])
    return loft(np.concatenate([foot, rising, tube, rim, inner, rows([1e-6], inner[-1:, 2])])), float(wall)


def _cap_down(rng: np.random.Generator, body: np.ndarray) -> trimesh.Trimesh:
    """Standing on its wide cap, as ketchup and shower gel do: cap, body widening upwards, closed and rounded top."""
    cap = caps.standing(rng, body[-1])
    lift, top = cap[-1, 2], body[-1, 2]
    turned = body[::-1].copy()
    turned[:, 2] = lift + top - turned[:, 2]
    edge = rng.uniform(0.2, 0.9) * min(turned[-1, 0], turned[-1, 1])
    turn = np.linspace(0, np.pi / 2, 24)[1:-1, None]
    crown = np.repeat(turned[-1][None], len(turn), axis=0)
    crown[:, :2] *= 0.35 + 0.65 * np.cos(turn)
    crown[:, 2] += 0.5 * edge * np.sin(turn[:, 0])
    return loft(np.concatenate([cap, turned, crown, rows([1e-6], crown[-1:, 2])]))


def _jug_handle(rng: np.random.Generator, plan: Plan, rising: np.ndarray) -> trimesh.Trimesh:
    """A grip from the shoulder to the middle of the body, towards +x."""
    along, across = rng.uniform(0.006, 0.011), rng.uniform(0.009, 0.014)
    low, high = plan.body * rng.uniform(0.35, 0.6), plan.body + rng.uniform(0.2, 0.7) * (plan.neck - plan.body)
    reach = rng.uniform(0.024, 0.034) + along
    up, out = half_loop(rng.uniform(2.0, 3.5), 50)
    z = (low + high) / 2 + up * (high - low) / 2
    ends = np.interp([low, high], rising[:, 2], rising[:, 0])
    x = reach * out + np.interp(z, [low, high], ends)
    plane = np.concatenate([[[0.4 * ends.min(), low]], np.stack([x, z], axis=1), [[0.4 * ends.min(), high]]])
    return sweep(even_path(plane, 40), np.full(40, across), np.full(40, along), power=2.5, segments=24)


BOTTLE = Family(
    "bottle",
    _make,
    "household",
    spec={"names": {"modelnet": ("bottle",), "shapenet": ("02876657",)}},
    variants={"jug": {}, "spray": {}},
    also={"jar": ("jar",), "spray": ("spray_bottle",)},
    members=120,
)
