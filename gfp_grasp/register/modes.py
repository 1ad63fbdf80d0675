"""Pose, scale and shape modes of a primitive by robust Gauss-Newton: an active shape model on one view.

The posterior that is maximised: observed points lie on the surface (point to plane, robust), the surface does not
stand where the view saw past it, its lowest point touches the support, and modes and scale are as likely as in the
class. Sources of the pieces: Cootes et al., "Active Shape Models" (CVIU 1995); Amberg et al. (CVPR 2007) for the use
with partial scans; the robust weight is Geman and McClure's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from gfp_grasp.errors import InvalidOption
from gfp_grasp.register.evidence import Evidence
from gfp_grasp.register.surface import SurfaceSamples, surface_samples
from gfp_grasp.types import GenericPrimitive

# A difference of normals of one unit (60 degrees) counts like this distance when neighbours are sought (thin walls).
_NORMAL_LENGTH_M = 0.02
_MIN_NORMAL_COSINE = 0.5
_MAX_COEFFICIENT = 3.0


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
    """

    steps: tuple[float, ...] = (0.02, 0.012, 0.008, 0.006, 0.005, 0.004, 0.004, 0.003, 0.003, 0.003)
    effective_points: float = 150.0
    misfit_m: float = 0.001
    tangential: float = 0.05
    silhouette_m: tuple[float, float] = (0.002, 0.004)
    scale_slack: float = 1.5
    estimate_scale: bool = True
    estimate_modes: bool = True
    free_space: bool = True

    def __post_init__(self) -> None:
        if not self.steps or min(self.steps) <= 0:
            raise InvalidOption(f"steps is {self.steps}; one positive robust scale in metres a step is expected")
        if min(self.effective_points, self.misfit_m, *self.silhouette_m, self.scale_slack) <= 0:
            raise InvalidOption("effective_points, misfit_m, silhouette_m and scale_slack must be positive")


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
    cost: float = np.inf
    residual_m: float = np.inf

    def world(self, local: np.ndarray) -> np.ndarray:
        """World positions (n, 3) m of local points (n, 3) that the modes have moved already."""
        return (np.exp(self.log_scale) * local) @ self.R.T + self.t


def refine(
    state: PoseShape, primitive: GenericPrimitive, evidence: Evidence, config: ModesConfig = ModesConfig()
) -> PoseShape:
    """Improve one start; the result carries its cost and residual.

    Args:
        state: Start.
        primitive: Template.
        evidence: Of one view.
        config: Weights; len(config.steps) Gauss-Newton steps are made.
    """
    model = _model(primitive)
    for robust_m in config.steps:
        normal, gradient, _ = _linearise(state, model, evidence, config, robust_m)
        state = _stepped(state, model, normal, gradient, config)
    _, _, (cost, residual) = _linearise(state, model, evidence, config, config.steps[-1])
    return replace(state, cost=cost, residual_m=residual)


@dataclass(frozen=True, eq=False)
class _Model:
    primitive: GenericPrimitive
    samples: SurfaceSamples
    flat_modes: np.ndarray  # (k, m * 3)
    point_modes: np.ndarray  # (m, k, 3)
    corner_vertices: np.ndarray  # (m, 3, 3) of the mean mesh
    corner_modes: np.ndarray  # (k, m * 9)
    scale_precision: np.ndarray  # (3, 3)
    scale_sigma: np.ndarray  # (3,)


@lru_cache(maxsize=32)
def _model(primitive: GenericPrimitive) -> _Model:
    samples = surface_samples(primitive)
    corners = primitive.faces[samples.face]
    covariance = primitive.log_scale_cov + 1e-4 * np.eye(3)
    return _Model(
        primitive,
        samples,
        samples.modes.reshape(len(samples.modes), -1),
        np.ascontiguousarray(samples.modes.transpose(1, 0, 2)),
        primitive.vertices[corners],
        primitive.modes[:, corners].reshape(len(primitive.modes), -1),
        np.linalg.inv(covariance),
        np.sqrt(np.diag(covariance)),
    )


