"""Pieces of surface that are one object, and pieces that are not; the smallest upright box around points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, KDTree, QhullError

from gfp_grasp.transforms import make_T, rotation_between
from gfp_grasp.types import OrientedBox, SensorProfile, SupportPlane


def upright_box(points: np.ndarray, up: np.ndarray) -> OrientedBox:
    """Box with its z along up and the smallest ground area, around all of (n, 3) points, m.

    Its x runs along the longer ground side.
    """
    R = rotation_between(up, (0.0, 0.0, 1.0))
    level = points @ R.T
    axes, low, high = smallest_rectangle(level[:, :2])
    z = np.array([level[:, 2].min(), level[:, 2].max()])
    centre = np.append(axes.T @ ((low + high) / 2), z.mean())
    turn = np.eye(3)
    turn[:2, :2] = axes.T
    return OrientedBox(make_T(R.T @ turn, R.T @ centre), np.append(high - low, z[1] - z[0]))


def smallest_rectangle(ground: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rectangle of smallest area around (n, 2) points; one of its sides lies along an edge of their hull.

    Returns:
        axes (2, 2), a right-handed pair of rows, the longer side first; low (2,) and high (2,) along them.
    """
    try:
        corners = ground[ConvexHull(ground).vertices]
    except QhullError:  # a line or a point: the axes of its spread
        corners = ground
        edges = np.linalg.svd(ground - ground.mean(axis=0), full_matrices=False)[2][:1]
    else:
        edges = np.roll(corners, -1, axis=0) - corners
    edges = edges / np.maximum(np.linalg.norm(edges, axis=1, keepdims=True), 1e-12)
    frames = np.stack([edges, np.column_stack([-edges[:, 1], edges[:, 0]])], axis=1)
    along = np.einsum("fij,nj->fin", frames, corners)
    low, high = along.min(axis=2), along.max(axis=2)
    best = int(np.argmin(np.prod(high - low, axis=1)))
    axes, low, high = frames[best], low[best], high[best]
    if high[0] - low[0] >= high[1] - low[1]:
        return axes, low, high
    # A quarter turn: the second axis becomes the first, and the first, reversed, the second.
    return np.stack([axes[1], -axes[0]]), np.array([low[1], -high[0]]), np.array([high[1], -low[0]])


# Multiples of the sensor's noise:
_GAP = 10.0  # two pieces of one object are this near in space
_RIM_GAP = 40.0  # the far inside of a rim begins this near behind the near outside
_TOUCHING = 10 / 3  # a piece this near, and much smaller than the other, belongs to it
_HANDLE_WIDTH = 50 / 3  # a piece this narrow on the ground is a handle, which may be larger
_FLOATS = 10.0  # a piece whose lowest point is higher than this cannot stand by itself
_SAME_TOP = 8.0  # tops that agree to this are two sides of one rim
_NOISE, _RIM, _CAP = 2.0, 20 / 3, 40 / 3  # how far beyond an outline still counts as inside it

