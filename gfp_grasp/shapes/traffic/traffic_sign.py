"""Traffic signs: a plate of any of the usual outlines on a pole, facing +x; all are one mesh in several shapes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import trimesh

from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import arc_length, rounded, smoothstep

_KINDS = {
    "round": 0.24, "triangle": 0.16, "yield": 0.08, "octagon": 0.1, "square": 0.12, "diamond": 0.1, "rectangle": 0.2,
}  # fmt: skip
_CORNERS = {"triangle": (3, 90.0), "yield": (3, -90.0), "octagon": (8, 22.5), "square": (4, 45.0), "diamond": (4, 0.0)}
# The plate is made of rings around its middle: shares of the outline in front; behind, the same in reverse.
_RINGS = np.array([0.2, 0.4, 0.6, 0.8, 1.0])
_HALF = 36  # points of half of an outline, from its bottom to its top
_FOOT = 3  # so many of them to each side of the bottom belong to the pole
_HEIGHTS = np.array(
    [0.985, *np.linspace(0.95, 0.05, 22), 0.0]
)  # heights of the pole's rings over that of the plate's edge


def _make(rng: np.random.Generator) -> Made:
    """One sign: the pole's axis is z, the plate stands on it."""
    kind = draw_kind(rng, _KINDS)
    pole, thick = rng.uniform(0.025, 0.05), rng.uniform(0.02, 0.035)
    outline = _around(_outline(rng, kind), pole)
    outline[:, 1] += rng.uniform(1.8, 3.5) - outline[:, 1].max()
    front = rng.uniform(0.0, 1.0) * pole + 0.5 * thick
    plate = np.concatenate([_sheet(outline, front), _sheet(outline, front - thick)[::-1]])
    tube = _pole(rng, pole, outline[0, 1])
    return Made(_joined(plate, tube), kind)


def _outline(rng: np.random.Generator, kind: str) -> np.ndarray:
    """The half of the outline with y >= 0, (n, 2) m of y and z, from its lowest to its highest point on y = 0."""
    if kind == "round":
        turn = np.linspace(-np.pi / 2, np.pi / 2, 73)
        return rng.uniform(0.2, 0.48) * np.column_stack([np.abs(np.cos(turn)), np.sin(turn)])
    if kind == "rectangle":
        short, long = rng.uniform(0.2, 0.75), rng.uniform(1.15, 3.0)
        sides = min(short * long, 1.3), short
        wide, tall = sides if rng.random() < 0.5 else sides[::-1]
        corners = np.array([[wide, -tall], [wide, tall]]) / 2
        bottom, top = -tall / 2, tall / 2
    else:
        count, start = _CORNERS[kind]
        reach = rng.uniform(0.38, 0.62) if count == 3 else rng.uniform(0.28, 0.55)
        turn = np.radians(start) + 2 * np.pi * np.arange(count) / count
        bottom, top = reach * np.sin(turn).min(), reach * np.sin(turn).max()
        corners = reach * np.column_stack([np.cos(turn), np.sin(turn)])
        corners = corners[corners[:, 0] > 1e-6]
        corners = corners[np.argsort(corners[:, 1])]
    line = np.concatenate([[[0.0, bottom]], corners, [[0.0, top]]])
    bend = rng.uniform(0.01, 0.06)
    return rounded(line, [0, *([bend] * len(corners)), 0])


def _around(half: np.ndarray, pole: float) -> np.ndarray:
    """The whole outline (2 _HALF, 2) from its bottom on, turning left; its first points are within the pole."""
    length = arc_length(half)
    widest = int(half[:, 0].argmax())
    foot = float(np.interp(0.9 * pole, half[: widest + 1, 0], length[: widest + 1]))
    at = np.concatenate([np.linspace(0, foot, _FOOT + 1), np.linspace(foot, length[-1], _HALF - _FOOT + 1)[1:]])
    right = np.column_stack([np.interp(at, length, half[:, i]) for i in (0, 1)])
    return np.concatenate([right, right[-2:0:-1] * [-1, 1]])


def _sheet(outline: np.ndarray, x: float) -> np.ndarray:
    """Rings (r, n, 3) m of one side of the plate, from its middle outward."""
    middle = np.array([0.0, (outline[:, 1].min() + outline[:, 1].max()) / 2])
    flat = middle + _RINGS[:, None, None] * (outline - middle)
    return np.concatenate([np.full((*flat.shape[:2], 1), x), flat], axis=2)


def _pole(rng: np.random.Generator, radius: float, top: float) -> np.ndarray:
    """Rings (r, k, 3) m from below the plate to the road, perhaps in a sleeve; the first half of a ring is in front."""
    count = 2 * _FOOT + 1
    turn = np.pi / count * (np.arange(count) - _FOOT)
    turn = np.concatenate([turn, np.pi + turn])
    sleeve = (rng.random() < 0.3) * rng.uniform(0.003, 0.02)
    reach = radius + sleeve * (1 - smoothstep((_HEIGHTS - rng.uniform(0.05, 0.15)) / 0.04))
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    high = np.broadcast_to(top * _HEIGHTS[:, None, None], (len(_HEIGHTS), len(turn), 1))
    return np.concatenate([reach[:, None, None] * circle, high], axis=2)


def _joined(plate: np.ndarray, tube: np.ndarray) -> trimesh.Trimesh:
    """The plate's rings with the pole in the place of the lowest part of its edge; the same faces for every sign."""
    rings, around, _ = plate.shape
    index = np.arange(rings * around).reshape(rings, around)
    middle = rings * around + np.arange(2)
    edge = len(_RINGS) - 1
    faces = [_fan(index[0], middle[0])[:, ::-1], _fan(index[-1], middle[1])]
    foot = np.r_[around - _FOOT : around, 0:_FOOT]  # quads of the edge that the pole replaces
    for number, (here, there) in enumerate(pairwise(index)):
        kept = np.setdiff1d(np.arange(around), foot) if number == edge else np.arange(around)
        faces.append(_band(here, there)[np.concatenate([kept, kept + around])])
    inside = np.r_[around - _FOOT : around, 0 : _FOOT + 1]
    loop = np.concatenate([index[edge][inside], index[edge + 1][inside][::-1]])
    start = middle[1] + 1
    below = start + np.arange(tube.shape[0] * tube.shape[1]).reshape(tube.shape[:2])
    down = np.concatenate([loop[None], below])
    faces += [_band(here, there) for here, there in pairwise(down)]
    last = start + below.size
    faces.append(_fan(down[-1], last))
    centres = [plate[0].mean(axis=0), plate[-1].mean(axis=0)]
    vertices = np.concatenate([plate.reshape(-1, 3), centres, tube.reshape(-1, 3), [[0.0, 0.0, 0.0]]])
    return trimesh.Trimesh(vertices, np.concatenate(faces), process=False)


def _band(here: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Faces (2 k, 3) between two rings of k vertices: the k lower ones, then the k upper ones."""
    after, beyond = np.roll(here, -1), np.roll(there, -1)
    return np.concatenate([np.stack([here, there, after], axis=1), np.stack([after, there, beyond], axis=1)])


def _fan(ring: np.ndarray, middle: int) -> np.ndarray:
    """Faces (k, 3) that close a ring at its end."""
    return np.stack([ring, np.full(len(ring), middle), np.roll(ring, -1)], axis=1)


TRAFFIC_SIGN = Family(
    "traffic_sign",
    _make,
    "traffic",
    spec={"rests": {"upright": 1.0}, "density_kg_m3": (200.0, 2500.0)},
)
