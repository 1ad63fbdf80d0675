"""Starts of vehicles that a LiDAR saw: upright sides at a right angle, of which one or two face the sensor.

What one look proposes is a mean over front and back where the points do not say which is which, and so no direction at
all; a corner tells the two directions that there are.
"""

from __future__ import annotations

import numpy as np

from gfp_grasp.register.state import STANDING_SIGMA_RAD, PoseShape, start_of
from gfp_grasp.types import GenericPrimitive, LevelView

_TURNS = 90  # directions of a side that are tried, a degree apart
_NEAR_M = 0.05  # nearer to a side than this counts no more
_SEEN_WHOLE = 0.75  # share of the class's own extent from which on what was seen of a side is its length
_LIKELY = (0.6, 1.6)  # scales that a side may lend to one that was not seen
_ENDS = (0.003, 0.997)


def side_direction(level: np.ndarray) -> float:
    """Direction, rad from 0 to pi / 2, of one of two sides at a right angle that points (n, 2) lie nearest to.

    The criterion is closeness (Zhang et al. 2017, "Efficient L-shape fitting for vehicle detection using laser
    scanners"): the sum over the points of one over their distance from the nearer of two sides.
    """
    turns = np.pi / 2 * np.arange(_TURNS) / _TURNS
    along = np.stack([np.cos(turns), np.sin(turns)])
    across = np.stack([-np.sin(turns), np.cos(turns)])
    nearest = np.full((len(level), _TURNS), np.inf)
    for axes in (along, across):
        places = level @ axes
        low, high = np.quantile(places, _ENDS, axis=0)
        nearest = np.minimum(nearest, np.minimum(np.abs(places - low), np.abs(high - places)))
    return float(turns[np.argmax((1.0 / np.maximum(nearest, _NEAR_M)).sum(axis=0))])


def corner_starts(primitive: GenericPrimitive, evidence: LevelView) -> list[PoseShape]:
    """Upright starts along the sides of the points, their front each of four ways.

    What was seen of a side is its length where it is most of what the class has; a side that was hardly seen goes on
    away from the sensor, as long as its class is for the other.
    """
    assert evidence.viewpoint is not None
    points, found = evidence.dense_points, []
    first = side_direction(points[:, :2])
    low_own, high_own = primitive.vertices.min(axis=0), primitive.vertices.max(axis=0)
    own = high_own - low_own
    top = float(np.quantile(points[:, 2], _ENDS[1]))
    tall = max((top - evidence.floor_m) / own[2], 1.0 if evidence.cut is not None else 0.1)
    for turn in first + np.pi / 2 * np.arange(4):
        R = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
        places, eye = (points @ R)[:, :2], (evidence.viewpoint @ R)[:2]
        low, high = np.quantile(places, _ENDS, axis=0)
        share = (high - low) / own[:2]
        scale = np.where(share > _SEEN_WHOLE, share, np.clip(share.max(), *_LIKELY))
        size = np.maximum(scale * own[:2], high - low)
        nearer_high = eye > (low + high) / 2
        middle = np.where(nearer_high, high - size / 2, low + size / 2)
        scales = np.append(scale, tall)
        local = np.append(middle, evidence.floor_m) - scales * np.append((low_own + high_own)[:2] / 2, low_own[2])
        found.append(start_of(primitive, R, R @ local, scales, STANDING_SIGMA_RAD, "upright"))
    return found
