"""The terms beside the points: their costs by hand, their gradients and their normal matrices by differences.

The body is a wedge in general position, and the sums over samples are formed anew from positions alone.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from toy_wedge import (
    NUM_MODES,
    NUM_SAMPLES,
    UP,
    camera_at,
    corner_silhouette,
    derivative,
    perturbed,
    positions,
    toy_evidence,
    wedge_primitive,
    wedge_state,
)
from wedge_terms import PRIORS, ROBUST_M, jacobian, lowest, normal_equations, state_cost, term_of

from gfp_grasp.register.posterior import evaluate_costs, linearise, shape_model
from gfp_grasp.register.refine import evaluate_free_space
from gfp_grasp.register.state import StateBatch
from gfp_grasp.register.terms import circular_share, ellipticity_gram, make_terms
from gfp_grasp.types import INSIDE, OUTSIDE

# ---- free space


SEEN_EMPTY = replace(PRIORS, effective_points=90.0, free_space=True, silhouette=(0.003, 0.005))


def _picture(*, certain: bool, free_range_m: float = np.inf):
    state = wedge_state()
    camera = camera_at(state.t + np.array([0.1, -0.5, 0.4]), state.t)
    silhouette = corner_silhouette(camera, corner=(60, 66), free_range_m=free_range_m, certain=certain)
    evidence = toy_evidence(np.tile(state.t + 5.0, (20, 1)), silhouette=silhouette)
    return state, camera, silhouette, evidence


def _ways_back(state, camera, silhouette) -> tuple[np.ndarray, np.ndarray]:
    """Samples that stand in free space, and the way of each to the object's pixels, at its own depth."""
    seen = (positions(state, wedge_primitive()) - camera[:3, 3]) @ camera[:3, :3]
    column = np.rint(silhouette.view.K[0, 0] * seen[:, 0] / seen[:, 2] + silhouette.view.K[0, 2])
    row = np.rint(silhouette.view.K[1, 1] * seen[:, 1] / seen[:, 2] + silhouette.view.K[1, 2])
    shift = np.column_stack(
        [
            np.minimum(66 - column, 0) * seen[:, 2] / silhouette.view.K[0, 0],
            np.minimum(60 - row, 0) * seen[:, 2] / silhouette.view.K[1, 1],
            np.zeros(len(seen)),
        ]
    )
    index = np.flatnonzero(shift.any(axis=1))
    return index, shift[index] @ camera[:3, :3].T


@pytest.mark.parametrize(("certain", "sigma_m", "limit_m"), [(True, 0.003, 4 * ROBUST_M), (False, 0.005, 2 * ROBUST_M)])
def test_free_space_draws_a_surface_back_into_the_outline(certain, sigma_m, limit_m):
    state, camera, silhouette, evidence = _picture(certain=certain)
    index, back = _ways_back(state, camera, silhouette)
    assert 10 < len(index) < NUM_SAMPLES - 10
    length = np.linalg.norm(back, axis=1)
    robust, share = 1 / (1 + (length / limit_m) ** 2), 90.0 / NUM_SAMPLES / sigma_m**2
    expected = 0.5 * share * (robust * length**2).sum()
    cost, H, g = term_of(state, evidence, SEEN_EMPTY, replace(SEEN_EMPTY, free_space=False))
    assert cost == pytest.approx(expected, rel=1e-9)
    config = replace(SEEN_EMPTY, steps=(ROBUST_M,))
    assert evaluate_free_space(state, wedge_primitive(), evidence, config) == pytest.approx(expected, rel=1e-9)
    J, direction, weight = jacobian(state)[index], back / length[:, None], share * robust**2
    along = np.einsum("nip,ni->np", J, direction)
    assert g == pytest.approx(along.T @ (weight * length), rel=1e-5, abs=1e-5 * np.abs(g).max())
    assert pytest.approx((along * weight[:, None]).T @ along, rel=1e-5, abs=1e-5 * np.abs(H).max()) == H


def test_two_states_each_pay_for_their_own_free_space():
    state, _, _, evidence = _picture(certain=True)
    moved = perturbed(state, np.concatenate([np.zeros(3), [0.02, 0.01, -0.01], np.zeros(3 + NUM_MODES)]))
    model = shape_model(wedge_primitive(), NUM_SAMPLES, NUM_MODES)
    H, g = linearise(StateBatch.of([state, moved], NUM_MODES), model, make_terms(evidence, SEEN_EMPTY, 1.0), ROBUST_M)
    for i, alone in enumerate((state, moved)):
        H_alone, g_alone = normal_equations(alone, evidence, SEEN_EMPTY)
        assert np.allclose(H[i], H_alone, rtol=1e-9)
        assert np.allclose(g[i], g_alone, rtol=1e-9)


def test_an_occluder_before_the_surface_leaves_no_free_space():
    state, camera, silhouette, evidence = _picture(certain=True, free_range_m=0.2)
    assert len(_ways_back(state, camera, silhouette)[0]) > 0
    assert term_of(state, evidence, SEEN_EMPTY, replace(SEEN_EMPTY, free_space=False))[0] == 0.0


