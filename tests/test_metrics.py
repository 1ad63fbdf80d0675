"""Distances and scores between shapes."""

import time

import numpy as np
import pytest
import trimesh

from gfp_grasp.errors import InvalidCloud, InvalidMesh, InvalidOption
from gfp_grasp.metrics import chamfer_m, completion_errors, f_score, iou, scale_error, visible_surface
from gfp_grasp.shapes import make_shape
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about


def test_chamfer_is_the_sum_of_both_mean_distances():
    a, b = np.array([[0.0, 0, 0], [1, 0, 0]]), np.array([[0.0, 0, 0.3]])
    assert chamfer_m(a, b) == pytest.approx((0.3 + np.hypot(1, 0.3)) / 2 + 0.3)
    assert chamfer_m(a, b) == chamfer_m(b, a)
    assert chamfer_m(a, a) == 0.0


def test_f_score_of_half_a_match():
    a = np.array([[0.0, 0, 0], [1, 0, 0]])
    assert f_score(a, a) == 1.0
    assert f_score(a, a[:1] + 0.001) == pytest.approx(2 * 0.5 * 1 / 1.5)
    assert f_score(a, a + 5) == 0.0


def test_empty_misshapen_and_unbounded_points_are_refused():
    good = np.zeros((3, 3))
    for bad in (np.zeros((0, 3)), np.zeros((3, 2)), np.full((3, 3), np.nan)):
        with pytest.raises(InvalidCloud, match="expected"):
            chamfer_m(good, bad)
        with pytest.raises(InvalidCloud, match="expected"):
            f_score(bad, good)
    with pytest.raises(InvalidOption, match="threshold_m"):
        f_score(good, good, 0.0)


def test_near_is_within_five_millimetres_of_either_set():
    rng = np.random.default_rng(0)
    a, up = rng.uniform(-1, 1, (50, 3)), np.array([0.0, 0.0, 1.0])
    assert f_score(a, a + 0.0049 * up) == 1.0
    assert f_score(a, a + 0.0051 * up) == 0.0
    assert f_score(a, a + 0.006 * up, 0.007) == 1.0
    # Precision is the share of a, recall that of b: 20 of 50 and 20 of 30 are near.
    b = np.concatenate([a[:20] + 0.001 * up, a[:10] + 9 * up])
    assert f_score(a, b) == pytest.approx(2 * 0.4 * (2 / 3) / (0.4 + 2 / 3))


def test_iou_of_shifted_cubes_is_exact():
    cube = trimesh.creation.box((1, 1, 1))
    assert iou(cube, cube.copy().apply_translation([0.5, 0, 0])) == pytest.approx(0.5 / 1.5, abs=1e-6)
    assert iou(cube, cube.copy().apply_translation([2, 0, 0])) == pytest.approx(0.0)
    with pytest.raises(InvalidMesh, match="mesh_b"):
        iou(cube, trimesh.Trimesh(cube.vertices, cube.faces[1:], process=False))


def test_the_inside_of_an_open_cup_is_seen_and_a_sealed_void_is_not():
    outer, inner = trimesh.creation.icosphere(3, 0.05), trimesh.creation.icosphere(3, 0.04)
    inner.invert()
    radius = np.linalg.norm(visible_surface(_together(outer, inner), 4000, np.random.default_rng(0)), axis=1)
    assert radius.min() > 0.045
    cup = make_shape("cup", 3)
    seen = visible_surface(cup.mesh, 4000, np.random.default_rng(0))
    inside = np.linalg.norm(seen[:, :2], axis=1) < 0.5 * cup.mesh.extents[0] * 0.5
    floor = seen[inside & (seen[:, 2] < 0.3 * cup.mesh.extents[2]), 2]
    assert (floor > 0.0005).mean() == pytest.approx(0.5, abs=0.15)


def test_the_wall_inside_a_deep_cup_is_seen_by_what_gets_out_at_the_top():
    """A tube with a floor, as deep as four of its radii: few of a sample's rays leave, but some do."""
    outer = trimesh.creation.cylinder(0.03, 0.12, sections=48)
    inner = trimesh.creation.cylinder(0.025, 0.12, sections=48)
    inner.apply_translation([0, 0, 0.01])
    cup = trimesh.boolean.difference([outer, inner], engine="manifold")
    cup.apply_transform(make_T(rotation_about((1, 2, 3), 1.0), (0.3, -0.2, 0.5)))
    seen = visible_surface(cup, 6000, np.random.default_rng(0))
    upright = apply_T(invert_T(make_T(rotation_about((1, 2, 3), 1.0), (0.3, -0.2, 0.5))), seen)
    inside = np.hypot(upright[:, 0], upright[:, 1]) < 0.0251
    wall = inside & (upright[:, 2] > -0.04)
    share = 0.025 * 0.1 * 2 * np.pi / cup.area
    assert wall.mean() == pytest.approx(share, rel=0.1)


