"""The road under a scan of traffic: a smooth surface on which the lowest points lie, sloped and bent as roads are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gfp_grasp.errors import NothingDetected
from gfp_grasp.types import SupportPlane

_CELL_M = 1.0  # side of the cells whose lowest points stand for the ground
_FARTHEST_M = 70.0
_UNIT_M = 30.0  # of the terms of a road
_FEWEST_CELLS = 12
_LOWEST = 0.25  # quantile of a cell's heights: the lowest return may be a reflection from below the road
_STEEPEST = np.tan(np.deg2rad(15))
_TRIES = 400
_INLIER_M = 0.2
_LAPS_M = (1.0, 0.6, 0.35, 0.2, 0.12, 0.12)  # what counts as near in each lap of the fit
_BELOW = 2.0  # weight of a cell below the surface over one above it: nothing is under a road, but much stands on it
_FLAT = 3.0  # cells' worth of the belief that a road does not bend
_NEAR_M = 20.0  # cells farther away count less: the road is where the sensor is


@dataclass(frozen=True, eq=False)
class Road:
    """Height of a road: a quadratic surface over the level directions.

    Attributes:
        up: (3,) unit.
        origin: (3,) m, where the surface is written about.
        axes: (2, 3) level unit vectors u, v.
        terms: (6,) m: height = terms @ (1, u, v, u^2, u v, v^2), u and v in units of 30 m.
    """

    up: np.ndarray
    origin: np.ndarray
    axes: np.ndarray
    terms: np.ndarray

    def heights(self, points: np.ndarray) -> np.ndarray:
        """Height (n,) m of points (n, 3) m above the road."""
        local = points - self.origin
        return local @ self.up - _basis(local @ self.axes.T) @ self.terms

    def support_at(self, point: np.ndarray) -> SupportPlane:
        """The plane that touches the road below a point (3,) m."""
        u, v = (point - self.origin) @ self.axes.T
        _, a, b, c, d, e = self.terms
        u, v = u / _UNIT_M, v / _UNIT_M
        slope = np.array([a + 2 * c * u + d * v, b + 2 * e * v + d * u]) / _UNIT_M
        normal = self.up - slope @ self.axes
        normal /= np.linalg.norm(normal)
        on_road = point - self.heights(point[None])[0] * self.up
        return SupportPlane(normal, float(normal @ on_road))


def find_road(
    points: np.ndarray, up: np.ndarray, *, viewpoint: np.ndarray | None = None, forward: np.ndarray | None = None
) -> Road:
    """The road of a scan.

    Args:
        points: (n, 3) m, a whole scan.
        up: (3,), within 15 degrees of the road's normal.
        viewpoint: (3,) m, where the sensor stood; what is farther than 70 m from it does not count. None takes the
            middle of the points.
        forward: (3,), not along up: the road's first axis, along which the ground is cut into squares, so that the road
            turns with the sensor; None takes an axis of the frame.

    Raises:
        NothingDetected: Too little ground in sight.
    """
    up = up / np.linalg.norm(up)
    origin = points.mean(axis=0) if viewpoint is None else np.asarray(viewpoint, dtype=np.float64)
    u = np.cross(np.eye(3)[np.abs(up).argmin()], up) if forward is None else forward - (forward @ up) * up
    u /= np.linalg.norm(u)
    axes = np.stack([u, np.cross(up, u)])
    local = points - origin
    level, height = local @ axes.T, local @ up
    near = np.linalg.norm(level, axis=1) < _FARTHEST_M
    places, lowest = _lowest_of_cells(level[near], height[near])
    if len(places) < _FEWEST_CELLS:
        raise NothingDetected(
            f"no road: {len(places)} places of a square metre with points within {_FARTHEST_M:g} m, at least "
            f"{_FEWEST_CELLS} are needed: give the whole scan, its road too"
        )
    terms = np.zeros(6)
    nearness = 1.0 / (1.0 + (np.linalg.norm(places, axis=1) / _NEAR_M) ** 2)
    terms[:3] = _plane_below(places, lowest, nearness)
    basis = _basis(places)
    for near_m in _LAPS_M:
        off = lowest - basis @ terms
        weight = nearness * np.clip(1 - (off / near_m) ** 2, 0.0, None) ** 2 * np.where(off < 0, _BELOW, 1.0)
        sums = basis.T @ (weight[:, None] * basis) + np.diag([1e-9, 1e-9, 1e-9, _FLAT, _FLAT, _FLAT])
        terms = np.linalg.solve(sums, basis.T @ (weight * lowest))
    return Road(up, origin, axes, terms)


def _basis(level: np.ndarray) -> np.ndarray:
    u, v = level.T / _UNIT_M
    return np.column_stack([np.ones(len(level)), u, v, u * u, u * v, v * v])


def _lowest_of_cells(level: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Middle (c, 2) m of the points of each cell of a square metre that has some, and its lowest height (c,) m."""
    if not len(level):
        return np.empty((0, 2)), np.empty(0)
    cell = np.floor(level / _CELL_M).astype(np.int64)
    _, number = np.unique(cell, axis=0, return_inverse=True)
    order = np.lexsort((height, number))
    starts = np.flatnonzero(np.diff(number[order], prepend=-1))
    counts = np.diff(starts, append=len(order))
    chosen = order[starts + np.floor(_LOWEST * counts).astype(np.int64)]
    return level[chosen], height[chosen]


def _plane_below(places: np.ndarray, lowest: np.ndarray, nearness: np.ndarray) -> np.ndarray:
    """Height and slopes (3,), in the units of `_basis`, of the plane with most cells near it and few below it."""
    rng = np.random.default_rng(0)
    basis = _basis(places)[:, :3]
    best, chosen = -np.inf, np.array([np.median(lowest), 0.0, 0.0])
    for _ in range(_TRIES):
        three = rng.choice(len(places), 3, replace=False)
        if abs(np.linalg.det(basis[three])) < 1e-6:
            continue
        terms = np.linalg.solve(basis[three], lowest[three])
        if np.hypot(*terms[1:]) / _UNIT_M > _STEEPEST:
            continue
        off = lowest - basis @ terms
        score = nearness @ ((np.abs(off) < _INLIER_M) - _BELOW * (off < -_INLIER_M))
        if score > best:
            best, chosen = score, terms
    return chosen