@pytest.mark.parametrize(("in_front_m", "out"), [(0.003, False), (0.010, True)])
def test_a_point_just_before_a_return_may_be_noise(in_front_m, out):
    silhouette = corner_silhouette(np.eye(4), corner=(60, 66), free_range_m=0.8)
    z = 0.8 - in_front_m
    point = np.array([[(100 - 70.3) * z / 150.0, 0.0, z]])
    index, back = silhouette.free_space_violation(point)
    assert (len(index) == 1) == out
    if out:
        assert back[0] == pytest.approx([(66 - 100) * z / 150.0, 0.0, 0.0])


def test_what_is_beside_the_picture_or_in_the_outline_is_free_of_blame():
    silhouette = corner_silhouette(np.eye(4), corner=(60, 66))
    pixels = np.array([[-1, 3], [160, 90], [3, -1], [3, 120], [66, 60], [159, 119], [67, 60], [66, 61], [0, 0]])
    points = np.column_stack([(pixels[:, 0] - 70.3) / 150.0, (pixels[:, 1] - 55.6) / 190.0, np.ones(len(pixels))])
    assert silhouette.free_space_violation(points)[0].tolist() == [5, 6, 7]


# ---- the floor


ON_FLOOR = replace(PRIORS, support=True)


@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize("floor_above_m", [-0.004, 0.009])
def test_the_lowest_samples_are_drawn_to_the_floor(seen, floor_above_m):
    state = wedge_state()
    feet, heights = lowest(state)
    floor = heights.mean() + floor_above_m
    evidence = toy_evidence(np.zeros((20, 3)), floor_m=floor, floor_sigma_m=(0.0015, 0.004), floor_seen=seen)

    def cost_of(heights):
        sigma = np.where(heights > floor, 0.0015, 0.004)
        squared = ((heights - floor) / sigma) ** 2
        capped = squared if seen else np.where(heights < floor, squared / (1 + squared / 9), squared)
        return 0.5 * capped.sum() / 6

    cost, H, g = term_of(state, evidence, ON_FLOOR, PRIORS)
    assert cost == pytest.approx(cost_of(heights), rel=1e-9)
    slope = derivative(lambda changed: cost_of(positions(changed, wedge_primitive())[feet] @ UP), state, size=1e-7)
    assert g == pytest.approx(-slope, rel=1e-4, abs=1e-5 * np.abs(slope).max())
    sigma = np.where(heights > floor, 0.0015, 0.004)
    robust = 1 / (1 + ((heights - floor) / (3 * sigma)) ** 2) if not seen else np.ones(6)
    weight = np.where(heights < floor, robust**2, 1.0) / 6 / sigma**2
    along = np.einsum("nip,i->np", jacobian(state)[feet], UP)
    assert pytest.approx((along * weight[:, None]).T @ along, rel=1e-5, abs=1e-5 * np.abs(H).max()) == H


# ---- the priors


def test_the_axis_pays_for_its_angle_with_that_of_the_hypothesis():
    state = wedge_state(log_scale=np.zeros(3), coefficients=np.zeros(NUM_MODES))
    evidence = toy_evidence(np.zeros((20, 3)))
    tilt = Rotation.from_rotvec(0.25 * state.R[:, 0]).as_matrix()
    state = replace(state, axis_world=tilt @ state.R[:, 2], axis_sigma_rad=0.2)
    assert state_cost(state, evidence, PRIORS) == pytest.approx(0.5 * (np.sin(0.25) / 0.2) ** 2, rel=1e-6)
    H, g = normal_equations(state, evidence, PRIORS)
    slope = derivative(lambda changed: state_cost(changed, evidence, PRIORS), state)
    # The step turns towards the axis by the sine of the angle; the cost's slope has the cosine besides.
    assert g[:3] == pytest.approx(np.sin(0.25) / 0.04 * state.R[:, 0], rel=1e-6)
    assert -slope[:3] == pytest.approx(np.cos(0.25) * g[:3], abs=1e-5)
    assert H[:3, :3] == pytest.approx((np.eye(3) - np.outer(state.R[:, 2], state.R[:, 2])) / 0.04, abs=1e-6)


def test_scale_and_modes_pay_by_the_class():
    primitive = wedge_primitive()
    state = wedge_state(axis_sigma_rad=1e9)
    evidence = toy_evidence(np.zeros((20, 3)))
    precision = np.linalg.inv(primitive.log_scale_cov + 1e-4 * np.eye(3)) / 1.7**2
    expected = 0.5 * (state.log_scale @ precision @ state.log_scale + (state.coefficients**2).sum())
    assert state_cost(state, evidence, PRIORS) == pytest.approx(expected, rel=1e-9)
    H, g = normal_equations(state, evidence, PRIORS)
    assert g == pytest.approx(
        np.concatenate([np.zeros(6), -precision @ state.log_scale, -state.coefficients]), abs=1e-6
    )
    expected_H = np.zeros((12, 12))
    expected_H[6:9, 6:9], expected_H[9:, 9:] = precision, np.eye(NUM_MODES)
    assert pytest.approx(expected_H, abs=1e-6) == H


