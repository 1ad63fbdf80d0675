"""What stands and grows beside a road: pavements, houses, walls, hedges, fences, banks, posts, trees and heaps."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh

from gfp_grasp.shapes import STREET_FURNITURE, make_shape, split_seeds
from gfp_grasp.transforms import make_T, rotation_about

LONG_M = 60.0  # length of the road, ahead and behind
MEMBERS = 60  # number of members of each class that streets are drawn from
_LEAFY, _LEAVES = 0.6, 300  # share of the bushes through which one sees, and the leaves of one
_FARTHEST_BEHIND_M = 30.0  # of what stands behind the first row of houses and hedges


@dataclass(frozen=True)
class RoadPlan:
    """What runs along the road, to the right and to the left of it.

    Attributes:
        middle: y of the road's middle, m.
        kerbs: y of the kerbs, m.
        backs: y of the backs of the pavements, m.
        parked_m: Width of the strip for parking.
        kerb_m: Height of the kerbs.
        rows: For each side how far behind the pavement a row of parked vehicles begins, m, and their turn to the
            road, rad.
    """

    middle: float
    kerbs: tuple[float, float]
    backs: tuple[float, float]
    parked_m: float
    kerb_m: float
    rows: tuple[tuple[float, float], tuple[float, float]]


def draw_roadside(
    plan: RoadPlan, rng: np.random.Generator, split: str, taken: list[np.ndarray]
) -> list[trimesh.Trimesh]:
    found = []
    for side in range(2):
        kerb, back, outwards = plan.kerbs[side], plan.backs[side], (-1) ** (side + 1)
        low, high = sorted((kerb, back))
        found.append(_block([-LONG_M, low, -0.5], [LONG_M, high, plan.kerb_m]))
        found += _behind(back, outwards, rng, taken)
        for _ in range(rng.poisson(6)):
            x, y = rng.uniform(-LONG_M, LONG_M), rng.uniform(low + 0.3, high - 0.3)
            found += _post(x, y, plan.kerb_m, rng, split, taken)
        for _ in range(rng.poisson(25)):
            x, y = rng.uniform(-LONG_M, LONG_M), back + outwards * rng.uniform(0.5, _FARTHEST_BEHIND_M)
            found += _post(x, y, 0.0, rng, split, taken)
        for _ in range(rng.poisson(14)):
            x, y = rng.uniform(-LONG_M, LONG_M), back + outwards * rng.uniform(0.0, _FARTHEST_BEHIND_M)
            found += _heap(x, y, rng, taken)
    return found


def _behind(back: float, outwards: int, rng: np.random.Generator, taken: list[np.ndarray]) -> list[trimesh.Trimesh]:
    """Houses, walls, hedges, fences and banks behind a pavement, with gaps."""
    found, x = [], -LONG_M
    houses, walls, hedges = np.cumsum(rng.dirichlet((2.0, 1.0, 1.0, 1.5)))[:3]  # a road has a character
    while x < LONG_M:
        long_m, kind = rng.uniform(4.0, 18.0), rng.random()
        start = back + outwards * rng.uniform(0.0, 5.0) * (rng.random() < 0.8)
        deep, high = rng.uniform(0.2, 1.0), rng.uniform(0.6, 2.2)
        if kind < houses:
            start += outwards * rng.uniform(0.0, 8.0) * (rng.random() < 0.3)
            deep, high = rng.uniform(4.0, 10.0), rng.uniform(3.0, 14.0)
        end = start + outwards * deep
        low, top = sorted((start, end))
        if kind < hedges and is_free(np.array([[x, low], [x + long_m, top]]), taken):
            taken.append(np.array([[x, low], [x + long_m, top]]))
            if kind < walls:
                found.append(_block([x, low, 0.0], [x + long_m, top, high]))
            elif rng.random() < 0.6:
                found += _hedge(x, x + long_m, (start + end) / 2, high, rng)
            else:
                found += _fence(x, x + long_m, start, high, rng)
        x += long_m + rng.uniform(0.0, 4.0)
    if rng.random() < 0.3:
        found.append(_bank(back + outwards * rng.uniform(0.0, 4.0), outwards, rng))
    return found


def _hedge(x: float, end: float, y: float, high_m: float, rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """Leaves in a row."""
    step = 0.8 * high_m
    return [
        _lump(rng, 0.55 * high_m).apply_translation((along, y + rng.normal(scale=0.15), 0.5 * high_m))
        for along in np.arange(x, end, step)
    ]


def _fence(x: float, end: float, y: float, high_m: float, rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """Posts with rails between them; or a guard rail."""
    height, posts = min(high_m, 1.4), np.arange(x, end, rng.uniform(1.2, 3.0))
    rails = rng.uniform(0.3, 1.0, rng.integers(1, 4)) * height
    thick = rng.uniform(0.02, 0.12)
    return [_cylinder(along, y, 0.0, 0.05, height) for along in posts] + [
        _block([x, y - 0.03, z - thick], [end, y + 0.03, z + thick]) for z in rails
    ]


def _bank(y: float, outwards: int, rng: np.random.Generator) -> trimesh.Trimesh:
    """Ground that rises or stays low beside the road."""
    wide, high = rng.uniform(2.0, 15.0), rng.uniform(0.2, 2.0)
    profile = np.array([[y, -0.2], [y + outwards * wide, high], [y + outwards * (wide + 30), high]])
    ends = [np.column_stack([np.full(3, x), profile]) for x in (-LONG_M, LONG_M)]
    faces = [[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4]]
    return trimesh.Trimesh(np.concatenate(ends), faces, process=False)


def _heap(x: float, y: float, rng: np.random.Generator, taken: list[np.ndarray]) -> list[trimesh.Trimesh]:
    """A container, a cabinet, a heap or a thicket: as large as a person or a car, and neither."""
    size = np.exp(rng.uniform(np.log((0.4, 0.4, 0.5)), np.log((4.0, 2.5, 2.5))))
    reach = np.full(2, np.hypot(*size[:2]) / 2)
    box = np.stack([np.array([x, y]) - reach, np.array([x, y]) + reach])
    if not is_free(box, taken):
        return []
    taken.append(box)
    kind, turn = rng.random(), make_T(rotation_about((0, 0, 1), rng.uniform(0, np.pi)), (x, y, 0.0))
    if kind < 0.4:
        made = [_block([-size[0] / 2, -size[1] / 2, 0.0], [size[0] / 2, size[1] / 2, size[2]])]
    elif kind < 0.6:
        flat = _lump(rng, 1.0)
        flat.apply_scale((size[0], size[1], 0.3 * size[2]))
        made = [flat]
    else:
        made = [
            _lump(rng, rng.uniform(0.3, 0.6) * size[2]).apply_translation(
                (*(rng.uniform(-0.5, 0.5, 2) * size[:2]), rng.uniform(0.3, 0.7) * size[2])
            )
            for _ in range(rng.integers(1, 6))
        ]
    return [mesh.apply_transform(turn) for mesh in made]


def _post(
    x: float, y: float, z: float, rng: np.random.Generator, split: str, taken: list[np.ndarray]
) -> list[trimesh.Trimesh]:
    """A pole, a tree, a bush, or a sign or cone, where nothing else stands."""
    reach = np.full(2, 0.5)
    box = np.stack([np.array([x, y]) - reach, np.array([x, y]) + reach])
    if not is_free(box, taken):
        return []
    taken.append(box)
    kind = rng.random()
    if kind < 0.3:
        name = str(rng.choice(STREET_FURNITURE))
        mesh = member(name, int(rng.choice(split_seeds(name, split, MEMBERS)))).copy()
        mesh.apply_transform(make_T(rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)), (x, y, z)))
        return [mesh]
    if kind < 0.55:
        return [_cylinder(x, y, z, rng.uniform(0.05, 0.15), rng.uniform(3.0, 8.0))]
    if kind < 0.85:
        high = rng.uniform(1.8, 3.5)
        crown = _lump(rng, rng.uniform(0.9, 2.2)).apply_translation((x, y, z + high + 0.8))
        return [_cylinder(x, y, z, rng.uniform(0.08, 0.3), high + 0.5), crown]
    size = rng.uniform(0.3, 0.8)
    return [_lump(rng, size).apply_translation((x, y, z + 0.7 * size))]


def _lump(rng: np.random.Generator, radius_m: float) -> trimesh.Trimesh:
    """Leaves, as a ball whose surface goes in and out, or as many of them with air between."""
    if rng.random() < _LEAFY:
        return _leaves(rng, radius_m)
    ball = trimesh.creation.icosphere(subdivisions=3)
    rough = rng.uniform(0.7, 1.15, (len(ball.vertices), 1))
    return trimesh.Trimesh(ball.vertices * rough * radius_m * rng.uniform(0.7, 1.2, 3), ball.faces, process=False)


def _leaves(rng: np.random.Generator, radius_m: float) -> trimesh.Trimesh:
    """Loose triangles of 3 to 15 cm, denser towards the middle."""
    directions = rng.standard_normal((_LEAVES, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    places = directions * radius_m * rng.uniform(0.0, 1.1, (_LEAVES, 1)) ** 0.5 * rng.uniform(0.7, 1.2, 3)
    leaves = places[:, None] + rng.standard_normal((_LEAVES, 3, 3)) * rng.uniform(0.03, 0.15, (_LEAVES, 1, 1))
    return trimesh.Trimesh(leaves.reshape(-1, 3), np.arange(3 * _LEAVES).reshape(-1, 3), process=False)


def _cylinder(x: float, y: float, z: float, radius_m: float, height_m: float) -> trimesh.Trimesh:
    made = trimesh.creation.cylinder(radius_m, height_m, sections=16)
    return made.apply_translation((x, y, z + height_m / 2))


def _block(low: list[float], high: list[float]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])


@lru_cache(maxsize=1000)  # the same members stand in many streets, and each takes a tenth of a second to make
def member(category: str, seed: int) -> trimesh.Trimesh:
    return make_shape(category, seed).mesh


def is_free(box: np.ndarray, taken: list[np.ndarray]) -> bool:
    """Whether a box (2, 2) m, its lower and upper corner, overlaps none of those that are taken."""
    return not any((box[0] < other[1]).all() and (other[0] < box[1]).all() for other in taken)
