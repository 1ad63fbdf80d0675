"""From corresponded members to a mean, the scales of its axes, and the modes that scale cannot explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gfp_grasp.errors import InvalidMesh

_ROUNDS = 20
# Modes that are set aside for outliers, a vessel with a stem among many without, so that they do not bend the others.
_FOR_OUTLIERS = 4
# Members that differ by less than this share of their size are alike, and none of them is an outlier.
_ALIKE = 0.002
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
    for _ in range(_ROUNDS):
        spread = w @ mean**2
        ratio = np.einsum("v,svc,vc->sc", w, members, mean) / np.maximum(spread, 1e-300)
        if (ratio <= 0).any():
            raise InvalidMesh("a member is turned over against the mean: its scale along an axis is not positive")
        log_scale = np.log(ratio)
        log_scale -= log_scale[usual].mean(axis=0)
        mean = (members / np.exp(log_scale)[:, None])[usual].mean(axis=0)
    return mean, log_scale, members / np.exp(log_scale)[:, None] - mean


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
