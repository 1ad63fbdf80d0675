"""Procrustes alignment of corresponded members: onto one of them, onto their mean, and the mean's modes.

Modes are what the scales of the mean's axes cannot explain.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.errors import InvalidMesh
from gfp_grasp.meshes import sample_surface
from gfp_grasp.transforms import make_T

_NUM_SAMPLES = 400
# Weight of normals against positions in unit boxes: the two sides of a wall are then as far apart as half the object.
_NORMAL_WEIGHT = 0.25


def choose_template(members: Sequence[trimesh.Trimesh], rng: np.random.Generator, *, num_candidates: int = 24) -> int:
    """Index of the most central member among those of the commonest topology.

    Members are compared in unit boxes, by position and normal, so that scale plays no part.

    Args:
        members: Closed, in one orientation.
        rng: Chooses candidates and draws samples.
        num_candidates: As many are compared with each other.
    """
    commonest = Counter(int(member.euler_number) for member in members).most_common(1)[0][0]
    fitting = [i for i, member in enumerate(members) if member.euler_number == commonest]
    chosen = rng.permutation(fitting)[:num_candidates]
    features = [_features(members[i], rng) for i in chosen]
    trees = [KDTree(feature) for feature in features]
    distance = np.array([[tree.query(feature)[0].mean() for tree in trees] for feature in features])
    # The median, not the mean: a few outliers do not decide which one is central.
    return int(chosen[np.median(distance + distance.T, axis=1).argmin()])


def _features(mesh: trimesh.Trimesh, rng: np.random.Generator) -> np.ndarray:
    points, normals, _ = sample_surface(mesh, _NUM_SAMPLES, rng)
    return np.hstack([(points - mesh.bounds[0]) / mesh.extents, normals * _NORMAL_WEIGHT])


@dataclass(frozen=True, eq=False)
class Similarity:
    """x -> scale * R @ x + t, a proper similarity: R (3, 3) is a rotation, t (3,) m, scale is positive."""

    scale: float
    R: np.ndarray
    t: np.ndarray

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Move (..., 3) points."""
        return self.scale * np.asarray(points, dtype=np.float64) @ self.R.T + self.t

    def matrix(self) -> np.ndarray:
        """(4, 4) homogeneous matrix; its upper left block is scale * R."""
        return make_T(self.scale * self.R, self.t)


@dataclass(frozen=True, eq=False)
class GeneralizedProcrustes:
    """A class brought into one frame.

    Attributes:
        mean: (v, 3) mean of the aligned shapes; centroid at zero, size the geometric mean of the members'.
        aligned: (s, v, 3) every shape, moved (and scaled) onto the mean.
        transforms: The similarity that took each shape there.
        iterations: How many rounds it took.
    """

    mean: np.ndarray
    aligned: np.ndarray
    transforms: tuple[Similarity, ...]
    iterations: int


def align(
    source: np.ndarray,
    target: np.ndarray,
    *,
    scaling: bool = True,
    weights: np.ndarray | None = None,
    axis: np.ndarray | None = None,
) -> Similarity:
    """The similarity that takes source nearest to target in least squares, never a reflection.

    Umeyama, IEEE PAMI 13(4), 1991; with an axis, the closed form of the one angle that is left.

    Args:
        source: (v, 3) points.
        target: (v, 3) points, row by row the counterparts of source.
        scaling: Whether the scale is free; else it is 1.
        weights: (v,) not negative, or None for equal ones.
        axis: (3,) unit: turn about this axis only; None for any rotation.

    Raises:
        InvalidMesh: Shapes differ, fewer than three points, values not finite, or all points coincide.
    """
    source, target = _points(source, "source"), _points(target, "target")
    if source.shape != target.shape:
        raise InvalidMesh(
            f"source has {len(source)} points, target {len(target)}: give corresponding points, row by row"
        )
    w = np.full(len(source), 1.0) if weights is None else np.asarray(weights, dtype=np.float64)
    w = w / w.sum()
    source_centre, target_centre = w @ source, w @ target
    s, t = source - source_centre, target - target_centre
    covariance = (s * w[:, None]).T @ t
    spread = float(w @ (s**2).sum(axis=1))
    if spread <= 0:
        raise InvalidMesh("all source points coincide: there is nothing to align")
    R = _rotation(covariance) if axis is None else _rotation_about(covariance, np.asarray(axis, dtype=np.float64))
    scale = float(np.trace(R @ covariance)) / spread if scaling else 1.0
    scale = max(scale, np.finfo(float).eps)  # opposed shapes would shrink through zero
    return Similarity(scale, R, target_centre - scale * R @ source_centre)


