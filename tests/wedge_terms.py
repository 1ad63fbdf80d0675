"""What a term of the posterior costs a wedge in general position, its normal equations, and points a little off it."""

from dataclasses import replace

import numpy as np
from toy_wedge import (
    NUM_MODES,
    NUM_SAMPLES,
    UP,
    derivative,
    face_normals,
    positions,
    toy_evidence,
    wedge_primitive,
    wedge_state,
)

from gfp_grasp.register import RefineConfig
from gfp_grasp.register.posterior import evaluate_costs, linearise, shape_model
from gfp_grasp.register.state import StateBatch
from gfp_grasp.register.terms import make_terms

ROBUST_M = 0.004
# The points weigh nothing, and neither do free space and floor: what remains are the priors. Lengths are in metres.
PRIORS = RefineConfig(
    unit_m=1.0, effective_points=1e-15, free_space=False, support=False, num_samples=NUM_SAMPLES, scale_slack=1.7
)
TOWARD = wedge_state().R @ np.array([0.5, 0.4, 0.768])  # three faces are seen from there
POINTS = replace(PRIORS, effective_points=150.0, misfit=0.0009, tangential=0.2)


def state_cost(state, evidence, config) -> float:
    """Half the sum of squares of all terms."""
    primitive = wedge_primitive()
    model = shape_model(primitive, NUM_SAMPLES, NUM_MODES)
    return float(
        evaluate_costs(StateBatch.of([state], NUM_MODES), model, make_terms(evidence, config, config.unit_m), ROBUST_M)[
            0
        ][0]
    )


def normal_equations(state, evidence, config) -> tuple[np.ndarray, np.ndarray]:
    """Normal matrix (9 + k, 9 + k) and downhill gradient (9 + k,) of all terms."""
    model = shape_model(wedge_primitive(), NUM_SAMPLES, NUM_MODES)
    H, g = linearise(StateBatch.of([state], NUM_MODES), model, make_terms(evidence, config, config.unit_m), ROBUST_M)
    return H[0], g[0]


def term_of(state, evidence, on, off) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost, normal matrix and gradient of what one config has and the other has not."""
    (H_on, g_on), (H_off, g_off) = (normal_equations(state, evidence, config) for config in (on, off))
    return state_cost(state, evidence, on) - state_cost(state, evidence, off), H_on - H_off, g_on - g_off


def jacobian(state) -> np.ndarray:
    """(NUM_SAMPLES, 3, 9 + k) of the samples in the world, by differences."""
    return derivative(lambda changed: positions(changed, wedge_primitive()), state)


def seen_points():
    """Twenty samples that face a viewpoint, each with a point a little off it; the last one is 5 cm away."""
    state, primitive = wedge_state(), wedge_primitive()
    world, normals = positions(state, primitive), face_normals(state, primitive)
    toward = TOWARD
    index = np.flatnonzero(normals @ toward > 0.3)[:20]
    assert len(index) == 20
    rng = np.random.default_rng(3)
    along = rng.uniform(-0.003, 0.003, 20)
    across = np.cross(normals[index], rng.normal(size=(20, 3)))
    across *= rng.uniform(0.001, 0.003, (20, 1)) / np.linalg.norm(across, axis=1, keepdims=True)
    points = world[index] + along[:, None] * normals[index] + across
    points[-1] = world[index[-1]] + 0.05 * toward
    given = normals[index].copy()
    given[-1] = -toward  # no sample that faces the viewpoint has this normal
    evidence = toy_evidence(points, given, viewpoint=state.t + 3.0 * toward)
    return state, evidence, index


def lowest(state) -> tuple[np.ndarray, np.ndarray]:
    """The six lowest samples, and their heights (6,) m."""
    heights = positions(state, wedge_primitive()) @ UP
    return np.argsort(heights)[:6], np.sort(heights)[:6]
