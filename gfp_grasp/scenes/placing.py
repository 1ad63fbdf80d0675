"""Poses of several objects on one table, apart from each other."""

from collections.abc import Sequence

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidOption, InvalidScene
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import TrueObject

_TRIES = 2000


def place_clutter(
    objects: Sequence[TrueObject | trimesh.Trimesh],
    rng: np.random.Generator,
    *,
    radius_m: float = 0.22,
    gap_m: float = 0.01,
    table_height: float = 0.0,
    lying_share: float = 0.0,
) -> tuple[np.ndarray, ...]:
    """Random places and turns, no two objects closer than a gap, each resting on the table.

    Footprints are kept apart as circles, so that any turn is free. A lying object rests on its lowest point and may
    roll a little until the simulation has settled it.

    Args:
        objects: In their own frames, z up, base at z = 0.
        rng: Source of chance.
        radius_m: Footprints stay within this circle about the world's z axis; widened where they cannot.
        gap_m: Least distance between two footprints.
        table_height: z of the table's top, m.
        lying_share: Chance that an object is laid on its side.

    Returns:
        T_world_object (4, 4) of each.

    Raises:
        InvalidOption: A share outside 0 to 1, or sizes that are not positive.
        InvalidScene: They do not fit within twice the radius.
    """
    if not (0 <= lying_share <= 1 and radius_m > 0 and gap_m >= 0):
        raise InvalidOption(
            f"lying_share {lying_share} in 0..1, radius_m {radius_m} > 0, gap_m {gap_m} >= 0 are expected"
        )
    turned = [_turn(_vertices(thing), rng, lying_share) for thing in objects]
    for widen in np.linspace(1.0, 2.0, 6):
        centres = _scatter([footprint for _, footprint, _ in turned], rng, radius_m * widen, gap_m)
        if centres is not None:
            break
    else:
        raise InvalidScene(f"{len(objects)} objects do not fit on a circle of {2 * radius_m} m: take fewer or widen it")
    return tuple(
        make_T(R, [*(centre - middle), table_height - low])
        for (R, (middle, _), low), centre in zip(turned, centres, strict=True)
    )


def _vertices(thing: TrueObject | trimesh.Trimesh) -> np.ndarray:
    return np.asarray(thing.mesh.vertices if isinstance(thing, TrueObject) else thing.vertices)


def _turn(
    vertices: np.ndarray, rng: np.random.Generator, lying_share: float
) -> tuple[np.ndarray, tuple[np.ndarray, float], float]:
    """Rotation (3, 3), footprint circle (middle (2,), radius) and lowest z of the turned vertices."""
    R = rotation_about([0.0, 0.0, 1.0], rng.uniform(0, 2 * np.pi))
    if rng.random() < lying_share:
        R = R @ rotation_about([1.0, 0.0, 0.0], np.pi / 2) @ rotation_about([0.0, 0.0, 1.0], rng.uniform(0, 2 * np.pi))
    turned = vertices @ R.T
    middle = (turned[:, :2].min(axis=0) + turned[:, :2].max(axis=0)) / 2
    radius = float(np.linalg.norm(turned[:, :2] - middle, axis=1).max())
    return R, (middle, radius), float(turned[:, 2].min())


def _scatter(
    circles: Sequence[tuple[np.ndarray, float]], rng: np.random.Generator, radius_m: float, gap_m: float
) -> list[np.ndarray] | None:
    """Centres (2,) of circles that keep apart within radius_m, or None where chance found none."""
    order = np.argsort([-radius for _, radius in circles], kind="stable")
    placed: dict[int, np.ndarray] = {}
    for index in order:
        own = circles[index][1]
        room = max(radius_m - own, 0.0)
        for _ in range(_TRIES):
            angle, reach = rng.uniform(0, 2 * np.pi), room * np.sqrt(rng.random())
            centre = reach * np.array([np.cos(angle), np.sin(angle)])
            if all(np.linalg.norm(centre - at) >= own + circles[other][1] + gap_m for other, at in placed.items()):
                placed[int(index)] = centre
                break
        else:
            return None
    return [placed[index] for index in range(len(circles))]
