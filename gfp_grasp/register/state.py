"""The state of a fit, which the refinement moves: pose, scale and modes; and samples of the surface in that state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from gfp_grasp.meshes import triangle_normals
from gfp_grasp.types import GenericPrimitive

STANDING_SIGMA_RAD = np.deg2rad(1.0)  # how far the axis of what stands is off the support's normal


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Samples of the surface of one primitive, m of them.

    Attributes:
        mean: (m, 3) m, on the mean mesh.
        modes: (k, m, 3) m per unit coefficient.
        face: (m,) index of the face that each lies on.
        weights: (m, 3) barycentric.
    """

    mean: np.ndarray
    modes: np.ndarray
    face: np.ndarray
    weights: np.ndarray

    def local(self, coefficients: np.ndarray) -> np.ndarray:
        """(m, 3) m, in the primitive's frame before scale."""
        return self.mean + np.tensordot(coefficients, self.modes, axes=1)


@lru_cache(maxsize=32)
def surface_samples(primitive: GenericPrimitive, count: int = 1500) -> SurfaceSamples:
    """Samples spread evenly over the area of the mean mesh; the same for the same primitive.

    Faces are walked in order with a fixed stride in cumulative area, so every face larger than the stride gets its
    share and the samples follow the mesh, not a random stream.
    """
    triangles = primitive.vertices[primitive.faces]
    area = 0.5 * np.linalg.norm(triangle_normals(triangles), axis=1)
    cumulative = np.cumsum(area)
    face = np.searchsorted(cumulative, (np.arange(count) + 0.5) / count * cumulative[-1])
    face = np.minimum(face, len(area) - 1)
    # R2 low-discrepancy sequence, https://extremelearning.com.au/unreasonable-effectiveness-of-quasirandom-sequences/
    u, v = np.modf(np.arange(1, count + 1)[:, None] * np.array([0.7548776662466927, 0.5698402909980532]))[0].T
    fold = u + v > 1
    u, v = np.where(fold, 1 - u, u), np.where(fold, 1 - v, v)
    weights = np.column_stack([1 - u - v, u, v])
    corners = primitive.faces[face]
    mean = np.einsum("mc,mcd->md", weights, primitive.vertices[corners])
    modes = np.einsum("mc,kmcd->kmd", weights, primitive.modes[:, corners])
    return SurfaceSamples(mean, modes, face, weights)


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


def start_of(
    primitive: GenericPrimitive,
    R: np.ndarray,
    centre: np.ndarray,
    scale: ArrayLike,
    axis_sigma_rad: float,
    hypothesis: str,
) -> PoseShape:
    """The mean shape of a primitive at a pose and scale (3,), no farther from its own size than two sigma."""
    sigma = 2.0 * np.sqrt(np.diag(primitive.log_scale_cov) + 1e-4)
    return PoseShape(
        R=R,
        t=centre,
        log_scale=np.clip(np.log(scale), -sigma, sigma),
        coefficients=np.zeros(len(primitive.modes)),
        axis_world=R[:, 2],
        axis_sigma_rad=float(axis_sigma_rad),
        hypothesis=hypothesis,
        rest_cost=primitive.spec.rest_costs().get(hypothesis, 0.0),
    )


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