def test_an_open_sheet_is_looked_at_from_both_sides():
    """A square whose normal points down into a socket that it closes: its other side sees the sky."""
    square = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0], [0, 0.1, 0]], [[0, 2, 1], [0, 3, 2]])
    assert square.face_normals[0, 2] == -1
    around = trimesh.creation.box(bounds=[[-0.2, -0.2, -0.2], [0.3, 0.3, -0.0001]])
    hole = trimesh.creation.box(bounds=[[0.0001, 0.0001, -0.1], [0.0999, 0.0999, 0.1]])
    socket = trimesh.boolean.difference([around, hole], engine="manifold")
    lid = _together(square, socket)
    seen = visible_surface(lid, 3000, np.random.default_rng(0))
    on_lid = (np.abs(seen[:, 2]) < 1e-6).sum()
    assert on_lid == pytest.approx(3000 * square.area / (square.area + socket.area), rel=0.3)


def test_hidden_samples_are_replaced_and_what_cannot_be_seen_at_all_is_refused():
    ball = trimesh.creation.icosphere(2, 0.05)
    inside_out = ball.copy()
    inside_out.invert()
    cage = _together(trimesh.creation.icosphere(2, 0.06), inside_out)
    assert len(visible_surface(cage, 300, np.random.default_rng(0))) == 300
    copies = [trimesh.creation.icosphere(2, 0.045) for _ in range(3)]  # their volume outweighs that of the shell
    sealed = _together(_together(inside_out, copies[0]), _together(copies[1], copies[2]))
    assert sealed.is_volume
    with pytest.raises(InvalidMesh, match="inside out"):
        visible_surface(sealed, 50, np.random.default_rng(0))


def test_visible_samples_are_as_many_as_asked_uniform_and_repeatable():
    ball = trimesh.creation.icosphere(4, 0.05)
    a, b = (visible_surface(ball, 8192, np.random.default_rng(1)) for _ in range(2))
    np.testing.assert_array_equal(a, b)
    assert a.shape == (8192, 3)
    np.testing.assert_allclose(a.mean(axis=0), 0.0, atol=0.002)


def test_fifty_thousand_faces_are_sampled_in_time():
    mug = make_shape("mug", 1).mesh.subdivide().subdivide()
    assert len(mug.faces) > 50_000
    started = time.perf_counter()
    visible_surface(mug, 8192, np.random.default_rng(0))
    assert time.perf_counter() - started < 3.0


def test_the_inner_side_of_a_hollow_wall_is_hidden():
    ball = trimesh.creation.icosphere(2, 0.05)
    room = trimesh.Trimesh(ball.vertices, ball.faces, process=False)
    room.invert()
    shell = _together(room, trimesh.creation.icosphere(2, 0.06))
    assert np.linalg.norm(visible_surface(shell, 500, np.random.default_rng(0)), axis=1).min() > 0.055


def test_a_completion_twice_as_large_has_a_scale_error_of_one():
    ball = trimesh.creation.icosphere(4, 0.05)
    double = ball.copy().apply_scale(2.0)
    errors = completion_errors(double, ball, rng=np.random.default_rng(0))
    assert errors.scale_error == pytest.approx(1.0, abs=1e-6)
    assert errors.cd_m == pytest.approx(0.1, rel=0.01)
    assert errors.f_score == 0.0


def test_scale_error_is_signed_and_that_of_the_hulls():
    body = trimesh.creation.box((0.1, 0.2, 0.3))
    half = body.copy().apply_scale([0.5, 1.0, 1.0])
    assert scale_error(half, body) == pytest.approx(np.cbrt(0.5) - 1)
    assert scale_error(body, half) == pytest.approx(np.cbrt(2.0) - 1)
    assert scale_error(np.asarray(half.vertices), body) == pytest.approx(np.cbrt(0.5) - 1)


def test_a_perfect_completion_is_at_the_floor_of_sampling():
    mug = make_shape("mug", 1).mesh
    errors = completion_errors(mug, mug, rng=np.random.default_rng(0))
    assert errors.cd_m < 0.004
    assert errors.f_score > 0.999
    assert errors.scale_error == 0.0


def test_points_can_be_compared_as_they_are():
    ball = trimesh.creation.icosphere(4, 0.05)
    half = visible_surface(ball, 4000, np.random.default_rng(2))
    errors = completion_errors(half[half[:, 2] > 0], ball, rng=np.random.default_rng(0))
    assert 0.009 < errors.cd_m < 0.03
    with pytest.raises(InvalidCloud, match="mesh has shape"):
        completion_errors(np.zeros((4, 2)), ball, rng=np.random.default_rng(0))


def _together(a: trimesh.Trimesh, b: trimesh.Trimesh) -> trimesh.Trimesh:
    faces = np.concatenate([a.faces, b.faces + len(a.vertices)])
    return trimesh.Trimesh(np.concatenate([a.vertices, b.vertices]), faces, process=False)