def generalized(
    shapes: np.ndarray,
    *,
    scaling: bool = True,
    weights: np.ndarray | None = None,
    axis: np.ndarray | None = None,
    tolerance: float = 1e-8,
    max_iterations: int = 100,
) -> GeneralizedProcrustes:
    """Generalized Procrustes Analysis: all shapes onto their common mean (Gower, Psychometrika 40, 1975).

    Args:
        shapes: (s, v, 3) corresponding points.
        scaling: Whether each shape may be scaled.
        weights: (v,) of the points, e.g. their areas, or None.
        axis: (3,) unit: turn about this axis only; None for any rotation.
        tolerance: Stop when the mean moves by less than this share of its size.
        max_iterations: Or after so many rounds.

    Raises:
        InvalidMesh: Not (s >= 1, v >= 3, 3), not finite, or a shape of no extent.
    """
    shapes = np.asarray(shapes, dtype=np.float64)
    if shapes.ndim != 3 or shapes.shape[2] != 3 or shapes.shape[0] < 1:
        raise InvalidMesh(f"shapes have shape {shapes.shape}; (s, v, 3) with at least one shape is expected")
    w = np.full(shapes.shape[1], 1.0 / shapes.shape[1]) if weights is None else np.asarray(weights) / np.sum(weights)
    sizes = np.array([centroid_size(shape, weights=w) for shape in shapes])
    size = float(np.exp(np.log(sizes).mean())) if scaling else 0.0
    mean = _centred(shapes[0], w) * (size / sizes[0] if scaling else 1.0)
    transforms: list[Similarity] = []
    aligned = shapes
    rounds = 0
    while rounds < max_iterations:
        rounds += 1
        transforms = [align(shape, mean, scaling=scaling, weights=w, axis=axis) for shape in shapes]
        aligned = np.stack([move.apply(shape) for move, shape in zip(transforms, shapes, strict=True)])
        new = _centred(aligned.mean(axis=0), w)
        if scaling:  # without this the mean shrinks a little in each round
            new = new * (size / centroid_size(new, weights=w))
        moved = centroid_size(new - mean, weights=w, centre=False)
        mean = new
        if moved <= tolerance * centroid_size(mean, weights=w):
            break
    return GeneralizedProcrustes(mean, aligned, tuple(transforms), rounds)


def centroid_size(points: np.ndarray, *, weights: np.ndarray | None = None, centre: bool = True) -> float:
    """Root of the (weighted) mean squared distance of (v, 3) points from their centroid, or from zero."""
    w = np.full(len(points), 1.0 / len(points)) if weights is None else np.asarray(weights) / np.sum(weights)
    offsets = _centred(points, w) if centre else points
    return float(np.sqrt(w @ (offsets**2).sum(axis=1)))


def _centred(points: np.ndarray, w: np.ndarray) -> np.ndarray:
    return points - w @ points


def _rotation(covariance: np.ndarray) -> np.ndarray:
    """The rotation R with the largest trace(R @ covariance)."""
    U, _, Vt = np.linalg.svd(covariance)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(Vt.T @ U.T))])  # det -1 would be a reflection
    return Vt.T @ flip @ U.T


def _rotation_about(covariance: np.ndarray, axis: np.ndarray) -> np.ndarray:
    axis = axis / np.linalg.norm(axis)
    cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    along = np.outer(axis, axis)
    cosine = np.trace(covariance) - axis @ covariance @ axis
    angle = np.arctan2(np.trace(cross @ covariance), cosine)
    return np.cos(angle) * (np.eye(3) - along) + np.sin(angle) * cross + along


def _points(points: np.ndarray, name: str) -> np.ndarray:
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 3 or not np.isfinite(points).all():
        raise InvalidMesh(f"{name} has shape {points.shape}; at least three finite points (v, 3) are expected")
    return points


_ROUNDS = 20
# Modes that are set aside for outliers, a vessel with a stem among many without, so that they do not bend the others.
_FOR_OUTLIERS = 4
# Members that differ by less than this share of their size are alike, and none of them is an outlier.
_ALIKE = 0.002
# A member whose coordinates along an axis correlate less than this with the mean's has no scale of its own along it.
_LIKE_SCALED = 0.5
# A deviation below this share of the size is rounding.
_NOTHING = 1e-7
# A mode below this share of the variance has no direction worth keeping.
_LEAST_SHARE = 1e-5


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """Statistics of a class.

    Attributes:
        mean: (v, 3) m.
        modes: (k, v, 3) m, each for one standard deviation; first those of the usual members, then those of outliers.
        explained: (k,) share of the variance that is left after scale.
        log_scale: (s, 3) natural logarithm of each member's scale along x, y and z; its mean is zero.
        coefficients: (s, k) of the members, in standard deviations.
        variance_m2: Mean squared vertex distance of the members from the mean, after scale.
        outlier: (s,) bool, members far from the rest.
    """

    mean: np.ndarray
    modes: np.ndarray
    explained: np.ndarray
    log_scale: np.ndarray
    coefficients: np.ndarray
    variance_m2: float
    outlier: np.ndarray


