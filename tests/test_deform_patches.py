"""Patches: which vertices they hold, what they are told, and how their answers become one displacement."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree
from toy_bodies import l_body, primitive_of, slab

from gfp_grasp.deform import (
    MISFIT_SHARE,
    NUM_PATCHES,
    NUM_SOURCE,
    NUM_TEMPLATE,
    Patches,
    TemplatePoints,
    make_patches,
    patch_layout,
    patch_unit_m,
)
from gfp_grasp.deform.patches import blend
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.primitives import PrimitiveLibrary

EYE = np.array([0.5, -0.3, 0.4])


def template_of(points, normals, mirrored: bool | np.ndarray = False):
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    normals = np.broadcast_to(np.asarray(normals, dtype=float), points.shape)
    return TemplatePoints(points, normals, np.broadcast_to(mirrored, len(points)).copy())


def own_template(primitive, away=0.0):
    normals = vertex_normals(primitive.vertices, primitive.faces)
    return template_of(primitive.vertices + away * normals, normals)


@pytest.fixture(scope="module")
def body():
    return primitive_of(l_body(0.008))


def test_the_unit_is_a_share_of_the_size_and_a_quarter_of_that_of_the_shipped_cup(body):
    assert patch_unit_m(PrimitiveLibrary.shipped().primitive("cup")) == pytest.approx(0.0298, abs=1e-4)
    assert patch_unit_m(body) == pytest.approx(0.3248 * np.cbrt(0.08 * 0.05 * 0.1))
    large = replace(body, vertices=40 * body.vertices, modes=40 * body.modes)
    assert patch_unit_m(large) == pytest.approx(40 * patch_unit_m(body))


def test_what_is_flat_has_the_unit_of_something_a_tenth_of_its_diagonal_thick():
    plate = primitive_of(slab((0.12, 0.08, 0.002)))
    diagonal = np.linalg.norm([0.12, 0.08, 0.002])
    assert patch_unit_m(plate) == pytest.approx(0.3248 * np.cbrt(0.12 * 0.08 * 0.1 * diagonal))


def test_patches_start_at_the_top_and_each_next_one_is_farthest_from_those_before(body):
    index, _ = patch_layout(body)
    assert index.shape == (NUM_PATCHES, NUM_SOURCE) == (64, 64)
    features = np.hstack([body.vertices, patch_unit_m(body) * vertex_normals(body.vertices, body.faces)])
    assert body.vertices[index[0, 0], 2] == body.vertices[:, 2].max()
    for i in (1, 2, 30, 63):
        gaps = np.linalg.norm(features[:, None] - features[index[:i, 0]], axis=2).min(axis=1)
        assert gaps[index[i, 0]] == pytest.approx(gaps.max())


def test_a_patch_holds_the_vertices_that_are_nearest_and_face_its_way_and_weighs_them_by_a_bell(body):
    index, weights = patch_layout(body)
    features = np.hstack([body.vertices, patch_unit_m(body) * vertex_normals(body.vertices, body.faces)])
    for i in (0, 17, 63):
        reach = np.linalg.norm(features[index[i]] - features[index[i, 0]], axis=1)
        others = np.setdiff1d(np.arange(len(features)), index[i])
        assert reach[0] == 0
        assert reach.max() <= np.linalg.norm(features[others] - features[index[i, 0]], axis=1).min() + 1e-12
        assert weights[i] == pytest.approx(np.exp(-((reach / (0.6 * reach.max())) ** 2)))


def test_a_small_primitive_repeats_its_vertices():
    few = primitive_of(slab((0.12, 0.08, 0.03), edge_m=0.08))
    assert len(few.vertices) < NUM_SOURCE
    index, weights = patch_layout(few)
    assert index.shape == weights.shape == (len(few.vertices), NUM_SOURCE)
    assert all(set(row) == set(range(len(few.vertices))) for row in index)
    assert (index[:, len(few.vertices)] == index[:, 0]).all()


def test_the_two_sides_of_a_plate_are_not_one_patch():
    plate = primitive_of(slab((0.12, 0.08, 0.002), edge_m=0.006))
    index, _ = patch_layout(plate)
    inner = np.abs(plate.vertices[:, :2]).max(axis=1) < 0.02
    for row in index:
        if inner[row[0]]:
            assert len(set(np.sign(plate.vertices[row[inner[row]], 2]))) == 1


def test_source_and_template_are_given_in_the_patches_own_frames(body):
    template = own_template(body, away=0.002)
    p = make_patches(body, body.vertices, template, EYE)
    normals = vertex_normals(body.vertices, body.faces)
    centre = body.vertices[p.index[:, 0]]
    assert p.unit_m == patch_unit_m(body)
    back = p.frames.transpose(0, 2, 1)
    source = centre[:, None] + p.unit_m * (p.source @ back)
    assert source == pytest.approx(body.vertices[p.index], abs=1e-9)
    assert p.source_normals @ back == pytest.approx(normals[p.index], abs=1e-9)
    there = centre[:, None] + p.unit_m * (p.template @ back)
    gap, which = KDTree(template.points).query(there)
    assert gap.max() < 1e-9
    assert p.template_normals @ back == pytest.approx(template.normals[which], abs=1e-9)
    # Right-handed, z along the normal, x as much upright as it can be (or towards x where the normal is upright).
    assert np.linalg.det(p.frames) == pytest.approx(np.ones(len(p.frames)))
    assert p.frames[:, :, 2] == pytest.approx(normals[p.index[:, 0]])
    upright = np.abs(p.frames[:, 2, 2]) > 0.95
    assert 0 < upright.sum() < len(upright)
    assert p.frames[~upright, 2, 1] == pytest.approx(np.zeros((~upright).sum()), abs=1e-12)
    assert (p.frames[~upright, 2, 0] > 0.3).all()
    assert p.frames[upright, 0, 1] == pytest.approx(np.zeros(upright.sum()), abs=1e-12)
    assert (p.frames[upright, 0, 0] > 0.9).all()


def test_a_patch_sees_the_template_points_that_are_near_and_face_its_way(body):
    normals = vertex_normals(body.vertices, body.faces)
    here = own_template(body)
    inverted = template_of(body.vertices, -normals)
    both = TemplatePoints(
        np.concatenate([here.points, inverted.points]),
        np.concatenate([here.normals, inverted.normals]),
        np.repeat([False, True], len(normals)),
    )
    p = make_patches(body, body.vertices, both, None)
    centre, axis = body.vertices[p.index[:, 0]], normals[p.index[:, 0]]
    reach = np.linalg.norm(body.vertices[p.index] - centre[:, None], axis=2).max(axis=1)
    there = centre[:, None] + p.unit_m * (p.template @ p.frames.transpose(0, 2, 1))
    facing = p.template_normals @ p.frames.transpose(0, 2, 1)
    features = np.concatenate([there - centre[:, None], p.unit_m * (facing - axis[:, None])], axis=2)
    sees = p.pose_features[:, -1] > 0
    assert (np.linalg.norm(features, axis=2) <= 1.2 * reach[:, None] + 1e-9)[sees].all()
    for i in range(len(centre)):
        near = np.hstack([both.points - centre[i], p.unit_m * (both.normals - axis[i])])
        count = int((np.linalg.norm(near, axis=1) <= 1.2 * reach[i]).sum())
        assert p.pose_features[i, -1] == pytest.approx(min(count, NUM_TEMPLATE) / NUM_TEMPLATE)
        given = np.hstack([p.template[i], p.template_normals[i]])
        assert len(np.unique(np.round(given, 9), axis=0)) == min(count, NUM_TEMPLATE)


def test_of_many_template_points_some_are_drawn_that_cover_the_patch():
    """A dense level grid over the plate, in rows of growing x: the 64 that a patch gets are not the first ones."""
    x, y = np.meshgrid(np.linspace(-0.06, 0.06, 61), np.linspace(-0.04, 0.04, 41), indexing="ij")
    grid = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.016)], axis=1)
    p = make_patches(PLATE, PLATE.vertices, template_of(grid, (0, 0, 1)), None)
    centre = PLATE.vertices[p.index[:, 0]]
    inner = (np.abs(centre[:, :2]) < (0.02, 0.01)).all(axis=1) & (centre[:, 2] > 0)
    assert inner.any()
    there = p.unit_m * (p.template @ p.frames.transpose(0, 2, 1))[inner]
    assert np.abs(there[..., :2].mean(axis=1)).max() < 0.4 * p.unit_m
    assert (there[..., 0].max(axis=1) > 0.6 * p.unit_m).all()


def test_a_patch_with_fewer_than_six_template_points_sees_nothing(body):
    start = body.vertices[np.argmax(body.vertices[:, 2])]
    axis = vertex_normals(body.vertices, body.faces)[np.argmax(body.vertices[:, 2])]
    far = template_of(np.tile([[5.0, 5.0, 5.0]], (20, 1)), (1, 0, 0))

    def seen(count):
        near = template_of(start + 0.001 * np.arange(count)[:, None] * np.array([1, 0, 0]), axis)
        both = (np.concatenate([getattr(t, f) for t in (near, far)]) for f in ("points", "normals", "mirrored"))
        return make_patches(body, body.vertices, TemplatePoints(*both), None).pose_features[0, -1]

    assert seen(5) == 0
    assert seen(6) == pytest.approx(6 / NUM_TEMPLATE)


def test_pose_features_are_centre_direction_to_the_viewer_normal_and_share_seen(body):
    p = make_patches(body, body.vertices, own_template(body), EYE)
    blind = make_patches(body, body.vertices, own_template(body), None)
    centre = body.vertices[p.index[:, 0]]
    sight = EYE - centre
    assert p.pose_features[:, :3] * p.unit_m == pytest.approx(centre)
    assert p.pose_features[:, 3:6] == pytest.approx(sight / np.linalg.norm(sight, axis=1, keepdims=True))
    assert p.pose_features[:, 6:9] == pytest.approx(vertex_normals(body.vertices, body.faces)[p.index[:, 0]])
    assert not blind.pose_features[:, 3:6].any()
    assert blind.pose_features[:, 6:] == pytest.approx(p.pose_features[:, 6:])


def test_those_that_see_nothing_are_left_out_field_by_field(body):
    at_top = body.vertices[:, 2] > 0.08
    normals = vertex_normals(body.vertices, body.faces)
    p = make_patches(body, body.vertices, template_of(body.vertices[at_top], normals[at_top]), None)
    sees = p.pose_features[:, -1] > 0
    assert 0 < sees.sum() < len(sees)
    seeing = p.seeing()
    for name in ("index", "source", "template", "mirrored", "residuals", "pose_features", "frames", "weights"):
        np.testing.assert_array_equal(getattr(seeing, name), getattr(p, name)[sees])
    assert seeing.unit_m == p.unit_m


# What template points say of one vertex: the middle of a plate's upper side, its normal straight up.
PLATE = primitive_of(slab((0.12, 0.08, 0.03), edge_m=0.01))
TOP = int(np.argmin(np.linalg.norm(PLATE.vertices - [0, 0, 0.015], axis=1)))
MISFIT = MISFIT_SHARE * patch_unit_m(PLATE)


def residuals_of_top(template):
    p = make_patches(PLATE, PLATE.vertices, template, None)
    row, column = np.argwhere(p.index == TOP)[0]
    return p.residuals[row, column]


def around_top(count, height, *, spread=0.001):
    """Points over the vertex, on a spiral of ever larger radius, `height` (count,) over its plane."""
    turn = 2.4 * np.arange(count)
    reach = spread * (1 + np.arange(count) / 100)
    beside = np.stack([reach * np.cos(turn), reach * np.sin(turn), np.broadcast_to(height, count)], axis=1)
    return PLATE.vertices[TOP] + beside


def test_residuals_are_the_mean_height_of_the_nearest_four_and_of_the_nearest_sixteen():
    height = MISFIT * np.where(np.arange(30) < 4, 0.5, np.where(np.arange(30) < 16, 1.3, 0.0))
    height[16:] = 9 * MISFIT  # farther away, of no matter
    residuals = residuals_of_top(template_of(around_top(30, height), (0, 0, 1)))
    assert residuals[0] == pytest.approx(0.5)
    assert residuals[1] == pytest.approx((4 * 0.5 + 12 * 1.3) / 16)
    assert residuals[3] == 1.0
    nearest = np.hypot(0.001, 0.5 * MISFIT)
    assert residuals[2] == pytest.approx(np.exp(-nearest / (4 / 30 * patch_unit_m(PLATE))))
    assert not residuals[4:].any()


def test_residuals_are_signed_and_held_to_three():
    assert residuals_of_top(template_of(around_top(16, -0.7 * MISFIT), (0, 0, 1)))[:2] == pytest.approx([-0.7, -0.7])
    assert residuals_of_top(template_of(around_top(16, 4 * MISFIT), (0, 0, 1)))[:2] == pytest.approx([3.0, 3.0])
    assert residuals_of_top(template_of(around_top(16, -4 * MISFIT), (0, 0, 1)))[:2] == pytest.approx([-3.0, -3.0])


def test_residuals_of_mirrored_points_stand_beside_those_of_observed_ones():
    points = np.concatenate([around_top(16, 0.4 * MISFIT), around_top(16, -1.1 * MISFIT)])
    residuals = residuals_of_top(template_of(points, (0, 0, 1), np.repeat([False, True], 16)))
    assert residuals[[0, 1, 4, 5]] == pytest.approx([0.4, 0.4, -1.1, -1.1])
    assert residuals[[3, 7]] == pytest.approx([1.0, 1.0])


def test_residuals_are_taken_over_the_plane_of_each_point():
    """A plane that leans by 20 degrees, 0.6 misfits over the vertex: every point of it says so."""
    lean = np.deg2rad(20)
    normal = np.array([np.sin(lean), 0, np.cos(lean)])
    points = around_top(16, 0.0)
    points[:, 2] += (0.6 * MISFIT - (points - PLATE.vertices[TOP]) @ normal) / normal[2]
    assert residuals_of_top(template_of(points, normal))[:2] == pytest.approx([0.6, 0.6])


def test_points_whose_normals_do_not_agree_count_for_nothing():
    points = around_top(16, 0.5 * MISFIT)
    normals = np.tile([0.0, 0.0, 1.0], (16, 1))
    away = np.arange(16) % 2 == 1
    points[away, 2] += 2 * MISFIT
    for degrees, agrees in ((59.0, True), (61.0, False)):
        normals[away] = [np.sin(np.deg2rad(degrees)), 0, np.cos(np.deg2rad(degrees))]
        residuals = residuals_of_top(template_of(points, normals))
        assert residuals[3] == (1.0 if agrees else 0.5)
        assert (residuals[1] == pytest.approx(0.5)) is not agrees
    assert not residuals_of_top(template_of(points, (0, 0, -1))).any()


def test_displacements_of_overlapping_patches_are_their_weighted_mean():
    """Two patches of two vertices that share vertex 1; the second is turned by a quarter about z."""
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    empty = np.zeros((2, 2, 3))
    patches = Patches(
        index=np.array([[0, 1], [1, 2]]),
        source=empty,
        source_normals=empty,
        template=empty,
        template_normals=empty,
        mirrored=np.zeros((2, 2), bool),
        residuals=np.zeros((2, 2, 8)),
        pose_features=np.zeros((2, 10)),
        frames=np.stack([np.eye(3), turned]),
        weights=np.array([[1.0, 0.25], [0.75, 0.5]]),
        unit_m=0.02,
    )
    moved = np.array([[[1.0, 2, 3], [4, 0, 0]], [[4, 0, 0], [0, 0, 5]]])
    displacement, weight = blend(patches, moved, 4)
    expected = [[1, 2, 3], 0.25 * np.array([4, 0, 0]) + 0.75 * np.array([0, 4, 0]), [0, 0, 5], [0, 0, 0]]
    assert displacement == pytest.approx(0.02 * np.array(expected))
    assert weight == pytest.approx([1.0, 1.0, 0.5, 0.0])
