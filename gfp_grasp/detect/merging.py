"""Pieces of surface that are one object, and pieces that are not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from gfp_grasp.detect.box import smallest_rectangle
from gfp_grasp.transforms import rotation_between
from gfp_grasp.types import SupportPlane


@dataclass(frozen=True)
class MergeConfig:
    """When two pieces are one object.

    Attributes:
        gap_m: They are this near in space.
        floats_m: Height of a piece's lowest point from which it cannot stand by itself.
        on_top: A piece that begins above this share of the other's height stands on it.
        within: Share of a piece's ground points inside the other's outline from which it is inside the other.
        rim_gap_m: The far inside of a rim begins this near behind the near outside.
        touching_m, crumb: A piece this near, whose surface is a smaller share than this of the other's, belongs to it.
        handle_width_m: A piece this narrow on the ground may have twice that share: it is a handle.
        cap: Largest share of surface that a cap or pump has of its bottle.
        compact: Length over width of the ground outline of one object in two pieces.
        same_top_m: Tops that agree to this are two sides of one rim.
        max_width_m: No merging into anything wider.
    """

    gap_m: float = 0.015
    rim_gap_m: float = 0.06
    touching_m: float = 0.005
    crumb: float = 0.15
    handle_width_m: float = 0.025
    cap: float = 0.3
    compact: float = 1.4
    floats_m: float = 0.015
    on_top: float = 0.8
    within: float = 0.7
    same_top_m: float = 0.012
    max_width_m: float = 0.3


_NOISE_M, _RIM_M, _CAP_M = 0.003, 0.01, 0.02  # how far beyond an outline still counts as inside it
_SAMPLE = 1500  # points of a piece that distances are measured between


@dataclass(frozen=True)
class _Piece:
    points: np.ndarray  # (n, 3) m
    ground: np.ndarray  # (n, 2) m
    low: float
    high: float
    area_m2: float


def merge_pieces(
    pieces: np.ndarray,
    points: np.ndarray,
    support: SupportPlane,
    area_m2: np.ndarray,
    *,
    config: MergeConfig = MergeConfig(),
) -> np.ndarray:
    """Join what is one object: a handle seen apart from its mug, a cup's inside beyond its rim.

    A piece joins another that it does not stand on where
    - it is near and lies within the other's outline on the ground: nothing else can be there;
    - it is near and floats (its lowest point is off the table, so something must hold it), and is either the
      smaller of the two or ends at the same height;
    - it touches the other and is a crumb beside it;
    - it is on top of the other as a cap is: small, and the other taller than wide;
    - both end at the same height and make up one compact outline, as the two sides of a rim do, however far the
      far side's visible part begins behind the near one.
    The smallest piece chooses first, and the nearest wins.

    Args:
        pieces: (...) int, 0 for none.
        points: (..., 3) m.
        support: The plane below.
        area_m2: (...) surface that each point stands for.
        config: The thresholds.

    Returns:
        (p + 1,) int, the object of each piece; 0 stays 0.
    """
    group = np.arange(int(pieces.max(initial=0)) + 1)
    known = {int(k): _piece(points[pieces == k], support, float(area_m2[pieces == k].sum())) for k in group[1:]}
    waiting = sorted(known, key=lambda k: known[k].area_m2)
    while waiting:
        k = waiting.pop(0)
        others = sorted((_gap(known[k], known[m]), m) for m in known if m != k)
        owner = next((m for gap, m in others if _belongs(known[k], known[m], gap, config)), None)
        if owner is None:
            continue
        group[group == k] = owner
        known[owner] = _joined(known[owner], known.pop(k), support)
        waiting = sorted({*waiting, owner}, key=lambda k: known[k].area_m2)  # grown, it may now belong elsewhere
    return group


def _belongs(piece: _Piece, other: _Piece, gap: float, config: MergeConfig) -> bool:
    if gap > config.rim_gap_m:
        return False
    _, low, high = smallest_rectangle(np.vstack([piece.ground, other.ground]))
    length, width = high - low
    if length > config.max_width_m:
        return False
    if piece.low > config.on_top * other.high or other.low > config.on_top * piece.high:
        return gap < config.gap_m and (_caps(piece, other, config) or _caps(other, piece, config))
    same_top = abs(piece.high - other.high) < config.same_top_m
    if same_top and length < config.compact * width:
        return True
    if gap > config.gap_m:
        return False
    margin_m = _RIM_M if same_top else _NOISE_M  # the outside of a wall lies a wall's thickness beyond its inside
    if _share_within(piece.ground, other.ground, margin_m) > config.within:
        return True
    thin = _width_m(piece.ground) < config.handle_width_m
    if gap < config.touching_m and piece.area_m2 < (2 if thin else 1) * config.crumb * other.area_m2:
        return True
    if piece.low < config.floats_m:
        return False
    return same_top or piece.area_m2 < 0.5 * other.area_m2


def _width_m(ground: np.ndarray) -> float:
    _, low, high = smallest_rectangle(ground)
    return float(high[1] - low[1])


def _caps(piece: _Piece, other: _Piece, config: MergeConfig) -> bool:
    """Whether a piece on top is the other's cap or pump: small, on something taller than wide."""
    tall = other.high > float(np.ptp(other.ground, axis=0).max())
    small = piece.area_m2 < config.cap * other.area_m2
    return tall and small and _share_within(piece.ground, other.ground, _CAP_M) > 0.5


def _joined(a: _Piece, b: _Piece, support: SupportPlane) -> _Piece:
    return _piece(np.vstack([a.points, b.points]), support, a.area_m2 + b.area_m2)


def _piece(points: np.ndarray, support: SupportPlane, area_m2: float) -> _Piece:
    points = points[:: -(-len(points) // _SAMPLE)]
    low, high = np.percentile(support.distances(points), (2, 98))
    ground = points @ rotation_between(support.normal, (0.0, 0.0, 1.0))[:2].T
    return _Piece(points, ground, float(low), float(high), area_m2)


def _gap(a: _Piece, b: _Piece) -> float:
    return float(np.percentile(KDTree(a.points).query(b.points)[0], 0.5))


def _share_within(ground: np.ndarray, outline: np.ndarray, margin_m: float) -> float:
    try:
        hull = ConvexHull(outline)
    except QhullError:
        return 0.0
    return float((ground @ hull.equations[:, :2].T + hull.equations[:, 2] <= margin_m).all(axis=1).mean())
