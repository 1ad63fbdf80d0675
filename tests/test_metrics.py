"""Distances and scores between shapes."""

import time

import numpy as np
import pytest
import trimesh

from gfp_grasp.errors import InvalidCloud, InvalidMesh, InvalidOption
from gfp_grasp.metrics import chamfer_m, completion_errors, f_score, iou, visible_surface
from gfp_grasp.shapes import make_shape


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
