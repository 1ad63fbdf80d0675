"""Starts of the fit: how the object may rest on its support, and how it may be turned."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gfp_grasp.register.corners import corner_starts
from gfp_grasp.register.state import STANDING_SIGMA_RAD, PoseShape, start_of
from gfp_grasp.transforms import rotation_about, rotation_between
from gfp_grasp.types import GenericPrimitive, LevelView, Proposal

_LYING_SIGMA_RAD = np.deg2rad(15.0)
_YAWS = 8  # of a body without symmetry
_LEAST_SCALE = 0.01  # of a start: points may lie in a plane, or below what is taken for the floor
_FLAT = 1.15  # width over height of the points from which on a lying body may be flat; ours
_POSSIBLE = 0.05  # probability of a way of resting from which on it is tried beside the likeliest
_SURE = 0.8  # length of the proposed front from which on no other is tried
_CUT = 0.5  # cosine from which on a side counts as cut off
_MOST_SEEN = 0.85  # share of a side that is cut off; ours


def make_starts(primitive: GenericPrimitive, evidence: LevelView, hypotheses: tuple[str, ...]) -> list[PoseShape]:
    """Starts for each hypothesis, from the box of the points and the direction they were seen from.

    The hidden side is placed by the seen width: an object is about as deep as it is wide. A way of resting that the
    class never has is left out, unless the class has none of those asked for.
    """
    found = []
    for hypothesis in [way for way in hypotheses if way in primitive.spec.rests] or hypotheses:
        if hypothesis == "lying":
            boxes = _lying_boxes(evidence)
            found += [_lying(primitive, evidence, box) for box in boxes]
            found += [_lying(primitive, evidence, box, flat=True) for box in boxes if _is_flat(box, evidence)]
            continue
        box, toward = _box_along(evidence, hypothesis), _toward_viewer(evidence)
        for yaw in _yaws(primitive):
            found.append(_standing(primitive, evidence, hypothesis, box, rotation_about(evidence.up, yaw) @ toward))
    return found


def proposed_starts(primitive: GenericPrimitive, evidence: LevelView, hypotheses: tuple[str, ...]) -> list[PoseShape]:
    """Starts where one look at the object proposes; from boxes too where it lies, or may rest in another way.

    Where nobody has looked, or not at the primitive's class, these are the starts of `make_starts`.
    """
    proposal, rests = evidence.proposal, [way for way in hypotheses if way in primitive.spec.rests]
    if proposal is None or primitive.category not in proposal.classes or not rests:
        return make_starts(primitive, evidence, hypotheses)
    likeliest = max(rests, key=lambda way: proposal.rests[way])
    possible = tuple(way for way in rests if way != likeliest and proposal.rests[way] > _POSSIBLE)
    if evidence.sensor.step_rad and evidence.viewpoint is not None and likeliest == "upright":
        return [*corner_starts(primitive, evidence), _proposed(primitive, evidence, likeliest, 0.0)]
    if evidence.cut is not None:  # the look takes what it sees for nearly all; the class knows how long it is
        return make_starts(primitive, evidence, (likeliest, *possible))
    found = [_proposed(primitive, evidence, likeliest, yaw) for yaw in _proposed_yaws(primitive, proposal)]
    if likeliest == "lying":  # which way its axis points is what the look errs in
        possible = ("lying", *possible)
    return found + make_starts(primitive, evidence, possible)


def _proposed_yaws(primitive: GenericPrimitive, proposal: Proposal) -> np.ndarray:
    """Turns about the primitive's own axis that the proposal leaves open."""
    order = primitive.symmetry.order
    if not np.isinf(order) and proposal.sure_of_front >= _SURE:
        return np.zeros(1)
    return _yaws(primitive)


def _proposed(primitive: GenericPrimitive, evidence: LevelView, hypothesis: str, yaw: float) -> PoseShape:
    """The primitive in the proposed box, on the support, its axis as the hypothesis has it."""
    assert evidence.proposal is not None
    box = evidence.proposal.box
    z, x = box.T_world_box[:3, 2], box.T_world_box[:3, 0]
    if hypothesis == "lying":
        z = z - (z @ evidence.up) * evidence.up
        z = z / max(float(np.linalg.norm(z)), 1e-9)
    else:
        z = evidence.up if hypothesis == "upright" else -evidence.up
    R = _frame(z, x) @ rotation_about((0, 0, 1), yaw)
    low, high = primitive.vertices.min(axis=0), primitive.vertices.max(axis=0)
    scale = np.maximum(box.extents / (high - low), _LEAST_SCALE)
    sigma = _LYING_SIGMA_RAD if hypothesis == "lying" else STANDING_SIGMA_RAD
    state = start_of(primitive, R, np.zeros(3), scale, sigma, hypothesis)
    centre = box.T_world_box[:3, 3] - R @ (np.exp(state.log_scale) * (low + high) / 2)
    lowest = float((state.world(primitive.vertices) @ evidence.up).min())
    return replace(state, t=centre + (evidence.floor_m - lowest - float(centre @ evidence.up)) * evidence.up)


