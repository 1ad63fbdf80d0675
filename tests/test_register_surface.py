"""Samples of a surface: where they lie, how a step moves them, which faces look back, what lies on a handle."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from tilted_table import UP
from toy_wedge import NUM_MODES, NUM_SAMPLES, face_normals, positions, toy_evidence, wedge_primitive, wedge_state
from wedge_terms import jacobian

from gfp_grasp.camera import cast_rays
from gfp_grasp.meshes import triangle_normals
from gfp_grasp.register import part_is_seen
from gfp_grasp.register.occlusion import _faces_toward
from gfp_grasp.register.posterior import NormalEquations, StateSurface, shape_model
from gfp_grasp.register.state import StateBatch, surface_samples
from gfp_grasp.transforms import apply_T, make_T
from gfp_grasp.types import BODY_REGIONS, INSIDE, FittedPrimitive

STATES = (
    wedge_state(),
    wedge_state(
        R=Rotation.from_rotvec([-1.2, 0.3, 0.5]).as_matrix(),
        t=np.array([-0.2, 0.6, 0.1]),
        log_scale=np.array([-0.3, 0.25, 0.4]),
        coefficients=np.array([-0.6, 0.2, 0.9]),
    ),
)


def surface() -> StateSurface:
    return StateSurface(StateBatch.of(STATES, NUM_MODES), shape_model(wedge_primitive(), NUM_SAMPLES, NUM_MODES))


def test_samples_and_normals_are_those_of_each_state():
    made = surface()
    for i, state in enumerate(STATES):
        np.testing.assert_allclose(made.world[i], positions(state, wedge_primitive()), atol=1e-12)
        np.testing.assert_allclose(made.normals[i], face_normals(state, wedge_primitive()), atol=1e-9)


def test_the_gap_between_samples_goes_with_the_area():
    wedge = wedge_primitive()
    states = [
        wedge_state(log_scale=np.log(scale), coefficients=np.zeros(NUM_MODES))
        for scale in ([1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [1.0, 1.0, 1.7])
    ]
    made = StateSurface(StateBatch.of(states, NUM_MODES), shape_model(wedge, NUM_SAMPLES, NUM_MODES))
    areas = [
        trimesh.Trimesh(wedge.vertices * np.exp(state.log_scale), wedge.faces, process=False).area for state in states
    ]
    assert made.sample_gap_m2[:2] == pytest.approx(0.3 * np.array(areas[:2]) / NUM_SAMPLES, rel=1e-9)
    assert made.sample_gap_m2[2] == pytest.approx(0.3 * areas[2] / NUM_SAMPLES, rel=0.02)
    inside = wedge.vertices[:, 2] > 0.03
    hollow = replace(wedge, regions=np.where(inside, INSIDE, 0))
    outer = ~inside[wedge.faces[surface_samples(wedge, NUM_SAMPLES).face]].all(axis=1)
    found = StateSurface(StateBatch.of(states[:1], NUM_MODES), shape_model(hollow, NUM_SAMPLES, NUM_MODES))
    assert 0.1 < outer.mean() < 0.9
    assert found.sample_gap_m2[0] == pytest.approx(outer.mean() * made.sample_gap_m2[0], rel=1e-9)


def test_vectors_are_told_along_the_axes_of_their_states_object():
    vectors = np.random.default_rng(0).normal(size=(3, 4, 3))
    found = surface().along_body(np.array([1, 0, 1]), vectors)
    assert found.dtype == np.float32
    for own, vector, i in zip(found, vectors, (1, 0, 1), strict=True):
        np.testing.assert_allclose(own, [STATES[i].R.T @ v for v in vector], atol=1e-6)


@pytest.mark.parametrize("order", [(0, 1), (1, 0), (1,)])
def test_a_step_moves_samples_as_differences_say(order: tuple[int, ...]):
    index = np.random.default_rng(1).integers(NUM_SAMPLES, size=(len(order), 11))
    found = surface().derivative(np.array(order), index)
    assert found.dtype == np.float32
    assert found.shape == (len(order), 11, 3, 9 + NUM_MODES)
    for D, own, i in zip(found, index, order, strict=True):
        expected = np.einsum("ji,njp->nip", STATES[i].R, jacobian(STATES[i])[own])
        np.testing.assert_allclose(D, expected, atol=2e-6)


def test_pulls_add_up_over_the_samples_of_each_state():
    rng = np.random.default_rng(2)
    state, index = np.array([0, 0, 1, 1, 1]), rng.integers(NUM_SAMPLES, size=5)
    gap, weight = rng.normal(size=(5, 3)) * 0.01, rng.uniform(0.5, 2.0, 5)
    sums, cost_only = (NormalEquations(surface(), 0.004, cost_only=flag) for flag in (False, True))
    for each in (sums, cost_only):
        each.pull_samples(state, index, gap, weight)
    assert not cost_only.H.any()
    assert not cost_only.g.any()
    for i in (0, 1):
        H, g = np.zeros_like(sums.H[i]), np.zeros_like(sums.g[i])
        for k in np.flatnonzero(state == i):
            length = np.linalg.norm(gap[k])
            J = (gap[k] / length) @ jacobian(STATES[i])[index[k]]
            H, g = H + weight[k] * np.outer(J, J), g + weight[k] * length * J
        np.testing.assert_allclose(sums.H[i], H, atol=1e-5)
        np.testing.assert_allclose(sums.g[i], g, atol=1e-6)


@pytest.mark.parametrize("tangential", [0.0, 0.3])
def test_points_pull_along_their_normals_in_full_and_across_them_by_a_share(tangential: float):
    rng = np.random.default_rng(3)
    index, weight = rng.integers(NUM_SAMPLES, size=(2, 6)), rng.uniform(0.5, 2.0, (2, 6))
    gap, normals = rng.normal(size=(2, 6, 3)) * 0.01, rng.normal(size=(2, 6, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    sums = NormalEquations(surface(), 0.004)
    sums.pull_points(index, gap, normals, weight, tangential)
    for i in (0, 1):
        J = jacobian(STATES[i])[index[i]]
        W = weight[i][:, None, None] * (normals[i][:, :, None] * normals[i][:, None] + tangential * np.eye(3))
        np.testing.assert_allclose(sums.H[i], np.einsum("nip,nij,njq->pq", J, W, J), atol=1e-5)
        np.testing.assert_allclose(sums.g[i], np.einsum("nip,nij,nj->p", J, W, gap[i]), atol=1e-6)


def test_a_ray_from_outside_hits_faces_that_look_back_first_and_no_others():
    primitive, viewpoint = wedge_primitive(), np.array([0.4, -0.3, 0.25])
    toward = _faces_toward(primitive.vertices, primitive.faces, viewpoint)
    corners = primitive.vertices[primitive.faces]
    rays = corners.mean(axis=1) - viewpoint
    whole, _, _ = cast_rays([(primitive.vertices, primitive.faces)], viewpoint, rays)
    half, _, _ = cast_rays([(primitive.vertices, primitive.faces[toward])], viewpoint, rays)
    np.testing.assert_allclose(half, whole)
    assert 0.2 < toward.mean() < 0.8
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_array_equal(toward, [normal @ ray < 0 for normal, ray in zip(normals, rays, strict=True)])
    assert not _faces_toward(primitive.vertices, primitive.faces[:, ::-1], viewpoint)[toward].any()


def test_normals_of_triangles_are_twice_their_area_long_and_may_move_in_many_ways():
    triangle = np.add([[0.0, 0, 0], [3, 0, 0], [0, 2, 0]], [1.0, -2.0, 5.0])
    np.testing.assert_allclose(triangle_normals(triangle[None]), [[0, 0, 6.0]], atol=1e-12)
    many = np.random.default_rng(0).normal(size=(4, 3, 7, 3))  # (f, 3, ..., 3)
    found = triangle_normals(many)
    assert found.shape == (4, 7, 3)
    np.testing.assert_allclose(found[2, 5], triangle_normals(many[2:3, :, 5])[0])


def test_samples_of_the_normals_are_those_of_the_moved_faces():
    state, primitive = wedge_state(), wedge_primitive()
    surface = StateSurface(StateBatch.of([state], 3), shape_model(primitive, 60, 3))
    assert surface.world[0] == pytest.approx(positions(state, primitive))
    assert surface.normals[0] == pytest.approx(face_normals(state, primitive), abs=1e-9)


def test_samples_lie_on_the_surface_in_proportion_to_its_area_and_follow_the_modes():
    primitive = wedge_primitive()
    samples = surface_samples(primitive, 400)
    corners = primitive.vertices[primitive.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    for side in range(3):
        for end in (0, 1):
            part = np.abs(corners[..., side] - np.sort(corners[..., side].ravel())[-end]).max(axis=1) < 1e-9
            share = area[part].sum() / area.sum()
            assert (part[samples.face]).mean() == pytest.approx(share, abs=0.02)
    assert samples.weights.min() >= 0
    assert samples.weights.sum(axis=1) == pytest.approx(np.ones(400))
    coefficients = np.array([1.0, -2.0, 0.5])
    moved = primitive.shape(coefficients, np.ones(3))[primitive.faces[samples.face]]
    expected = np.einsum("mc,mcd->md", samples.weights, moved)
    assert samples.local(coefficients) == pytest.approx(expected)
    state = wedge_state()
    assert positions(state, primitive) == pytest.approx(
        apply_T(
            make_T(state.R, state.t), np.exp(state.log_scale) * surface_samples(primitive, 60).local(state.coefficients)
        )
    )


def test_a_handle_is_seen_where_enough_points_lie_on_it_and_off_the_body():
    primitive = wedge_primitive()
    x = primitive.vertices[:, 0]
    primitive = replace(
        primitive, regions=np.where(x > 0.06, 2, 0).astype(np.uint8), region_names=(*BODY_REGIONS, "handle"), spec=None
    )
    state = wedge_state()
    fit = FittedPrimitive(
        primitive, make_T(state.R, state.t), np.exp(state.log_scale), state.coefficients, residual_m=0.001
    )
    samples = surface_samples(primitive)
    world = state.world(samples.local(state.coefficients))
    held = (primitive.on_region("handle")[primitive.faces[samples.face]]).all(axis=1)
    off_body = np.flatnonzero(held & (KDTree(world[~held]).query(world)[0] > 0.012))
    near_body = np.flatnonzero(held & (KDTree(world[~held]).query(world)[0] < 0.004))
    body = world[~held][:200]
    normal = UP

    def seen(points) -> bool:
        return part_is_seen(fit, "handle", toy_evidence(np.concatenate([body, points])))

    assert seen(world[off_body[:6]] + 0.006 * normal)
    assert not seen(world[off_body[:5]])
    assert not seen(world[near_body[:50]])
    assert not seen(world[off_body[:50]] + 0.05 * normal)
    for regions in (np.zeros(len(x)), np.full(len(x), 2)):
        bare = replace(fit, primitive=replace(primitive, regions=regions.astype(np.uint8)))
        assert not part_is_seen(bare, "handle", toy_evidence(world))
