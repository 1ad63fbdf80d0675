"""Test shapes that stand side by side on one table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.scenes import ObjectSource, shipped_families
from gfp_grasp.shapes import split_seeds
from gfp_grasp.transforms import make_T, rotation_about

MOST = 5
_TRIES = 50  # places that are tried for an object before it is left out
_GAP_M = 0.004


@dataclass(frozen=True, eq=False)
class PlacedShape:
    """One object of a clutter.

    Attributes:
        source: Where it comes from.
        mesh: The true mesh, in the world's frame.
        T_world_object: (4, 4) its pose on the table.
    """

    source: ObjectSource
    mesh: trimesh.Trimesh
    T_world_object: np.ndarray


def draw_clutter(rng: np.random.Generator, *, least: int = 2, spread_m: float = 0.18) -> list[PlacedShape]:
    """Shapes of the test split, upright on z = 0 and at least 4 mm apart; what finds no room is left out.

    Args:
        rng: Draws number, shapes, places and yaws.
        least: Fewest objects that are drawn; 5 are the most.
        spread_m: How far their middles may lie from the origin, along x and along y.
    """
    families, placed = shipped_families(), list[PlacedShape]()
    circles: list[tuple[np.ndarray, float]] = []
    for _ in range(int(rng.integers(least, MOST + 1))):
        family = families[int(rng.integers(len(families)))]
        seed = int(rng.choice(split_seeds(family, "test")))
        source = ObjectSource(f"{family}-{seed}", family, family=family, seed=seed)
        mesh = source.load_mesh().copy()
        radius = float(np.linalg.norm(mesh.vertices[:, :2], axis=1).max())
        for place in rng.uniform(-spread_m, spread_m, (_TRIES, 2)):
            if all(np.linalg.norm(place - other) > radius + r + _GAP_M for other, r in circles):
                T = make_T(rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi)), (*place, 0.0))
                placed.append(PlacedShape(source, mesh.apply_transform(T), T))
                circles.append((place, radius))
                break
    return placed