def _linearise(
    state: PoseShape, model: _Model, evidence: Evidence, config: ModesConfig, robust_m: float
) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Normal matrix, gradient of the step (rotation 3, translation 3, log scale 3, modes k), cost and residual."""
    k = len(state.coefficients)
    samples = model.samples
    local = samples.mean + (state.coefficients @ model.flat_modes).reshape(-1, 3)
    world = state.world(local)
    normals = _sample_normals(state, model)
    H, g, cost = np.zeros((9 + k, 9 + k)), np.zeros(9 + k), 0.0

    def add(index: np.ndarray, direction: np.ndarray, residual: np.ndarray, weight: np.ndarray) -> None:
        J = np.einsum("ni,nip->np", direction, _derivative(state, model, local[index], world[index], index))
        H.__iadd__(J.T @ (weight[:, None] * J))
        g.__iadd__(J.T @ (weight * residual))

    # Observed points on the surface.
    visible = np.arange(len(world))
    if evidence.viewpoint is not None:
        visible = np.flatnonzero(np.einsum("ni,ni->n", normals, evidence.viewpoint - world) > 0)
    nearest, agrees = _correspond(evidence, world[visible], normals[visible])
    index = visible[nearest]
    gap = evidence.points - world[index]
    across = np.einsum("ni,ni->n", normals[index], gap)
    sigma = np.hypot(evidence.sigma_m, config.misfit_m)
    share = config.effective_points / len(gap) / sigma**2
    # Geman-McClure on the whole gap: a point far from its sample says little, wherever it lies.
    squared = across**2 + config.tangential * np.einsum("ni,ni->n", gap, gap)
    robust = 1.0 / (1.0 + squared / robust_m**2)
    weight = share * robust**2 * agrees
    D = _derivative(state, model, local[index], world[index], index)
    J = np.einsum("ni,nip->np", normals[index], D)
    H += J.T @ (weight[:, None] * J)
    g += J.T @ (weight * across)
    D = D.reshape(-1, 9 + k)
    along = np.repeat(config.tangential * weight, 3)
    H += D.T @ (along[:, None] * D)
    g += D.T @ (along * gap.ravel())
    # The cost is in the same robust measure for every start; a point without a partner pays in full.
    cost += 0.5 * share * float(np.where(agrees, robust * squared, robust_m**2).sum())
    residual = float(
        np.sort(np.where(agrees, np.abs(across), np.linalg.norm(gap, axis=1)))[: int(0.9 * len(gap)) + 1].mean()
    )

    # Space seen empty stays empty.
    if config.free_space and evidence.silhouette is not None:
        certain = evidence.silhouette.certain
        sigma = config.silhouette_m[0 if certain else 1]
        index, back = evidence.silhouette.trespass(world)
        if len(index):
            distance = np.linalg.norm(back, axis=1)
            # Where the picture is guessed from the points, what lacks may be hidden by something: a capped force.
            limit = 4 * robust_m if certain else 2 * robust_m
            robust = 1.0 / (1.0 + (distance / limit) ** 2)
            share = config.effective_points / len(world) / sigma**2
            add(index, back / distance[:, None], distance, share * robust**2)
            cost += 0.5 * share * float((robust * distance**2).sum())

    # The lowest point touches the support.
    heights = world @ evidence.up - evidence.floor_m
    lowest = np.argsort(heights, kind="stable")[:6]
    height = heights[lowest]
    sigma = np.where(height > 0, evidence.floor_sigma_m[0], evidence.floor_sigma_m[1])
    weight = 1.0 / len(lowest) / sigma**2
    add(lowest, np.broadcast_to(evidence.up, (len(lowest), 3)), -height, weight)
    cost += 0.5 * float((weight * height**2).sum())

    # The axis stays near its hypothesis; shape and scale stay near the class.
    axis = state.R @ model.primitive.up
    tilt = np.cross(axis, state.axis_world)
    H[:3, :3] += np.eye(3) / state.axis_sigma_rad**2 - np.outer(axis, axis) / state.axis_sigma_rad**2
    g[:3] += tilt / state.axis_sigma_rad**2
    cost += 0.5 * float(tilt @ tilt) / state.axis_sigma_rad**2
    precision = model.scale_precision / config.scale_slack**2
    H[6:9, 6:9] += precision
    g[6:9] -= precision @ state.log_scale
    cost += 0.5 * float(state.log_scale @ precision @ state.log_scale)
    H[9:, 9:] += np.eye(k)
    g[9:] -= state.coefficients
    cost += 0.5 * float(state.coefficients @ state.coefficients)
    return H, g, (cost, residual)


def _stepped(state: PoseShape, model: _Model, H: np.ndarray, g: np.ndarray, config: ModesConfig) -> PoseShape:
    free = np.ones(len(g), dtype=bool)
    free[6:9] = config.estimate_scale
    free[9:] = config.estimate_modes
    step = np.zeros(len(g))
    damped = H[np.ix_(free, free)]
    damped = damped + 1e-3 * np.diag(np.diag(damped)) + 1e-9 * np.eye(len(damped))
    step[free] = np.linalg.solve(damped, g[free])
    turn = step[:3] * min(1.0, 0.4 / (np.linalg.norm(step[:3]) + 1e-12))
    bound = 3.0 * config.scale_slack * model.scale_sigma
    return replace(
        state,
        R=Rotation.from_rotvec(turn).as_matrix() @ state.R,
        t=state.t + step[3:6] * min(1.0, 0.1 / (np.linalg.norm(step[3:6]) + 1e-12)),
        log_scale=np.clip(state.log_scale + np.clip(step[6:9], -0.3, 0.3), -bound, bound),
        coefficients=np.clip(state.coefficients + np.clip(step[9:], -1.5, 1.5), -_MAX_COEFFICIENT, _MAX_COEFFICIENT),
    )


def _derivative(state: PoseShape, model: _Model, local: np.ndarray, world: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Derivative (n, 3, 9 + k) of the world position of samples that move with the state."""
    linear = state.R * np.exp(state.log_scale)
    arm = world - state.t
    D = np.zeros((len(index), 3, 9 + len(state.coefficients)))
    for i, j, sign in ((0, 1, 1), (1, 2, 1), (2, 0, 1), (1, 0, -1), (2, 1, -1), (0, 2, -1)):
        D[:, i, j] = sign * arm[:, 3 - i - j]  # turn x arm
    D[:, [0, 1, 2], [3, 4, 5]] = 1.0
    D[:, :, 6:9] = linear * local[:, None]
    D[:, :, 9:] = (model.point_modes[index] @ linear.T).transpose(0, 2, 1)
    return D


