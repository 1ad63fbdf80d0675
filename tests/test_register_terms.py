"""Each term of the posterior: its cost by hand, its gradient and its normal matrix by differences.

The body is a wedge in general position, up is tilted, and the sums over samples are formed anew from positions alone.
"""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from toy_wedge import (
    NUM_MODES,
    NUM_SAMPLES,
    UP,
    camera_at,
    corner_silhouette,
    derivative,
    face_normals,
    perturbed,
    positions,
    toy_evidence,
    wedge_primitive,
    wedge_state,
    with_viewpoint,
)

from gfp_grasp.register import RefineConfig
from gfp_grasp.register.posterior import StateSurface, evaluate_costs, linearise, shape_model
from gfp_grasp.register.refine import evaluate_free_space, evaluate_states, refine
from gfp_grasp.register.state import StateBatch
from gfp_grasp.register.terms import PointTerm, circular_share, ellipticity_gram, make_terms
from gfp_grasp.transforms import rotation_about, rotation_between
from gfp_grasp.types import INSIDE, OUTSIDE

ROBUST_M = 0.004
# The points weigh nothing, and neither do free space and floor: what remains are the priors. Lengths are in metres.
PRIORS = RefineConfig(
    unit_m=1.0, effective_points=1e-15, free_space=False, support=False, num_samples=NUM_SAMPLES, scale_slack=1.7
)


def _cost(state, evidence, config) -> float:
    primitive = wedge_primitive()
    model = shape_model(primitive, NUM_SAMPLES, NUM_MODES)
    return float(
        evaluate_costs(StateBatch.of([state], NUM_MODES), model, make_terms(evidence, config, config.unit_m), ROBUST_M)[
            0
        ][0]
    )


def _normal_equations(state, evidence, config) -> tuple[np.ndarray, np.ndarray]:
    model = shape_model(wedge_primitive(), NUM_SAMPLES, NUM_MODES)
    H, g = linearise(StateBatch.of([state], NUM_MODES), model, make_terms(evidence, config, config.unit_m), ROBUST_M)
    return H[0], g[0]


def _term(state, evidence, on, off) -> tuple[float, np.ndarray, np.ndarray]:
    """Cost, normal matrix and gradient of what one config has and the other has not."""
    (H_on, g_on), (H_off, g_off) = (_normal_equations(state, evidence, config) for config in (on, off))
    return _cost(state, evidence, on) - _cost(state, evidence, off), H_on - H_off, g_on - g_off


def _jacobian(state) -> np.ndarray:
    return derivative(lambda changed: positions(changed, wedge_primitive()), state)


# ---- the points


TOWARD = wedge_state().R @ np.array([0.5, 0.4, 0.768])  # three faces are seen from there
POINTS = replace(PRIORS, effective_points=150.0, misfit=0.0009, tangential=0.2)


def _seen_points():
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


def _points_cost(state, evidence, index, normals, *, gap_m2: float = 0.0) -> float:
    """The robust cost with each point's sample and its normal given, less what the gaps between samples cost."""
    gap = (evidence.points - positions(state, wedge_primitive())[index])[:-1]
    squared = ((gap * normals).sum(axis=1)) ** 2 + 0.2 * (gap**2).sum(axis=1)
    share, beside = 150.0 / 20 / (0.0013**2 + 0.0009**2), 0.2 * gap_m2
    excess = squared - beside / (1 + beside / ROBUST_M**2)
    return float(0.5 * share * ((excess / (1 + squared / ROBUST_M**2)).sum() + ROBUST_M**2))


def test_points_pay_robustly_along_and_across_the_normal_and_one_without_a_partner_in_full():
    state, evidence, index = _seen_points()
    cost, _, _ = _term(state, evidence, POINTS, PRIORS)
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
    state, evidence, index = _seen_points()
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
    state, evidence, index = _seen_points()
    _, H, g = _term(state, evidence, POINTS, PRIORS)
    normals = face_normals(state, wedge_primitive())[index[:-1]]
    slope = derivative(lambda changed: _points_cost(changed, evidence, index, normals), state)
    assert g == pytest.approx(-slope, rel=1e-5, abs=1e-5 * np.abs(slope).max())
    # The normal matrix is that of Gauss and Newton, each point by its robust weight.
    J = _jacobian(state)[index[:-1]]
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
    cost = _cost(state, seen, config) - _cost(state, seen, PRIORS)
    full = 0.5 * 150.0 / (0.0013**2 + 0.0009**2) * ROBUST_M**2
    assert cost < 0.7 * full if agrees else cost == pytest.approx(full, rel=1e-9)


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
    cost, H, g = _term(state, evidence, SEEN_EMPTY, replace(SEEN_EMPTY, free_space=False))
    assert cost == pytest.approx(expected, rel=1e-9)
    config = replace(SEEN_EMPTY, steps=(ROBUST_M,))
    assert evaluate_free_space(state, wedge_primitive(), evidence, config) == pytest.approx(expected, rel=1e-9)
    J, direction, weight = _jacobian(state)[index], back / length[:, None], share * robust**2
    along = np.einsum("nip,ni->np", J, direction)
    assert g == pytest.approx(along.T @ (weight * length), rel=1e-5, abs=1e-5 * np.abs(g).max())
    assert pytest.approx((along * weight[:, None]).T @ along, rel=1e-5, abs=1e-5 * np.abs(H).max()) == H


