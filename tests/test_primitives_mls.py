"""Projection onto the moving-least-squares surface."""

import numpy as np
import pytest

from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.primitives.mls import project


def _sphere(count, rng):
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _plane(count, rng, height=0.0):
    return np.c_[rng.uniform(-0.05, 0.05, (count, 2)), np.full(count, height)]


def test_points_above_an_exact_plane_land_on_it():
    rng = np.random.default_rng(0)
    plane, up = _plane(2000, rng), np.array([0.0, 0.0, 1.0])
    points = _plane(100, rng) * 0.8 + 0.001 * up
    moved = project(points, np.tile(up, (100, 1)), plane, np.tile(up, (2000, 1)), radius_m=0.005)
    np.testing.assert_allclose(moved[:, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(moved[:, :2], points[:, :2], atol=1e-9)


def test_noise_on_a_plane_is_halved_at_least():
    rng = np.random.default_rng(1)
    plane = _plane(4000, rng)
    plane[:, 2] += 0.001 * rng.normal(size=4000)
    up = np.tile([0.0, 0.0, 1.0], (4000, 1))
    moved = project(plane, up, plane, up, radius_m=0.006)
    inner = np.abs(plane[:, :2]).max(axis=1) < 0.04
    assert moved[inner, 2].std() < 0.0005


@pytest.mark.parametrize("degree", [1, 2])
def test_noisy_sphere_is_smoothed_and_quadrics_do_not_shrink_it(degree):
    rng = np.random.default_rng(2)
    normals = _sphere(6000, rng)
    points = normals * (0.04 + 0.0005 * rng.normal(size=(6000, 1)))
    moved = project(points, normals, points, normals, radius_m=0.005, degree=degree)
    radius = np.linalg.norm(moved, axis=1)
    assert radius.std() < 0.0003
    assert abs(radius.mean() - 0.04) < (0.00005 if degree == 2 else 0.0005)


def test_thin_wall_keeps_its_thickness_though_the_kernel_reaches_through_it():
    rng = np.random.default_rng(3)
    front, back = _plane(4000, rng, 0.0015), _plane(4000, rng, 0.0)
    points = np.vstack([front, back]) + 0.0002 * rng.normal(size=(8000, 3))
    normals = np.repeat([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], 4000, axis=0)
    moved = project(points, normals, points, normals, radius_m=0.005)
    assert moved[:4000, 2].mean() - moved[4000:, 2].mean() == pytest.approx(0.0015, abs=0.00003)


def test_double_layer_of_one_side_becomes_one():
    rng = np.random.default_rng(4)
    layers = np.vstack([_plane(4000, rng, 0.0), _plane(4000, rng, 0.001)])
    up = np.tile([0.0, 0.0, 1.0], (8000, 1))
    moved = project(layers, up, layers, up, radius_m=0.006)
    assert abs(moved[:4000, 2].mean() - moved[4000:, 2].mean()) < 0.0001


def test_projection_moves_with_the_data():
    rng = np.random.default_rng(5)
    normals = _sphere(500, rng)
    points = normals * 0.04 + 0.0003 * rng.normal(size=(500, 3))
    shift = np.array([1.0, 2.0, 3.0])
    here = project(points, normals, points, normals, radius_m=0.008)
    there = project(points + shift, normals, points + shift, normals, radius_m=0.008)
    np.testing.assert_allclose(there, here + shift, atol=1e-9)


def test_point_without_compatible_neighbours_stays():
    rng = np.random.default_rng(6)
    plane = _plane(500, rng)
    point, down = np.array([[0.0, 0.0, 0.001]]), np.array([[0.0, 0.0, -1.0]])
    moved = project(point, down, plane, np.tile([0.0, 0.0, 1.0], (500, 1)), radius_m=0.005)
    np.testing.assert_array_equal(moved, point)


def test_normals_that_do_not_fit_the_points_are_refused():
    with pytest.raises(InvalidMesh, match="normals have shape"):
        project(np.zeros((4, 3)), np.zeros((5, 3)), np.zeros((4, 3)), np.zeros((4, 3)), radius_m=0.01)


@pytest.mark.parametrize(
    "knobs", [{"radius_m": 0.0}, {"radius_m": 0.01, "degree": 3}, {"radius_m": 0.01, "iterations": 0}]
)
def test_knobs_out_of_range_are_refused(knobs):
    four = np.zeros((4, 3))
    with pytest.raises(InvalidOption):
        project(four, four, four, four, **knobs)