def _sample_normals(state: PoseShape, model: _Model) -> np.ndarray:
    corners = model.corner_vertices + (state.coefficients @ model.corner_modes).reshape(-1, 3, 3)
    linear = (state.R * np.exp(state.log_scale)).T
    a, b = ((corners[:, i] - corners[:, 0]) @ linear for i in (1, 2))
    # Written out: numpy's cross takes longer than all the rest of this function.
    normals = np.column_stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ]
    )
    return normals / (np.linalg.norm(normals, axis=1, keepdims=True) + 1e-18)


def _correspond(evidence: Evidence, world: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest sample (n,) of each point in position and normal, and whether the normals agree."""
    if len(world) == 0:
        return np.zeros(len(evidence.points), dtype=np.int64), np.zeros(len(evidence.points), dtype=bool)
    tree = KDTree(np.hstack([world, _NORMAL_LENGTH_M * normals]))
    distance, index = tree.query(np.hstack([evidence.points, _NORMAL_LENGTH_M * evidence.normals]))
    index = np.asarray(index)
    if not evidence.oriented:
        other, flipped = tree.query(np.hstack([evidence.points, -_NORMAL_LENGTH_M * evidence.normals]))
        index = np.where(other < distance, flipped, index)
    cosine = np.einsum("ni,ni->n", evidence.normals, normals[index])
    return index, (cosine if evidence.oriented else np.abs(cosine)) > _MIN_NORMAL_COSINE
