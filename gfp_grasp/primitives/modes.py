"""From corresponded members to a mean, the scales of its axes, and the modes that scale cannot explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gfp_grasp.errors import InvalidMesh

_ROUNDS = 20


@dataclass(frozen=True, eq=False)
class ShapeModel:
    """Statistics of a class.

    Attributes:
        mean: (v, 3) m.
        modes: (k, v, 3) m, each for one standard deviation.
        explained: (k,) share of the variance that is left after scale.
        log_scale: (s, 3) natural logarithm of each member's scale along x, y and z; its mean is zero.
        coefficients: (s, k) of the members, of unit variance.
        variance_m2: Mean squared vertex distance of the members from the mean, after scale.
    """

    mean: np.ndarray
    modes: np.ndarray
    explained: np.ndarray
    log_scale: np.ndarray
    coefficients: np.ndarray
    variance_m2: float


def shape_model(members: np.ndarray, weights: np.ndarray, *, variance: float = 0.99, max_modes: int = 24) -> ShapeModel:
    """Factor members into scale * (mean + modes), scale about the frame's origin.

    Args:
        members: (s, v, 3) m, corresponded, in the primitive's frame: axis through x = y = 0, base at z = 0.
        weights: (v,) areas; the modes are orthogonal under them.
        variance: Keep the fewest modes that explain this share.
        max_modes: And never more than this.

    Raises:
        InvalidMesh: Fewer than two members, or a member without extent along an axis.
    """
    if members.ndim != 3 or len(members) < 2:
        raise InvalidMesh(f"members have shape {members.shape}; at least two shapes (s >= 2, v, 3) are expected")
    w = weights / weights.sum()
    mean, log_scale = _scale_and_mean(members, w)
    rest = (members / np.exp(log_scale)[:, None] - mean).reshape(len(members), -1)
    root = np.sqrt(np.repeat(w, 3))
    _, values, axes = np.linalg.svd(rest * root, full_matrices=False)
    power = values**2 / (len(members) - 1)
    total = float(power.sum())
    share = power / max(total, 1e-300)
    # The mean takes one degree of freedom, and a mode of no power has no direction.
    useful = int(min((share > 1e-6).sum(), len(members) - 1, max_modes))
    count = min(useful, int(np.searchsorted(np.cumsum(share), variance)) + 1)
    deviation = np.sqrt(power[:count])
    axes = axes[:count] * np.where(axes[:count].sum(axis=1) < 0, -1.0, 1.0)[:, None]  # the sign is free: fix it
    modes = (axes / root * deviation[:, None]).reshape(count, -1, 3)
    coefficients = (rest * root) @ axes.T / deviation
    return ShapeModel(mean, modes, share[:count], log_scale, coefficients, total)


def _scale_and_mean(members: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Alternate each member's least-squares scale and the mean; the geometric mean of the scales is kept at one."""
    mean = members.mean(axis=0)
    log_scale = np.zeros((len(members), 3))
    for _ in range(_ROUNDS):
        spread = w @ mean**2
        ratio = np.einsum("v,svc,vc->sc", w, members, mean) / np.maximum(spread, 1e-300)
        if (ratio <= 0).any():
            raise InvalidMesh("a member is turned over against the mean: its scale along an axis is not positive")
        log_scale = np.log(ratio)
        log_scale -= log_scale.mean(axis=0)
        mean = (members / np.exp(log_scale)[:, None]).mean(axis=0)
    return mean, log_scale