_MAX_WIDTH = 0.2  # no merging into anything wider; in the sensor's largest
_ON_TOP = 0.8  # a piece that begins above this share of the other's height stands on it
_WITHIN = 0.7  # share of a piece's ground points inside the other's outline from which it is inside the other
_CRUMB = 0.15  # largest share of surface that what touches has of what it belongs to; a handle may have twice that
_CAP_SHARE = 0.3  # largest share of surface that a cap or pump has of its bottle
_COMPACT = 1.4  # length over width of the ground outline of one object in two pieces
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
    sensor: SensorProfile,
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
        sensor: Its noise and sizes are the units of all thresholds.

    Returns:
        (p + 1,) int, the object of each piece; 0 stays 0.
    """
    group = np.arange(int(pieces.max(initial=0)) + 1)
    known = {int(k): _piece(points[pieces == k], support, float(area_m2[pieces == k].sum())) for k in group[1:]}
    waiting = sorted(known, key=lambda k: known[k].area_m2)
    while waiting:
        k = waiting.pop(0)
        near = [m for m in known if m != k and _box_gap_m(known[k], known[m]) <= _RIM_GAP * sensor.sigma_m]
        others = sorted((_gap(known[k], known[m]), m) for m in near)
        owner = next((m for gap, m in others if _belongs(known[k], known[m], gap, sensor)), None)
        if owner is None:
            continue
        group[group == k] = owner
        known[owner] = _joined(known[owner], known.pop(k), support)
        waiting = sorted({*waiting, owner}, key=lambda k: known[k].area_m2)  # grown, it may now belong elsewhere
    return group


def _belongs(piece: _Piece, other: _Piece, gap: float, sensor: SensorProfile) -> bool:
    sigma_m = sensor.sigma_m
    if gap > _RIM_GAP * sigma_m:
        return False
    _, low, high = smallest_rectangle(np.vstack([piece.ground, other.ground]))
    length, width = high - low
    if length > _MAX_WIDTH * sensor.largest_m:
        return False
    if piece.low > _ON_TOP * other.high or other.low > _ON_TOP * piece.high:
        return gap < _GAP * sigma_m and (_caps(piece, other, sigma_m) or _caps(other, piece, sigma_m))
    same_top = abs(piece.high - other.high) < _SAME_TOP * sigma_m
    if same_top and length < _COMPACT * width:
        return True
    if gap > _GAP * sigma_m:
        return False
    margin_m = (
        _RIM if same_top else _NOISE
    ) * sigma_m  # the outside of a wall lies a wall's thickness beyond its inside
    if _share_within(piece.ground, other.ground, margin_m) > _WITHIN:
        return True
    thin = _width_m(piece.ground) < _HANDLE_WIDTH * sigma_m
    if gap < _TOUCHING * sigma_m and piece.area_m2 < (2 if thin else 1) * _CRUMB * other.area_m2:
        return True
    if piece.low < _FLOATS * sigma_m:
        return False
    return same_top or piece.area_m2 < 0.5 * other.area_m2


def _width_m(ground: np.ndarray) -> float:
    _, low, high = smallest_rectangle(ground)
    return float(high[1] - low[1])


def _caps(piece: _Piece, other: _Piece, sigma_m: float) -> bool:
    """Whether a piece on top is the other's cap or pump: small, on something taller than wide."""
    tall = other.high > float(np.ptp(other.ground, axis=0).max())
    small = piece.area_m2 < _CAP_SHARE * other.area_m2
    return tall and small and _share_within(piece.ground, other.ground, _CAP * sigma_m) > 0.5


def _joined(a: _Piece, b: _Piece, support: SupportPlane) -> _Piece:
    return _piece(np.vstack([a.points, b.points]), support, a.area_m2 + b.area_m2)


def _piece(points: np.ndarray, support: SupportPlane, area_m2: float) -> _Piece:
    points = points[:: -(-len(points) // _SAMPLE)]
    low, high = np.percentile(support.distances(points), (2, 98))
    ground = points @ rotation_between(support.normal, (0.0, 0.0, 1.0))[:2].T
    return _Piece(points, ground, float(low), float(high), area_m2)


def _box_gap_m(a: _Piece, b: _Piece) -> float:
    """Gap between the boxes of two pieces along the axes, m: no point of one is nearer to the other."""
    apart = np.maximum(a.points.min(axis=0) - b.points.max(axis=0), b.points.min(axis=0) - a.points.max(axis=0))
    return float(np.linalg.norm(np.maximum(apart, 0.0)))


def _gap(a: _Piece, b: _Piece) -> float:
    return float(np.percentile(KDTree(a.points).query(b.points)[0], 0.5))


def _share_within(ground: np.ndarray, outline: np.ndarray, margin_m: float) -> float:
    try:
        hull = ConvexHull(outline)
    except QhullError:
        return 0.0
    return float((ground @ hull.equations[:, :2].T + hull.equations[:, 2] <= margin_m).all(axis=1).mean())
