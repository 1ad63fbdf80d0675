"""Boxes: cartons of any size, packets, books, tissue boxes, bars of soap; and boxes without a lid."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.blocks import block
from gfp_grasp.shapes.family import Family, Made, draw_kind
from gfp_grasp.shapes.loft import subtract, unite

_KINDS = {"packet": 0.32, "shipping": 0.26, "book": 0.12, "tissue": 0.08, "soap": 0.1, "open": 0.12}
# Long, middle and short side, m; and the radius of the edges.
_SIDES_M = {
    "packet": ((0.06, 0.32), (0.5, 0.85), (0.2, 0.5), (0.0004, 0.003)),
    "shipping": ((0.1, 0.35), (0.5, 1.0), (0.3, 1.0), (0.0005, 0.004)),
    "book": ((0.15, 0.3), (0.62, 0.85), (0.09, 0.24), (0.0005, 0.004)),
    "tissue": ((0.11, 0.25), (0.5, 1.0), (0.35, 0.55), (0.001, 0.005)),
    "soap": ((0.055, 0.1), (0.55, 0.75), (0.28, 0.5), (0.003, 0.012)),
    "open": ((0.09, 0.35), (0.5, 1.0), (0.25, 0.8), (0.001, 0.006)),
}
_THINNEST_M = 0.02


def _make(rng: np.random.Generator) -> Made:
    """One box; a closed one is a solid, its wall is zero."""
    kind = draw_kind(rng, _KINDS)
    size, edge = _size(rng, kind)
    if kind == "open":
        wall = float(min(rng.uniform(0.0015, 0.006), 0.1 * size.min()))
        return Made(_opened(rng, size, edge, wall), kind, wall)
    box = block(size, edge)
    box.vertices = _worn(rng, np.asarray(box.vertices), size)
    return Made(box, kind)


def _size(rng: np.random.Generator, kind: str) -> tuple[np.ndarray, float]:
    """Sides (3,) m along x, y and z, x not shorter than y; and the radius of the edges, m."""
    long, middle, short, edge = _SIDES_M[kind]
    first = float(np.exp(rng.uniform(*np.log(long))))
    second = first * rng.uniform(*middle)
    sides = np.array([first, second, second * rng.uniform(*short) / (1.0 if kind != "book" else 0.8)])
    sides = np.maximum(sides, _THINNEST_M)
    upright = rng.permutation(3) if kind != "open" else np.array([0, 1, 2])
    x, y, z = sides[upright]
    return np.array([max(x, y), min(x, y), z]), float(rng.uniform(*edge))


def _worn(rng: np.random.Generator, vertices: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Sides that bulge or cave in, and edges that lean: what a packet of cardboard has been through."""
    scaled = np.clip((vertices - [0, 0, size[2] / 2]) / (size / 2), -1, 1)
    moved = np.array(vertices)
    deep = rng.choice([0.0, 0.012, 0.03], size=3, p=[0.6, 0.25, 0.15]) * rng.normal(size=3) * size.min()
    for axis in range(2):
        others = [i for i in range(3) if i != axis]
        moved[:, axis] += deep[axis] * scaled[:, axis] * (1 - scaled[:, others] ** 2).prod(axis=1)
    if rng.random() < 0.3:
        moved[:, 0] += rng.normal(0, 0.015) * size.min() * scaled[:, 2]
        moved[:, 1] += rng.normal(0, 0.015) * size.min() * scaled[:, 2] * scaled[:, 0]
    return moved


def _opened(rng: np.random.Generator, size: np.ndarray, edge: float, wall: float) -> trimesh.Trimesh:
    """A box without its lid; its sides lean out a little in some."""
    outer = block(size, edge)
    inner = block(size - [2 * wall, 2 * wall, 0], max(edge - wall, 0.0005))
    inner.apply_translation([0, 0, wall * rng.uniform(1.0, 1.5)])
    lean = rng.choice([0.0, rng.uniform(0.0, 0.12)])
    for mesh in (outer, inner):
        grow = 1 - lean * (1 - np.clip(mesh.vertices[:, 2] / size[2], 0, 1))
        mesh.vertices = mesh.vertices * np.stack([grow, grow, np.ones_like(grow)], axis=1)
    return unite([subtract(outer, inner)])


BOX = Family(
    "box",
    _make,
    "household",
    # Members stand on any of their sides: "lying" would count them twice.
    spec={"alike": ("carton",), "rests": {"upright": 1.0}, "density_kg_m3": (50.0, 1050.0)},
    variants={
        "open": {"rests": {"upright": 0.95, "lying": 0.04, "upside_down": 0.01}, "density_kg_m3": (100.0, 900.0)},
    },
    members=120,
)
