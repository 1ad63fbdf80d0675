"""Pose, scale and shape modes of a primitive by robust Gauss-Newton: an active shape model on one view.

Sources of the pieces: Cootes et al., "Active Shape Models" (CVIU 1995); Amberg et al. (CVPR 2007) for the use with
partial scans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gfp_grasp.register.evidence import Evidence
from gfp_grasp.register.posterior import ShapeModel, costs, linearise, seen_empty, shape_model
from gfp_grasp.register.state import ModesConfig, PoseShape, StateBatch
from gfp_grasp.types import GenericPrimitive

_MAX_COEFFICIENT = 3.0


def refine(
    states: Sequence[PoseShape], primitive: GenericPrimitive, evidence: Evidence, config: ModesConfig = ModesConfig()
) -> list[PoseShape]:
    """Improve starts, each by itself; the results carry their cost and residual.

    Args:
        states: Starts, in any number.
        primitive: Template.
        evidence: Of one view.
        config: Weights; len(config.steps) Gauss-Newton steps are made.

    Returns:
        One state a start, in the same order.
    """
    if not states:
        return []
    model = shape_model(primitive, config.num_samples, config.num_modes)
    batch, evidence = StateBatch.of(states, model.num_modes), evidence.few(config.num_points)
    for robust_m in config.steps:
        batch = _stepped(batch, model, *linearise(batch, model, evidence, config, robust_m), config)
    return batch.split(states, *costs(batch, model, evidence, config, config.steps[-1]))


def judge(
    states: Sequence[PoseShape], primitive: GenericPrimitive, evidence: Evidence, config: ModesConfig = ModesConfig()
) -> list[PoseShape]:
    """States as they are, with their cost and residual."""
    model = shape_model(primitive, config.num_samples, config.num_modes)
    batch = StateBatch.of(states, model.num_modes)
    evidence = evidence.few(config.num_points)
    return batch.split(states, *costs(batch, model, evidence, config, config.steps[-1]))


def free_space_cost(state: PoseShape, primitive: GenericPrimitive, evidence: Evidence, config: ModesConfig) -> float:
    """What of the cost of a state is that it stands in space seen empty."""
    model = shape_model(primitive, config.num_samples, config.num_modes)
    return float(seen_empty(StateBatch.of([state], model.num_modes), model, evidence, config, config.steps[-1])[0])


def _stepped(batch: StateBatch, model: ShapeModel, H: np.ndarray, g: np.ndarray, config: ModesConfig) -> StateBatch:
    free = np.ones(g.shape[1], dtype=bool)
    free[6:9] = config.estimate_scale
    free[9:] = config.estimate_modes
    damped = H[:, free][:, :, free]
    diagonal = np.arange(damped.shape[1])
    damped[:, diagonal, diagonal] *= 1.0 + 1e-3
    damped[:, diagonal, diagonal] += 1e-9
    step = np.zeros_like(g)
    step[:, free] = np.linalg.solve(damped, g[:, free, None])[..., 0]
    turn, shift = _at_most(step[:, :3], 0.4), _at_most(step[:, 3:6], 0.1)
    bound = 3.0 * config.scale_slack * model.scale_sigma
    coefficients = batch.coefficients + np.clip(step[:, 9:], -1.5, 1.5)
    return replace(
        batch,
        R=Rotation.from_rotvec(turn).as_matrix() @ batch.R,
        t=batch.t + shift,
        log_scale=np.clip(batch.log_scale + np.clip(step[:, 6:9], -0.3, 0.3), -bound, bound),
        coefficients=np.clip(coefficients, -_MAX_COEFFICIENT, _MAX_COEFFICIENT),
    )


def _at_most(vectors: np.ndarray, longest: float) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors * np.minimum(1.0, longest / (length + 1e-12))
