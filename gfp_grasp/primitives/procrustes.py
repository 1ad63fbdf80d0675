"""Procrustes alignment of corresponding points: one onto another, and a whole class onto its mean."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gfp_grasp.errors import InvalidMesh
from gfp_grasp.transforms import make_T


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
