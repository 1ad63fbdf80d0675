"""Refinement of pose, scale and shape modes by robust Gauss-Newton steps: an active shape model on one view.

Sources of the pieces: Cootes et al., "Active Shape Models" (CVIU 1995); Amberg et al. (CVPR 2007) for the use with
partial scans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gfp_grasp.register.config import RefineConfig
from gfp_grasp.register.posterior import ResidualTerm, ShapeModel, evaluate_costs, linearise, shape_model
from gfp_grasp.register.state import PoseShape, StateBatch
from gfp_grasp.register.terms import make_free_space_term, make_terms
from gfp_grasp.types import GenericPrimitive, LevelView

_MAX_COEFFICIENT = 3.0
# Longest step in rotation (rad), translation (share of the unit), log scale and coefficients.
_MAX_TURN, _MAX_SHIFT, _MAX_LOG_SCALE, _MAX_MODE = 0.4, 1.04, 0.3, 1.5
_DAMPING = 1e-3  # share by which the diagonal of the normal matrix is raised


def refine(
    states: Sequence[PoseShape],
    primitive: GenericPrimitive,
    evidence: LevelView,
    config: RefineConfig = RefineConfig(),
    *,
    held: Sequence[ResidualTerm] = (),
) -> list[PoseShape]:
    """Improve starts, each by itself; the results carry their cost and residual.

    Args:
        states: Starts, in any number.
        primitive: Template.
        evidence: Points, normals, floor and silhouette of one object.
        config: Weights; len(config.steps) Gauss-Newton steps are made.
        held: More terms of the posterior, for the steps; they cost nothing.

    Returns:
        One state for each start, in the same order.
    """
    if not states:
        return []
    model = shape_model(primitive, config.num_samples, config.num_modes)
    unit_m = config.unit_of(primitive)
    batch, terms = StateBatch.of(states, model.num_modes), make_terms(evidence.few(config.num_points), config, unit_m)
    for robust in config.steps:
        H, g = linearise(batch, model, [*terms, *held], robust * unit_m)
        batch = _stepped(batch, model, H, g, config, longest_m=_MAX_SHIFT * unit_m)
    return batch.split(states, *evaluate_costs(batch, model, terms, config.steps[-1] * unit_m))


def evaluate_states(
    states: Sequence[PoseShape], primitive: GenericPrimitive, evidence: LevelView, config: RefineConfig = RefineConfig()
) -> list[PoseShape]:
    """States as they are, with their cost and residual."""
    model = shape_model(primitive, config.num_samples, config.num_modes)
    unit_m = config.unit_of(primitive)
    batch, terms = StateBatch.of(states, model.num_modes), make_terms(evidence.few(config.num_points), config, unit_m)
    return batch.split(states, *evaluate_costs(batch, model, terms, config.steps[-1] * unit_m))


def evaluate_free_space(
    state: PoseShape, primitive: GenericPrimitive, evidence: LevelView, config: RefineConfig
) -> float:
    """The part of a state's cost that comes from its free-space violation."""
    if evidence.silhouette is None:
        return 0.0
    model = shape_model(primitive, config.num_samples, config.num_modes)
    unit_m = config.unit_of(primitive)
    terms = [make_free_space_term(evidence.silhouette, config, unit_m)]
    batch = StateBatch.of([state], model.num_modes)
    return float(evaluate_costs(batch, model, terms, config.steps[-1] * unit_m)[0][0])


def _stepped(
    batch: StateBatch, model: ShapeModel, H: np.ndarray, g: np.ndarray, config: RefineConfig, *, longest_m: float
) -> StateBatch:
    free = np.ones(g.shape[1], dtype=bool)
    free[6:9] = config.estimate_scale
    free[9:] = config.estimate_modes
    damped = H[:, free][:, :, free]
    diagonal = np.arange(damped.shape[1])
    damped[:, diagonal, diagonal] *= 1.0 + _DAMPING
    damped[:, diagonal, diagonal] += 1e-9
    step = np.zeros_like(g)
    step[:, free] = np.linalg.solve(damped, g[:, free, None])[..., 0]
    turn, shift = _at_most(step[:, :3], _MAX_TURN), _at_most(step[:, 3:6], longest_m)
    bound = 3.0 * config.scale_slack * model.scale_sigma
    log_scale = batch.log_scale + np.clip(step[:, 6:9], -_MAX_LOG_SCALE, _MAX_LOG_SCALE)
    coefficients = batch.coefficients + np.clip(step[:, 9:], -_MAX_MODE, _MAX_MODE)
    return replace(
        batch,
        R=Rotation.from_rotvec(turn).as_matrix() @ batch.R,
        t=batch.t + shift,
        log_scale=np.clip(log_scale, -bound, bound),
        coefficients=np.clip(coefficients, -_MAX_COEFFICIENT, _MAX_COEFFICIENT),
    )


def _at_most(vectors: np.ndarray, longest: float) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors * np.minimum(1.0, longest / (length + 1e-12))
