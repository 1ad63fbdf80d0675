"""Where the fit starts: how the object may rest on its support, and how it may be turned."""

from __future__ import annotations

import numpy as np

from gfp_grasp.register.evidence import Evidence
from gfp_grasp.register.state import PoseShape
from gfp_grasp.transforms import rotation_about, rotation_between
from gfp_grasp.types import GenericPrimitive

# Negative log odds of how things rest on tables; ours, from the share of each in common table scenes, not measured.
HYPOTHESIS_COST = {"upright": 0.0, "upside_down": 4.0, "lying": 6.0}
_STANDING_SIGMA_RAD = np.deg2rad(1.0)
_LYING_SIGMA_RAD = np.deg2rad(15.0)
_HANDLE_YAWS = 8
_CUT = 0.5  # cosine from which on a side counts as the one that is cut off


def starts(primitive: GenericPrimitive, evidence: Evidence, hypotheses: tuple[str, ...]) -> list[PoseShape]:
    """Starts for each hypothesis, from the box of the points and the direction they were seen from.

    The hidden side is placed by the seen width: an object is about as deep as it is wide.
    """
    up, toward = evidence.up, _toward_viewer(evidence)
    found = []
    for hypothesis in hypotheses:
        if hypothesis == "lying":
            for axis in _long_axes(evidence):
                found.append(_start(primitive, evidence, hypothesis, axis, up, _LYING_SIGMA_RAD))
            continue
        axis = up if hypothesis == "upright" else -up
        for yaw in _yaws(primitive):
            facing = rotation_about(up, yaw) @ toward
            found.append(_start(primitive, evidence, hypothesis, axis, facing, _STANDING_SIGMA_RAD))
    return found


def _start(
    primitive: GenericPrimitive,
    evidence: Evidence,
    hypothesis: str,
    axis: np.ndarray,
    facing: np.ndarray,
    axis_sigma_rad: float,
) -> PoseShape:
    """A start whose z is axis and whose x is as near facing as it can be."""
    x = facing - (facing @ axis) * axis
    x /= np.linalg.norm(x)
    R = np.column_stack([x, np.cross(axis, x), axis])
    up, toward = evidence.up, _toward_viewer(evidence)
    points = evidence.points
    turned = primitive.vertices @ R.T
    low, high = (float(a) for a in np.quantile(points @ axis, (0.005, 0.995)))
    if hypothesis == "upright":
        low = min(low, evidence.floor_m)
    elif hypothesis == "upside_down":
        high = max(high, -evidence.floor_m)
    long = max(high - low, 1e-3) / float(np.ptp(turned @ axis))
    # The side that is seen whole is the one across both the axis and the line of sight: the primitive, with its
    # handle where this start has it, fills it.
    across = np.cross(axis, toward)
    if np.linalg.norm(across) < 0.3:
        across = np.cross(axis, up)
    across /= np.linalg.norm(across)
    deep = np.cross(across, axis)
    deep *= np.sign(deep @ toward) or 1.0
    if hypothesis == "lying":
        # What lies is as high as it is thick, and its middle is half of that above the support.
        top = max(float(np.quantile(points @ up, 0.99)) - evidence.floor_m, 1e-3)
        wide = top / float(np.ptp(turned @ up))
        flat = np.cross(up, axis)
        flat /= np.linalg.norm(flat)
        centre = up * (evidence.floor_m - wide * float((turned @ up).min())) + flat * float(np.median(points @ flat))
    else:
        left, right = (float(a) for a in np.quantile(points @ across, (0.01, 0.99)))
        if evidence.cut is not None:
            (low, high), (left, right) = _as_it_goes_on(
                (low, high), float(np.ptp(turned @ axis)), _cosine_in_picture(evidence, axis),
                (left, right), float(np.ptp(turned @ across)), _cosine_in_picture(evidence, across),
            )  # fmt: skip
            long = (high - low) / float(np.ptp(turned @ axis))
        wide = max(right - left, 1e-3) / float(np.ptp(turned @ across))
        near = float(np.quantile(points @ deep, 0.99))
        centre = across * (left - wide * float((turned @ across).min())) + deep * (
            near - wide * float((turned @ deep).max())
        )
    centre = centre + axis * (low - long * float((turned @ axis).min()))
    sigma = 2.0 * np.sqrt(np.diag(primitive.log_scale_cov) + 1e-4)
    log_scale = np.clip(np.log([wide, wide, long]), -sigma, sigma)
    return PoseShape(
        R=R,
        t=centre,
        log_scale=np.asarray(log_scale),
        coefficients=np.zeros(len(primitive.modes)),
        axis_world=axis,
        axis_sigma_rad=float(axis_sigma_rad),
        hypothesis=hypothesis,
    )


def _cosine_in_picture(evidence: Evidence, direction: np.ndarray) -> float:
    """Of a direction, as it is seen, with that in which the object is cut off."""
    assert evidence.cut is not None
    assert evidence.viewpoint is not None
    sight = evidence.viewpoint - evidence.points.mean(axis=0)
    sight /= np.linalg.norm(sight)
    seen = direction - (direction @ sight) * sight
    return float(evidence.cut @ seen / (np.linalg.norm(seen) + 1e-9))


def _as_it_goes_on(
    height: tuple[float, float],
    own_height: float,
    cut_up: float,
    width: tuple[float, float],
    own_width: float,
    cut_across: float,
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Ends along and across the axis, those that are cut off moved to where the primitive's proportions have them.

    Where both are, the primitive's own size is all that is known.
    """
    scale_by_width = (width[1] - width[0]) / own_width if abs(cut_across) < _CUT else 1.0
    scale_by_height = (height[1] - height[0]) / own_height if abs(cut_up) < _CUT else 1.0
    ends = []
    for (low, high), own, cut, scale in (
        (height, own_height, cut_up, scale_by_width),
        (width, own_width, cut_across, scale_by_height),
    ):
        whole = max(high - low, own * scale)
        ends.append((high - whole if cut < -_CUT else low, low + whole if cut > _CUT else high))
    return ends[0], ends[1]


def _toward_viewer(evidence: Evidence) -> np.ndarray:
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


def _long_axes(evidence: Evidence) -> list[np.ndarray]:
    """Horizontal directions that a lying object's axis may have: along the points and across them, both ways."""
    basis = rotation_between((0, 0, 1), evidence.up)[:, :2]
    flat = (evidence.points - evidence.points.mean(axis=0)) @ basis
    _, vectors = np.linalg.eigh(flat.T @ flat)
    long, short = basis @ vectors[:, 1], basis @ vectors[:, 0]
    return [long, -long, short, -short]


def _yaws(primitive: GenericPrimitive) -> np.ndarray:
    order = primitive.symmetry.order
    if np.isinf(order):
        return np.array([0.0, np.pi / 4])  # an oval member of a round class is turned by one of these, nearly
    if order > 1:
        return np.arange(3) / 3 * 2 * np.pi / order
    return np.arange(_HANDLE_YAWS) / _HANDLE_YAWS * 2 * np.pi
