"""The term of the points: its cost by hand, its gradient and its normal matrix by differences.

The body is a wedge in general position, and the sums over samples are formed anew from positions alone.
"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from toy_wedge import (
    UP,
    derivative,
    face_normals,
    positions,
    toy_evidence,
    wedge_primitive,
    wedge_state,
    with_viewpoint,
)
from wedge_terms import POINTS, PRIORS, ROBUST_M, TOWARD, jacobian, seen_points, state_cost, term_of

from gfp_grasp.register.posterior import StateSurface, evaluate_costs, shape_model
from gfp_grasp.register.refine import evaluate_states
from gfp_grasp.register.state import StateBatch
from gfp_grasp.register.terms import PointTerm


def _points_cost(state, evidence, index, normals, *, gap_m2: float = 0.0) -> float:
    """The robust cost with each point's sample and its normal given, less what the gaps between samples cost."""
    gap = (evidence.points - positions(state, wedge_primitive())[index])[:-1]
    squared = ((gap * normals).sum(axis=1)) ** 2 + 0.2 * (gap**2).sum(axis=1)
    share, beside = 150.0 / 20 / (0.0013**2 + 0.0009**2), 0.2 * gap_m2
    excess = squared - beside / (1 + beside / ROBUST_M**2)
    return float(0.5 * share * ((excess / (1 + squared / ROBUST_M**2)).sum() + ROBUST_M**2))


def test_points_pay_robustly_along_and_across_the_normal_and_one_without_a_partner_in_full():
    state, evidence, index = seen_points()
    cost, _, _ = term_of(state, evidence, POINTS, PRIORS)
    normals = face_normals(state, wedge_primitive())[index[:-1]]
    model = shape_model(wedge_primitive(), POINTS.num_samples, POINTS.num_modes)
    gap_m2 = StateSurface(StateBatch.of([state], model.num_modes), model).sample_gap_m2[0]
    assert gap_m2 > 1e-6
    assert cost == pytest.approx(_points_cost(state, evidence, index, normals, gap_m2=gap_m2), rel=1e-9)


def test_a_surface_that_goes_on_beyond_what_was_seen_pays_no_more_than_one_that_ends_there():
    """Points on two sides of a prism that ends just above them, goes on by half as much, or by as much again."""
    block = trimesh.creation.box(bounds=[[-0.03, -0.025, 0], [0.03, 0.025, 0.1]])
    prism = replace(
        wedge_primitive(), vertices=block.vertices, faces=block.faces, modes=np.zeros((0, 8, 3)), regions=np.zeros(8)
    )
    rng = np.random.default_rng(0)
    points = np.concatenate(
        [
            rng.uniform([-0.03, 0.025, 0.01], [0.03, 0.025, 0.09], (200, 3)),
            rng.uniform([0.03, -0.025, 0.01], [0.03, 0.025, 0.09], (200, 3)),
        ]
    )
    normals = np.repeat([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], 200, axis=0)
    term = PointTerm(toy_evidence(points, normals, viewpoint=np.array([1.0, 1.0, 0.5])), 150.0, 0.0018, 0.05, 0.02)
    model = shape_model(prism, 1500, 0)
    states = [
        wedge_state(R=np.eye(3), t=np.zeros(3), coefficients=np.zeros(0), log_scale=np.log([1.0, 1.0, tall]))
        for tall in (1.0, 1.5, 2.0)
    ]
    costs, _ = evaluate_costs(StateBatch.of(states, 0), model, [term], 0.004)
    assert np.ptp(costs) < 1.3  # more than 6 without regard to how far apart the samples are
    assert np.abs(costs).max() < 1.5


def test_the_residual_is_the_mean_distance_across_the_surface_of_the_nine_tenths_that_fit_best():
    state, evidence, index = seen_points()
    gap = evidence.points - positions(state, wedge_primitive())[index]
    across = np.abs((gap * face_normals(state, wedge_primitive())[index]).sum(axis=1))
    (judged,) = evaluate_states([state], wedge_primitive(), evidence, replace(POINTS, steps=(ROBUST_M,)))
    assert judged.residual_m == pytest.approx(across[:-1].mean(), rel=1e-9)
    # A point whose normal no sample shares is as far off as its sample is, not as the sample's plane.
    turned = replace(evidence, normals=np.tile(evidence.normals[-1], (20, 1)))
    (judged,) = evaluate_states([state], wedge_primitive(), turned, replace(POINTS, steps=(ROBUST_M,)))
    world = positions(state, wedge_primitive())
    assert (
        judged.residual_m >= np.sort(np.linalg.norm(world[:, None] - evidence.points, axis=2).min(axis=0))[:19].mean()
    )