@dataclass(frozen=True, eq=False)
class _Box:
    """Extent of the points in the frame of one axis.

    Attributes:
        axis: (3,) unit.
        across: (3,) unit, across the axis and the line of sight: the side that is seen whole.
        deep: (3,) unit, across both, towards the viewer.
        height: Lower and upper end along the axis, m.
        width: Both ends along across, m.
        near: The end along deep that is nearest to the viewer, m.
    """

    axis: np.ndarray
    across: np.ndarray
    deep: np.ndarray
    height: tuple[float, float]
    width: tuple[float, float]
    near: float


@dataclass(frozen=True, eq=False)
class _LyingBox:
    """Extent of the points in the frame of a horizontal axis.

    Attributes:
        axis: (3,) unit.
        flat: (3,) unit, horizontal, across the axis.
        length: Both ends along the axis, m.
        top: Height of the highest points, m.
        middle: Median of the points along flat, m.
        width: Both ends along flat, m.
    """

    axis: np.ndarray
    flat: np.ndarray
    length: tuple[float, float]
    top: float
    middle: float
    width: tuple[float, float]


@lru_cache(maxsize=8)  # one evidence serves several primitives
def _box_along(evidence: LevelView, hypothesis: str) -> _Box:
    toward = _toward_viewer(evidence)
    axis = evidence.up if hypothesis == "upright" else -evidence.up
    across = np.cross(axis, toward)
    across /= np.linalg.norm(across)
    deep = np.cross(across, axis)
    deep *= np.sign(deep @ toward) or 1.0
    along, aside, depth = (evidence.points @ np.column_stack([axis, across, deep])).T
    low, high = (float(a) for a in np.quantile(along, (0.005, 0.995)))
    if hypothesis == "upright":
        low = min(low, evidence.floor_m)
    else:
        high = max(high, -evidence.floor_m)
    left, right = (float(a) for a in np.quantile(aside, (0.01, 0.99)))
    return _Box(axis, across, deep, (low, high), (left, right), float(np.quantile(depth, 0.99)))


@lru_cache(maxsize=8)
def _lying_boxes(evidence: LevelView) -> tuple[_LyingBox, ...]:
    found = []
    for axis in _long_axes(evidence):
        flat = np.cross(evidence.up, axis)
        flat /= np.linalg.norm(flat)
        along, height, aside = (evidence.points @ np.column_stack([axis, evidence.up, flat])).T
        low, high = (float(a) for a in np.quantile(along, (0.005, 0.995)))
        left, right = (float(a) for a in np.quantile(aside, (0.01, 0.99)))
        top, middle = float(np.quantile(height, 0.99)), float(np.median(aside))
        found.append(_LyingBox(axis, flat, (low, high), top, middle, (left, right)))
    return tuple(found)


def _standing(
    primitive: GenericPrimitive, evidence: LevelView, hypothesis: str, box: _Box, facing: np.ndarray
) -> PoseShape:
    """A start that stands on either end and whose x is as near to facing as it can be.

    The primitive, turned as this start has it, fills the side that is seen whole.
    """
    R = _frame(box.axis, facing)
    along, aside, depth = (primitive.vertices @ (R.T @ np.column_stack([box.axis, box.across, box.deep]))).T
    (low, high), (left, right) = box.height, box.width
    if evidence.cut is not None:
        (low, high), (left, right) = _complete_ends(
            box.height, float(np.ptp(along)), _cosine_in_picture(evidence, box.axis),
            box.width, float(np.ptp(aside)), _cosine_in_picture(evidence, box.across),
        )  # fmt: skip
    long = max((high - low) / float(np.ptp(along)), _LEAST_SCALE)
    wide = max((right - left) / float(np.ptp(aside)), _LEAST_SCALE)
    centre = (
        box.across * (left - wide * float(aside.min()))
        + box.deep * (box.near - wide * float(depth.max()))
        + box.axis * (low - long * float(along.min()))
    )
    return start_of(primitive, R, centre, (wide, wide, long), STANDING_SIGMA_RAD, hypothesis)


