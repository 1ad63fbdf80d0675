"""Cartons of milk and juice: with a gable, or brick-shaped, with or without a screw cap; and cartons of eggs."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.blocks import block, lattice, patch_of
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import rounded, smoothstep
from gfp_grasp.shapes.patches import with_cap

_KINDS = {"gable": 0.62, "brick": 0.28, "egg": 0.1}
_OFF_EDGE = 0.0015  # m, from a cap to the edges of its side
_FOIL = 0.0003  # m, thickness of a seal


def _make(rng: np.random.Generator) -> Made:
    """One carton, closed and modelled as a solid; all with a gable have equal faces, and all bricks."""
    kind = draw_kind(rng, _KINDS)
    return Made({"gable": _gable, "brick": _brick, "egg": _egg}[kind](rng), kind)


def _gable(rng: np.random.Generator) -> trimesh.Trimesh:
    """A body, two slopes that meet below a fin along x, and gusset sides that are folded in between them.

    Half of them have a cap on the slope towards +y, the others a seal.
    """
    half_x = rng.uniform(0.027, 0.05)
    half_y = half_x * rng.uniform(0.8, 1.0)
    body = half_x * rng.uniform(2.2, 4.6)
    roof, fin = half_y * rng.uniform(0.55, 1.1), rng.uniform(0.01, 0.02)
    thin, fold = rng.uniform(0.0012, 0.0022), half_x * rng.uniform(0.1, 0.5)
    top = body + roof
    z = np.concatenate([np.linspace(0, body, 16), np.linspace(body, top, 7)[1:], np.linspace(top, top + fin, 4)[1:]])
    mesh = lattice(np.linspace(-half_x, half_x, 11), np.linspace(-half_y, half_y, 9), z)
    side = patch_of(mesh, (-half_x, half_y, body), (half_x, half_y, top))
    x, y, z = np.asarray(mesh.vertices).T
    climbed = np.clip((z - body) / roof, 0, 1)
    # The triangle of a gusset is deepest in its middle; its sides are the edges of the slopes.
    gusset = fold * climbed * (1 - np.clip((z - top) / (0.2 * fin), 0, 1)) * (1 - np.abs(y) / half_y) * 0.9
    narrow = (1 - climbed) * half_y + climbed * thin
    mesh.vertices = np.stack([x * (1 - gusset / half_x), y * narrow / half_y, z], axis=1)
    mesh.vertices = _bulged(rng, np.asarray(mesh.vertices), body)
    slope = float(np.hypot(half_y - thin, roof))
    if rng.random() < 0.5:
        at, cap = 0.5, _seal(0.25 * slope)
    else:
        at = rng.uniform(0.42, 0.55)
        radius = min(rng.uniform(0.011, 0.017), 0.42 * float(np.hypot(half_y, roof)), 0.6 * half_x)
        cap = _screw_cap(rng, radius, slope / 2 - _OFF_EDGE)
        at = _clear(at * slope, cap, slope) / slope
    return with_cap(mesh, side, (0, (1 - at) * half_y + at * thin, body + at * roof), cap)


def _brick(rng: np.random.Generator) -> trimesh.Trimesh:
    """From the little one with a straw to a litre and more; the top of some slants towards the cap."""
    half_x = rng.uniform(0.022, 0.05)
    half_y = half_x * rng.uniform(0.6, 1.0)
    tall = float(np.clip(half_x * rng.uniform(3.0, 5.2), 0.08, 0.25))
    rounding = rng.uniform(0.0006, 0.003)
    flat_x, flat_y = half_x - rounding, half_y - rounding
    mesh = block((2 * half_x, 2 * half_y, tall), rounding)
    top = patch_of(mesh, (-flat_x, -flat_y, tall), (flat_x, flat_y, tall))
    mesh.vertices = _bulged(rng, np.asarray(mesh.vertices), tall)
    if rng.random() < 0.45:
        slant, at, cap = 0.0, -0.3 * half_x, _seal(0.5 * half_y)
    else:
        slant = rng.choice([0.0, rng.uniform(0.1, 0.45)])
        radius = min(rng.uniform(0.01, 0.017), 0.55 * half_y)
        at = -rng.uniform(0.0, 0.9) * (half_x - 1.2 * radius)
        cap = _screw_cap(rng, radius, flat_y - _OFF_EDGE)
        at = _clear(at + flat_x, cap, 2 * flat_x) - flat_x
    upper = smoothstep(np.asarray(mesh.vertices)[:, 2] / tall * 2 - 1)
    mesh.vertices[:, 2] -= upper * slant * (half_x + mesh.vertices[:, 0])
    return with_cap(mesh, top, (at, 0, tall - slant * (half_x + at)), cap)


def _egg(rng: np.random.Generator) -> trimesh.Trimesh:
    """A closed box of moulded pulp for two rows of eggs: cups below, a lid with sloping sides above."""
    count = int(rng.choice([3, 5, 6]))
    pitch = rng.uniform(0.046, 0.052)
    half = np.array([count * pitch, 2 * pitch]) / 2 + 0.003
    tall, rim = rng.uniform(0.062, 0.078), rng.uniform(0.4, 0.6)
    x, y = (np.linspace(-h, h, n) for h, n in zip(half, (8 * count + 1, 17), strict=True))
    mesh = lattice(x, y, np.linspace(0, tall, 13))
    x, y, z = np.asarray(mesh.vertices).T
    away = np.abs(z / tall - rim) / np.where(z < rim * tall, rim, 1 - rim)
    shrink = 1 - away**1.1 * np.where(z < rim * tall, rng.uniform(0.1, 0.16), rng.uniform(0.06, 0.14))
    dent = np.sin(np.pi * (x + half[0]) / pitch) ** 2 * np.sin(np.pi * (y + half[1]) / pitch) ** 2
    between = rng.uniform(0.25, 0.45) * tall * (1 - np.clip(2 * dent, 0, 1)) * np.clip(1 - z / (rim * tall), 0, 1)
    inside = np.minimum(half[0] - np.abs(x), half[1] - np.abs(y)) / (0.5 * pitch)
    mesh.vertices = np.stack([x * shrink, y * shrink, z + between * np.clip(inside, 0, 1)], axis=1)
    return mesh


def _bulged(rng: np.random.Generator, vertices: np.ndarray, tall: float) -> np.ndarray:
    """Full cartons bulge at the middle of their sides."""
    half = np.abs(vertices[:, :2]).max(axis=0)
    share = np.clip(vertices / [half[0], half[1], 1.0], -1, 1)
    along = np.sin(np.pi * np.clip(vertices[:, 2] / tall, 0, 1))
    deep = rng.choice([0.0, rng.uniform(0.0, 0.05)]) * half.min()
    moved = np.array(vertices)
    for axis in range(2):
        moved[:, axis] += deep * share[:, axis] * (1 - share[:, 1 - axis] ** 2) * along
    return moved


def _screw_cap(rng: np.random.Generator, radius: float, room: float) -> np.ndarray:
    """Profile (7, 2) m of a cap on a flange, with room for a flange of so large a radius."""
    flange, tall = min(radius + rng.uniform(0.001, 0.003), room), rng.uniform(0.009, 0.016)
    radius = min(radius, flange - 0.001)
    corners = [[flange, 0], [flange, 0.0015], [radius, 0.002], [radius, tall], [0, tall + 0.0005]]
    return rounded(corners, [0, 0, 0, 0.0015, 0], steps=3)


def _seal(radius: float) -> np.ndarray:
    """Profile (7, 2) m of a foil where other cartons have their caps."""
    return np.array([[radius, 0], *([share * radius, _FOIL] for share in np.linspace(0.94, 0.7, 5)), [0, _FOIL]])


def _clear(at: float, cap: np.ndarray, length: float) -> float:
    """Where on a side of this length, m, the middle of a cap is, so that it is off the edges."""
    off = cap[0, 0] + _OFF_EDGE
    return float(np.clip(at, off, length - off))


CARTON = Family(
    "carton",
    _make,
    "household",
    spec={"alike": ("box",), "rests": {"upright": 0.93, "lying": 0.065, "upside_down": 0.005}},
    variants={"brick": {}, "egg": {"rests": {"upright": 0.99, "upside_down": 0.01}}},
    members=120,
)