def test_the_step_of_the_points_is_the_slope_of_their_cost():
    state, evidence, index = seen_points()
    _, H, g = term_of(state, evidence, POINTS, PRIORS)
    normals = face_normals(state, wedge_primitive())[index[:-1]]
    slope = derivative(lambda changed: _points_cost(changed, evidence, index, normals), state)
    assert g == pytest.approx(-slope, rel=1e-5, abs=1e-5 * np.abs(slope).max())
    # The normal matrix is that of Gauss and Newton, each point by its robust weight.
    J = jacobian(state)[index[:-1]]
    gap = (evidence.points - positions(state, wedge_primitive())[index])[:-1]
    squared = ((gap * normals).sum(axis=1)) ** 2 + 0.2 * (gap**2).sum(axis=1)
    weight = 150.0 / 20 / (0.0013**2 + 0.0009**2) / (1 + squared / ROBUST_M**2) ** 2
    precision = weight[:, None, None] * (normals[:, :, None] * normals[:, None] + 0.2 * np.eye(3))
    expected = np.einsum("nip,nij,njq->pq", J, precision, J)
    assert pytest.approx(expected, rel=1e-5, abs=1e-5 * np.abs(expected).max()) == H


def test_a_point_belongs_to_the_side_of_a_thin_wall_that_its_normal_tells():
    state, primitive = wedge_state(), wedge_primitive()
    world, normals = positions(state, primitive), face_normals(state, primitive)
    toward = TOWARD
    index = np.flatnonzero(normals @ toward > 0.3)[:20]
    away = world[index] - 0.002 * normals[index]
    # Known normals choose; with unknown signs the point lies on the side that is nearer all the same.
    for oriented in (True, False):
        given = normals[index] if oriented else -normals[index]
        evidence = toy_evidence(away, given, viewpoint=state.t + 3 * toward if oriented else None, oriented=oriented)
        (judged,) = evaluate_states([state], primitive, evidence, replace(POINTS, steps=(ROBUST_M,)))
        assert judged.residual_m == pytest.approx(0.002, rel=1e-6)
    evidence = toy_evidence(away, -normals[index], viewpoint=state.t + 3 * toward)
    (judged,) = evaluate_states([state], primitive, evidence, replace(POINTS, steps=(ROBUST_M,)))
    assert judged.residual_m > 0.005


def test_points_belong_to_the_surface_that_faces_the_viewpoint():
    state, primitive = wedge_state(), wedge_primitive()
    world, normals = positions(state, primitive), face_normals(state, primitive)
    toward = TOWARD
    back = np.flatnonzero(normals @ toward < -0.3)[:20]
    seen_from = [
        evaluate_states(
            [state],
            primitive,
            toy_evidence(world[back], normals[back], viewpoint=state.t + sign * 3 * toward),
            replace(POINTS, steps=(ROBUST_M,)),
        )[0].residual_m
        for sign in (1, -1)
    ]
    assert seen_from[1] < 1e-9
    assert seen_from[0] > 0.01


@pytest.mark.parametrize(("angle_deg", "agrees"), [(55.0, True), (65.0, False)])
@pytest.mark.parametrize("oriented", [True, False])
def test_a_normal_agrees_within_sixty_degrees(angle_deg, agrees, oriented):
    state, primitive = wedge_state(), wedge_primitive()
    world, normals = positions(state, primitive), face_normals(state, primitive)
    # One face alone: no other sample is as near, and all have one normal.
    index = np.flatnonzero(normals @ normals[0] > 0.999)
    turned = (
        normals[index]
        @ Rotation.from_rotvec(
            np.deg2rad(angle_deg) * np.cross(normals[0], UP) / np.linalg.norm(np.cross(normals[0], UP))
        )
        .as_matrix()
        .T
    )
    evidence = toy_evidence(world[index], turned if oriented else -turned, oriented=oriented)
    seen = with_viewpoint(evidence, state.t + 5 * normals[0]) if oriented else evidence
    # The unit is as large as the wedge, so that the next face is farther than a difference of normals.
    config = replace(POINTS, unit_m=0.1, misfit=0.009)
    cost = state_cost(state, seen, config) - state_cost(state, seen, PRIORS)
    full = 0.5 * 150.0 / (0.0013**2 + 0.0009**2) * ROBUST_M**2
    assert cost < 0.7 * full if agrees else cost == pytest.approx(full, rel=1e-9)