def _lying(primitive: GenericPrimitive, evidence: LevelView, box: _LyingBox, *, flat: bool = False) -> PoseShape:
    """A start that lies along an axis, on the support, and is as high as the points; a flat one is as wide as they."""
    R = _frame(box.axis, evidence.up)
    along, height, aside = (primitive.vertices @ (R.T @ np.column_stack([box.axis, evidence.up, box.flat]))).T
    low, high = box.length
    long = max((high - low) / float(np.ptp(along)), _LEAST_SCALE)
    tall = max((box.top - evidence.floor_m) / float(np.ptp(height)), _LEAST_SCALE)
    wide, middle = tall, box.middle
    if flat:
        wide, middle = (box.width[1] - box.width[0]) / float(np.ptp(aside)), sum(box.width) / 2
    centre = (
        evidence.up * (evidence.floor_m - tall * float(height.min()))
        + box.flat * middle
        + box.axis * (low - long * float(along.min()))
    )
    return start_of(primitive, R, centre, (tall, wide, long), _LYING_SIGMA_RAD, "lying")


def _is_flat(box: _LyingBox, evidence: LevelView) -> bool:
    """Whether the points are wider than they are high, as those of a round body that lies never are."""
    return box.width[1] - box.width[0] > _FLAT * (box.top - evidence.floor_m)


def _frame(axis: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """Rotation (3, 3) whose z is axis and whose x is as near to facing as it can be."""
    x = facing - (facing @ axis) * axis
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])


def _cosine_in_picture(evidence: LevelView, direction: np.ndarray) -> float:
    """Cosine between a direction, as it is seen, and the direction in which the object is cut off."""
    assert evidence.cut is not None
    assert evidence.viewpoint is not None
    sight = evidence.viewpoint - evidence.points.mean(axis=0)
    sight /= np.linalg.norm(sight)
    seen = direction - (direction @ sight) * sight
    return float(evidence.cut @ seen / (np.linalg.norm(seen) + 1e-9))


def _complete_ends(
    height: tuple[float, float],
    own_height: float,
    cut_up: float,
    width: tuple[float, float],
    own_width: float,
    cut_across: float,
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ends along and across the axis; an end that is cut off is moved to where the primitive's proportions put it.

    Where both directions are cut off, nothing but the primitive's own size is known.
    """
    scale_by_width = (width[1] - width[0]) / own_width if abs(cut_across) < _CUT else 1.0
    scale_by_height = (height[1] - height[0]) / own_height if abs(cut_up) < _CUT else 1.0
    ends = []
    for (low, high), own, cut, scale in (
        (height, own_height, cut_up, scale_by_width),
        (width, own_width, cut_across, scale_by_height),
    ):
        whole = max((high - low) / _MOST_SEEN, own * scale)
        ends.append((high - whole if cut < -_CUT else low, low + whole if cut > _CUT else high))
    return ends[0], ends[1]


@lru_cache(maxsize=8)
def _toward_viewer(evidence: LevelView) -> np.ndarray:
    """Horizontal unit direction from the points to the viewer; without one, the shortest side of the points."""
    up = evidence.up
    flat = np.eye(3) - np.outer(up, up)
    centred = (evidence.points - evidence.points.mean(axis=0)) @ flat
    if evidence.viewpoint is not None:
        toward = flat @ (evidence.viewpoint - evidence.points.mean(axis=0))
        if np.linalg.norm(toward) > 1e-3:
            return toward / np.linalg.norm(toward)
    basis = rotation_between((0, 0, 1), up)[:, :2]
    _, vectors = np.linalg.eigh((centred @ basis).T @ (centred @ basis))
    return basis @ vectors[:, 0]


def _long_axes(evidence: LevelView) -> list[np.ndarray]:
    """Horizontal directions that the axis of a lying object may have: along the points and across them, both ways."""
    basis = rotation_between((0, 0, 1), evidence.up)[:, :2]
    flat = (evidence.points - evidence.points.mean(axis=0)) @ basis
    _, vectors = np.linalg.eigh(flat.T @ flat)
    long, short = basis @ vectors[:, 1], basis @ vectors[:, 0]
    return [long, -long, short, -short]


def _yaws(primitive: GenericPrimitive) -> np.ndarray:
    order = primitive.symmetry.order
    if np.isinf(order):
        return np.array([0.0, np.pi / 4])  # one of them nearly turns an elliptic member of a round class
    if order > 1:
        return np.arange(3) / 3 * 2 * np.pi / order
    return np.arange(_YAWS) / _YAWS * 2 * np.pi
