"""What the refinement moves, and how it weighs its evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gfp_grasp.errors import InvalidOption


@dataclass(frozen=True)
class ModesConfig:
    """How the refinement weighs its evidence.

    Attributes:
        steps: Robust scales, m, one for each Gauss-Newton step, from coarse to fine.
        effective_points: Independent points that a view is worth against the prior.
        misfit_m: Standard deviation of what the modes cannot express.
        tangential: Weight of the distance along the surface against the one across it.
        silhouette_m: Standard deviation of a trespass into space seen empty, of a real view and of a guessed one.
        scale_slack: Factor on the class's standard deviation of the logarithm of scale.
        estimate_scale: Fit scale with the pose.
        estimate_modes: Fit the modes of shape with the pose.
        free_space: Use the view's free space.
        support: Have the lowest point touch the support.
        oval_m: Standard deviation of the ovality of the body (see ovality.py); None lets it be as oval as its class.
        num_points: Points of the evidence that are looked at, at most.
        num_samples: Samples of the primitive's surface.
        num_modes: Modes that are fitted, at most; the others stay at the mean.
    """

    steps: tuple[float, ...] = (0.01, 0.007, 0.005, 0.004, 0.004, 0.003, 0.003, 0.003)
    effective_points: float = 150.0
    misfit_m: float = 0.001
    tangential: float = 0.05
    silhouette_m: tuple[float, float] = (0.002, 0.004)
    scale_slack: float = 1.5
    estimate_scale: bool = True
    estimate_modes: bool = True
    free_space: bool = True
    support: bool = True
    oval_m: float | None = None
    num_points: int = 400
    num_samples: int = 1500
    num_modes: int = 24

    def __post_init__(self) -> None:
        if not self.steps or min(self.steps) <= 0:
            raise InvalidOption(f"steps is {self.steps}; one positive robust scale in metres a step is expected")
        if min(self.effective_points, self.misfit_m, *self.silhouette_m, self.scale_slack) <= 0:
            raise InvalidOption("effective_points, misfit_m, silhouette_m and scale_slack must be positive")
        if self.oval_m is not None and self.oval_m <= 0:
            raise InvalidOption(f"oval_m is {self.oval_m}; a positive length or None is expected")
        if min(self.num_points, self.num_samples) < 20:
            raise InvalidOption(f"{self.num_points} points and {self.num_samples} samples: at least 20 are needed")
        if self.num_modes < 1:
            raise InvalidOption(f"num_modes is {self.num_modes}; at least 1 is expected")


@dataclass(frozen=True, eq=False)
class PoseShape:
    """One state of the fit: x_world = R @ (exp(log_scale) * (mean + modes @ coefficients)) + t.

    Attributes:
        R: (3, 3).
        t: (3,) m.
        log_scale: (3,).
        coefficients: (k,).
        axis_world: (3,) where the hypothesis says that the primitive's upright axis points.
        axis_sigma_rad: How far the axis may turn from it.
        hypothesis: Its name.
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
        """World positions (n, 3) m of local points (n, 3) that the modes have moved already."""
        return (np.exp(self.log_scale) * local) @ self.R.T + self.t


@dataclass(frozen=True, eq=False)
class StateBatch:
    """Several states as arrays, s of them: they are refined side by side, for the price of few calls.

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
        """Stack at least one state, with its first modes."""
        names = ("R", "t", "log_scale", "coefficients", "axis_world", "axis_sigma_rad")
        batch = StateBatch(*(np.stack([getattr(state, name) for state in states]) for name in names))
        return replace(batch, coefficients=batch.coefficients[:, :num_modes])

    def split(self, states: Sequence[PoseShape], cost: np.ndarray, residual_m: np.ndarray) -> list[PoseShape]:
        """The states that these were made of, moved to where these are."""
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
