"""How many convex parts a shape may have, of how many vertices, and how true they must be."""

from __future__ import annotations

import math
import numbers
from dataclasses import dataclass
from functools import cache

import numpy as np

from gfp_grasp.errors import InvalidOption

_MANY = 4


@dataclass(frozen=True)
class CollisionConfig:
    """Budget of the convex parts of a completed shape. It is kept to the letter: never more parts or vertices.

    Attributes:
        max_parts: Most parts.
        max_vertices_per_part: Most vertices of each; None for no limit.
        tolerance_m: 95 % of the surfaces of parts and mesh lie within this of each other: the fewest parts that do so
            are taken. None takes as many of max_parts as make a difference.
    """

    max_parts: int = 80
    max_vertices_per_part: int | None = None
    tolerance_m: float | None = None

    def __post_init__(self) -> None:
        if not _whole(self.max_parts) or self.max_parts < 1:
            raise InvalidOption(f"max_parts is {self.max_parts!r}; a whole number from 1 on is expected")
        most = self.max_vertices_per_part
        if most is not None and (not _whole(most) or most < 4):
            raise InvalidOption(f"max_vertices_per_part is {most!r}; a whole number from 4 on, or None, is expected")
        tolerance = self.tolerance_m
        if tolerance is not None and not (
            isinstance(tolerance, numbers.Real) and not isinstance(tolerance, bool) and 0 < tolerance < math.inf
        ):
            raise InvalidOption(f"tolerance_m is {tolerance!r}; a positive number of metres, or None, is expected")


def fewer_corners(corners: np.ndarray, count: int) -> np.ndarray:
    """Corners of a hull that keep as much of it as so few can, about.

    Args:
        corners: (n, 3) m, all of the hull, not in one plane.
        count: At least 4, less than n.

    Returns:
        (count, 3) of them, in their order.
    """
    centred = corners - corners.mean(axis=0)
    # The farthest in even directions, of which some are the same; then those that are so in most of many directions,
    # which means that the hull bends much there.
    chosen = list(dict.fromkeys((_directions(count) @ centred.T).argmax(axis=1).tolist()))
    many = np.bincount((_directions(_MANY * count) @ centred.T).argmax(axis=1), minlength=len(corners))
    many[chosen] = -1
    chosen += np.argsort(-many, kind="stable")[: count - len(chosen)].tolist()
    own = centred[chosen] - centred[chosen].mean(axis=0)
    if np.linalg.matrix_rank(own) < 3:
        chosen[-1] = _farthest_from_flat(centred, chosen[:-1])
    return corners[sorted(chosen)]


def _farthest_from_flat(points: np.ndarray, chosen: list[int]) -> int:
    """The point that is farthest from the line or plane of those chosen."""
    own = points[chosen] - points[chosen].mean(axis=0)
    _, spread, axes = np.linalg.svd(own, full_matrices=True)
    flat = axes[np.append(spread, np.zeros(3 - len(spread))) <= 1e-9 * max(float(spread.max(initial=0)), 1e-12)]
    flat = flat if len(flat) else axes[-1:]
    distance = np.linalg.norm((points - points[chosen].mean(axis=0)) @ flat.T, axis=1)
    distance[chosen] = -np.inf
    return int(distance.argmax())


@cache
def _directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors, spread evenly: a Fibonacci spiral."""
    height = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - height**2)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), height])


def _whole(value: object) -> bool:
    return isinstance(value, numbers.Integral) and not isinstance(value, bool)