def test_ellipticity_is_the_mean_square_of_the_second_harmonic_over_the_height():
    primitive, radius = _tube(), 0.04
    gram = ellipticity_gram(primitive)

    def square_m(scale, coefficients) -> float:
        u = (np.asarray(scale)[:, None] * np.insert(coefficients, 0, 1.0)[None]).ravel()
        return float(u @ gram @ u)

    assert square_m((1, 1, 1), np.zeros(3)) < 1e-14
    assert square_m((1.3, 0.9, 2), np.zeros(3)) == pytest.approx((0.2 * radius) ** 2, rel=1e-6)
    assert square_m((1, 1, 1), np.array([2.0, 0, 0])) == pytest.approx((2 * 0.001) ** 2, rel=1e-6)
    assert square_m((1, 1, 1), np.array([2.0, 1.0, 0])) == pytest.approx((2 * 0.001) ** 2 + 0.002**2, rel=1e-6)
    # The third mode is elliptic in the topmost of eight bands alone, and inside the tube, which does not count.
    assert square_m((1, 1, 1), np.array([0, 0, 1.0])) == pytest.approx(0.003**2 / 8, rel=1e-6)


def test_the_share_of_circular_members_is_counted_and_never_certain():
    primitive, radius = _tube(), 0.04
    samples = np.zeros((20, 6))
    samples[:, 0] = np.arange(20)  # millimetres, in the first mode
    samples[10:, 5] = 0.3  # higher, which does not count
    primitive = replace(primitive, coefficient_samples=samples)
    assert circular_share(primitive, 0.0065) == pytest.approx(7 / 20)
    assert circular_share(primitive, 1e-9) == 0.05
    assert circular_share(primitive, 1.0) == 0.95
    stretched = replace(primitive, coefficient_samples=samples * 0 + np.array([0, 0, 0, 0.1, -0.1, 0]))
    amplitude = radius * np.sinh(0.1)
    assert circular_share(stretched, 0.99 * amplitude) == 0.05
    assert circular_share(stretched, 1.01 * amplitude) == 0.95


def test_a_body_that_should_be_round_pays_for_its_ellipticity():
    primitive = _tube()
    model = shape_model(primitive, NUM_SAMPLES, 3)
    evidence = toy_evidence(np.zeros((20, 3)))
    state = wedge_state(log_scale=np.array([0.1, -0.05, 0.2]), coefficients=np.array([0.4, 1.2, -0.6]))
    batch, on = StateBatch.of([state], 3), replace(PRIORS, ellipticity=0.002)

    def cost(changed, config):
        terms = make_terms(evidence, config, 1.0)
        return float(evaluate_costs(StateBatch.of([changed], 3), model, terms, ROBUST_M)[0][0])

    u = (np.exp(state.log_scale)[:, None] * np.insert(state.coefficients, 0, 1.0)[None]).ravel()
    expected = 0.5 * u @ ellipticity_gram(primitive) @ u / 0.002**2
    assert cost(state, on) - cost(state, PRIORS) == pytest.approx(expected, rel=1e-9)
    H, g = (
        a[0] - b[0]
        for a, b in zip(
            *(linearise(batch, model, make_terms(evidence, c, 1.0), ROBUST_M) for c in (on, PRIORS)), strict=True
        )
    )
    slope = derivative(lambda changed: cost(changed, on) - cost(changed, PRIORS), state, size=1e-5)
    assert g == pytest.approx(-slope, rel=1e-5, abs=1e-5 * np.abs(slope).max())

    def u_of(changed):
        return (np.exp(changed.log_scale)[:, None] * np.insert(changed.coefficients, 0, 1.0)[None]).ravel()

    U = derivative(u_of, state)
    assert pytest.approx(U.T @ ellipticity_gram(primitive) @ U / 0.002**2, rel=1e-5, abs=1e-4) == H


def _tube():
    """A round tube of 4 cm radius: modes that are elliptic along x, along the diagonal, and along x at its top alone.

    Its lowest 8 of 40 rings count as inside.
    """
    angle, height = (a.ravel() for a in np.meshgrid(np.arange(48) / 48 * 2 * np.pi, np.linspace(0, 0.1, 40)))
    ring = np.arange(40 * 48) // 48
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))])
    lower, side = np.arange(39 * 48), np.arange(39 * 48) // 48 * 48 + (np.arange(39 * 48) + 1) % 48
    faces = np.concatenate([np.column_stack([lower, side, lower + 48]), np.column_stack([side, side + 48, lower + 48])])
    modes = np.stack(
        [
            0.001 * np.cos(2 * angle)[:, None] * out,
            0.002 * np.sin(2 * angle)[:, None] * out,
            0.003 * (np.cos(2 * angle) * ((ring >= 36) | (ring < 8)))[:, None] * out,
        ]
    )
    return replace(
        wedge_primitive(),
        vertices=0.04 * out + height[:, None] * (0, 0, 1),
        faces=faces,
        modes=modes,
        regions=np.where(ring < 8, INSIDE, OUTSIDE).astype(np.uint8),
    )