def test_two_states_each_pay_for_their_own_free_space():
    state, _, _, evidence = _picture(certain=True)
    moved = perturbed(state, np.concatenate([np.zeros(3), [0.02, 0.01, -0.01], np.zeros(3 + NUM_MODES)]))
    model = shape_model(wedge_primitive(), NUM_SAMPLES, NUM_MODES)
    H, g = linearise(StateBatch.of([state, moved], NUM_MODES), model, make_terms(evidence, SEEN_EMPTY, 1.0), ROBUST_M)
    for i, alone in enumerate((state, moved)):
        H_alone, g_alone = _normal_equations(alone, evidence, SEEN_EMPTY)
        assert np.allclose(H[i], H_alone, rtol=1e-9)
        assert np.allclose(g[i], g_alone, rtol=1e-9)


def test_an_occluder_before_the_surface_leaves_no_free_space():
    state, camera, silhouette, evidence = _picture(certain=True, free_range_m=0.2)
    assert len(_ways_back(state, camera, silhouette)[0]) > 0
    assert _term(state, evidence, SEEN_EMPTY, replace(SEEN_EMPTY, free_space=False))[0] == 0.0


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


def _lowest(state) -> tuple[np.ndarray, np.ndarray]:
    heights = positions(state, wedge_primitive()) @ UP
    return np.argsort(heights)[:6], np.sort(heights)[:6]


@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize("floor_above_m", [-0.004, 0.009])
def test_the_lowest_samples_are_drawn_to_the_floor(seen, floor_above_m):
    state = wedge_state()
    feet, heights = _lowest(state)
    floor = heights.mean() + floor_above_m
    evidence = toy_evidence(np.zeros((20, 3)), floor_m=floor, floor_sigma_m=(0.0015, 0.004), floor_seen=seen)

    def cost_of(heights):
        sigma = np.where(heights > floor, 0.0015, 0.004)
        squared = ((heights - floor) / sigma) ** 2
        capped = squared if seen else np.where(heights < floor, squared / (1 + squared / 9), squared)
        return 0.5 * capped.sum() / 6

    cost, H, g = _term(state, evidence, ON_FLOOR, PRIORS)
    assert cost == pytest.approx(cost_of(heights), rel=1e-9)
    slope = derivative(lambda changed: cost_of(positions(changed, wedge_primitive())[feet] @ UP), state, size=1e-7)
    assert g == pytest.approx(-slope, rel=1e-4, abs=1e-5 * np.abs(slope).max())
    sigma = np.where(heights > floor, 0.0015, 0.004)
    robust = 1 / (1 + ((heights - floor) / (3 * sigma)) ** 2) if not seen else np.ones(6)
    weight = np.where(heights < floor, robust**2, 1.0) / 6 / sigma**2
    along = np.einsum("nip,i->np", _jacobian(state)[feet], UP)
    assert pytest.approx((along * weight[:, None]).T @ along, rel=1e-5, abs=1e-5 * np.abs(H).max()) == H


# ---- the priors


def test_the_axis_pays_for_its_angle_with_that_of_the_hypothesis():
    state = wedge_state(log_scale=np.zeros(3), coefficients=np.zeros(NUM_MODES))
    evidence = toy_evidence(np.zeros((20, 3)))
    tilt = Rotation.from_rotvec(0.25 * state.R[:, 0]).as_matrix()
    state = replace(state, axis_world=tilt @ state.R[:, 2], axis_sigma_rad=0.2)
    assert _cost(state, evidence, PRIORS) == pytest.approx(0.5 * (np.sin(0.25) / 0.2) ** 2, rel=1e-6)
    H, g = _normal_equations(state, evidence, PRIORS)
    slope = derivative(lambda changed: _cost(changed, evidence, PRIORS), state)
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
    assert _cost(state, evidence, PRIORS) == pytest.approx(expected, rel=1e-9)
    H, g = _normal_equations(state, evidence, PRIORS)
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


# ---- the step


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
    feet = _lowest(state)[1].mean()
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
    state, evidence, _ = _seen_points()
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