def shape_model(
    members: np.ndarray,
    weights: np.ndarray,
    *,
    variance: float = 0.99,
    max_modes: int = 24,
    outlier_beyond: float = 2.5,
) -> ShapeModel:
    """Factor members into scale * (mean + modes), scale about the frame's origin.

    Args:
        members: (s, v, 3) m, corresponded, in the primitive's frame: axis through x = y = 0, base at z = 0.
        weights: (v,) areas; the modes are orthogonal under them.
        variance: Keep the fewest modes that explain this share.
        max_modes: And never more than this.
        outlier_beyond: Members that are this many times farther from the mean than the median member are outliers:
            they shape neither the mean nor the main modes, but get modes of their own.

    Raises:
        InvalidMesh: Fewer than two members, or a member that is turned over against the mean.
    """
    if members.ndim != 3 or len(members) < 2:
        raise InvalidMesh(f"members have shape {members.shape}; at least two shapes (s >= 2, v, 3) are expected")
    w = weights / weights.sum()
    usual = np.ones(len(members), dtype=bool)
    mean, log_scale, rest = _scale_and_mean(members, w, usual)
    distance = np.sqrt(np.einsum("v,svc->s", w, rest**2))
    size = float(np.sqrt(w @ (mean**2).sum(axis=1)))
    usual = distance <= outlier_beyond * max(float(np.median(distance)), _ALIKE * size)
    mean, log_scale, rest = _scale_and_mean(members, w, usual)

    root = np.sqrt(np.repeat(w, 3))
    flat = rest.reshape(len(members), -1) * root
    total = float((flat**2).sum() / (len(members) - 1))
    reserved = min(_FOR_OUTLIERS, int((~usual).sum()), max_modes - 1)
    if total < (_NOTHING * size) ** 2:
        flat = np.zeros_like(flat)
    axes = _principal(flat[usual], variance, max_modes - reserved)
    num_main = len(axes)
    left = flat - flat @ axes.T @ axes
    if reserved and (left**2).sum() / (len(members) - 1) > (1 - variance) * total:
        axes = np.concatenate([axes, _principal(left, 1.0, reserved)])
    axes = axes * np.where(axes.sum(axis=1) < 0, -1.0, 1.0)[:, None]  # the sign is free: fix it
    scores = flat @ axes.T
    spread = np.where(np.arange(len(axes)) < num_main, _deviation(scores[usual]), _deviation(scores))
    modes = (axes / root * spread[:, None]).reshape(len(axes), len(w), 3)
    explained = (scores**2).sum(axis=0) / (len(members) - 1) / max(total, 1e-300)
    return ShapeModel(mean, modes, explained, log_scale, scores / spread, total, ~usual)


def _scale_and_mean(members: np.ndarray, w: np.ndarray, usual: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Alternate each member's least-squares scale and the mean of the usual ones; their mean log scale stays zero."""
    mean = members[usual].mean(axis=0)
    log_scale = np.zeros((len(members), 3))
    posed = _posed(members, mean, w)
    for _ in range(_ROUNDS):
        spread = w @ mean**2
        product = np.einsum("v,svc,vc->sc", w, members, mean)
        ratio = product / np.maximum(spread, 1e-300)
        ratio[:, posed] = product[:, ~posed].sum(axis=1, keepdims=True) / spread[~posed].sum()
        if (ratio <= 0).any():
            raise InvalidMesh("a member is turned over against the mean: its scale along an axis is not positive")
        log_scale = np.log(ratio)
        log_scale -= log_scale[usual].mean(axis=0)
        mean = (members / np.exp(log_scale)[:, None])[usual].mean(axis=0)
    return mean, log_scale, members / np.exp(log_scale)[:, None] - mean


def _posed(members: np.ndarray, mean: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Axes (3,) bool along which some member is no scaled mean (legs that walk): they take the others' scale."""
    length = np.einsum("v,svc->sc", w, members**2) * (w @ mean**2)
    likeness = np.einsum("v,svc,vc->sc", w, members, mean) / np.sqrt(np.maximum(length, 1e-300))
    posed = (np.abs(likeness) < _LIKE_SCALED).any(axis=0)
    return posed & ~posed.all()


def _principal(flat: np.ndarray, variance: float, most: int) -> np.ndarray:
    """Orthonormal rows (k, 3 v) that explain the share `variance` of the second moment, `most` of them at most."""
    _, values, axes = np.linalg.svd(flat, full_matrices=False)
    power = values**2
    share = power / max(float(power.sum()), 1e-300)
    # The mean takes one degree of freedom.
    useful = min(int((share > _LEAST_SHARE).sum()), max(len(flat) - 1, 1), most)
    return axes[: min(useful, int(np.searchsorted(np.cumsum(share), variance)) + 1)]


def _deviation(scores: np.ndarray) -> np.ndarray:
    return np.sqrt((scores**2).sum(axis=0) / max(len(scores) - 1, 1))
