"""The state of a fit, which the refinement moves: pose, scale and modes; alone and in batches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class PoseShape:
    """One state of the fit: x_world = R @ (exp(log_scale) * (mean + modes @ coefficients)) + t.

    Attributes:
        R: (3, 3).
        t: (3,) m.
        log_scale: (3,).
        coefficients: (k,).
        axis_world: (3,) unit, direction in which the hypothesis expects the primitive's upright axis.
        axis_sigma_rad: Standard deviation of the axis about that direction.
        hypothesis: "upright", "upside_down" or "lying".
        rest_cost: Negative log odds of the hypothesis, from the card of the class.
        cost: Negative log posterior, up to a constant.
        residual_m: Trimmed mean distance of the points across the surface.
    """

    R: np.ndarray
    t: np.ndarray
    log_scale: np.ndarray
    coefficients: np.ndarray
    axis_world: np.ndarray
    axis_sigma_rad: float
    hypothesis: str
    rest_cost: float = 0.0
    cost: float = np.inf
    residual_m: float = np.inf

    def world(self, local: np.ndarray) -> np.ndarray:
        """World positions (n, 3) m of points (n, 3) of the primitive that the modes have moved already."""
        return (np.exp(self.log_scale) * local) @ self.R.T + self.t


@dataclass(frozen=True, eq=False)
class StateBatch:
    """Several states as arrays, s of them: they are refined side by side, at the price of few calls.

    Attributes:
        R: (s, 3, 3).
        t: (s, 3) m.
        log_scale: (s, 3).
        coefficients: (s, k).
        axis_world: (s, 3).
        axis_sigma_rad: (s,).
    """

    R: np.ndarray
    t: np.ndarray
    log_scale: np.ndarray
    coefficients: np.ndarray
    axis_world: np.ndarray
    axis_sigma_rad: np.ndarray

    @property
    def linear(self) -> np.ndarray:
        """(s, 3, 3) from local to world."""
        return self.R * np.exp(self.log_scale)[:, None, :]

    @staticmethod
    def of(states: Sequence[PoseShape], num_modes: int) -> StateBatch:
        """Stack one or more states, each with its first modes."""
        names = ("R", "t", "log_scale", "coefficients", "axis_world", "axis_sigma_rad")
        batch = StateBatch(*(np.stack([getattr(state, name) for state in states]) for name in names))
        return replace(batch, coefficients=batch.coefficients[:, :num_modes])

    def split(self, states: Sequence[PoseShape], cost: np.ndarray, residual_m: np.ndarray) -> list[PoseShape]:
        """The states (s,) that the batch was made of, with the batch's pose, scale, modes, cost and residual."""
        return [
            replace(
                state,
                R=self.R[i],
                t=self.t[i],
                log_scale=self.log_scale[i],
                coefficients=np.pad(self.coefficients[i], (0, len(state.coefficients) - self.coefficients.shape[1])),
                cost=float(cost[i]),
                residual_m=float(residual_m[i]),
            )
            for i, state in enumerate(states)
        ]
