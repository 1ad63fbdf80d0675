"""A step of the refinement: where it goes, and how far it may."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toy_wedge import NUM_MODES, UP, face_normals, perturbed, positions, toy_evidence, wedge_primitive, wedge_state
from wedge_terms import POINTS, PRIORS, ROBUST_M, lowest, seen_points

from gfp_grasp.register.refine import refine
from gfp_grasp.transforms import rotation_about, rotation_between

STEP = replace(PRIORS, steps=(ROBUST_M,))


def test_a_step_goes_to_the_least_cost_but_no_farther_than_it_may():
    evidence, primitive = toy_evidence(np.zeros((20, 3))), wedge_primitive()
    damping = 1 - 1 / 1.001
    near = wedge_state(log_scale=np.zeros(3), coefficients=np.array([0.8, -1.2, 1.4]))
    near = replace(near, axis_world=Rotation.from_rotvec(0.2 * near.R[:, 1]).as_matrix() @ near.R[:, 2])
    (moved,) = refine([near], primitive, evidence, STEP)
    assert moved.coefficients == pytest.approx(damping * near.coefficients, abs=1e-6)
    # The normal matrix of the axis knows nothing of a turn about it: its diagonal is raised by a thousandth.
    H = (np.eye(3) - np.outer(near.R[:, 2], near.R[:, 2])) / 0.1**2
    wanted = np.linalg.solve(H + 1e-3 * np.diag(np.diag(H)) + 1e-9 * np.eye(3), near.R[:, 1] / 0.1**2)
    turn = Rotation.from_matrix(moved.R @ near.R.T).as_rotvec()
    assert turn == pytest.approx(np.sin(0.2) * wanted, abs=1e-5)
    far = replace(
        near,
        coefficients=np.array([2.9, -2.5, 6.0]),
        log_scale=np.array([0.5, -0.4, 5.0]),
        axis_world=Rotation.from_rotvec(1.2 * near.R[:, 1]).as_matrix() @ near.R[:, 2],
    )
    (moved,) = refine([far], primitive, evidence, STEP)
    assert moved.coefficients == pytest.approx([1.4, -1.0, 3.0])
    bound = 3 * 1.7 * np.sqrt(np.diag(primitive.log_scale_cov + 1e-4 * np.eye(3)))
    assert moved.log_scale == pytest.approx([0.2, -0.1, bound[2]])
    assert Rotation.from_matrix(moved.R @ far.R.T).as_rotvec() == pytest.approx(
        0.4 * wanted / np.linalg.norm(wanted), abs=1e-5
    )


def test_a_step_moves_no_farther_than_the_unit_of_length():
    upright = rotation_between((0, 0, 1), UP) @ rotation_about((0, 0, 1), 0.7)
    state, primitive = wedge_state(R=upright, axis_world=UP, axis_sigma_rad=1e-6), wedge_primitive()
    feet = lowest(state)[1].mean()
    config = replace(STEP, support=True, estimate_scale=False, estimate_modes=False, unit_m=0.05)
    shifts = []
    for far_m in (0.02, 1.0):
        evidence = toy_evidence(np.zeros((20, 3)), floor_m=feet - far_m)
        (moved,) = refine([state], primitive, evidence, config)
        shifts.append(moved.t - state.t)
    assert shifts[0] @ UP == pytest.approx(-0.02, rel=0.01)
    # Nothing holds it sideways here: the damping alone chooses among shifts that go as far down.
    assert shifts[1] @ UP < -0.015
    assert np.linalg.norm(shifts[1]) == pytest.approx(1.04 * 0.05, rel=1e-6)


def test_scale_and_modes_stay_where_they_are_not_estimated():
    state, evidence, _ = seen_points()
    for scale, modes in ((True, False), (False, True)):
        config = replace(POINTS, steps=(0.01, ROBUST_M), estimate_scale=scale, estimate_modes=modes)
        (moved,) = refine([state], wedge_primitive(), evidence, config)
        assert np.array_equal(moved.log_scale, state.log_scale) == (not scale)
        assert np.array_equal(moved.coefficients, state.coefficients) == (not modes)


def test_the_least_cost_of_points_on_a_wedge_is_the_wedge():
    truth, primitive = wedge_state(), wedge_primitive()
    truth = replace(truth, axis_world=truth.R[:, 2])
    points, normals = positions(truth, primitive), face_normals(truth, primitive)
    rng = np.random.default_rng(5)
    start = perturbed(truth, 0.02 * rng.normal(size=9 + NUM_MODES))
    start = replace(start, t=truth.t + 0.004 * rng.normal(size=3))
    config = replace(POINTS, steps=(0.02,) * 12, effective_points=1e6)
    (found,) = refine([start], primitive, toy_evidence(points, normals), config)
    assert np.abs(positions(found, primitive) - points).max() < 1e-4
    assert found.coefficients == pytest.approx(truth.coefficients, abs=0.05)
