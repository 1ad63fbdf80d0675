"""Rigid motions, with generic axes: no pose here equals its own transpose."""

import numpy as np
import pytest

from gfp_grasp.transforms import (
    FLIP_YZ,
    apply_T,
    cross,
    invert_T,
    is_rotation,
    look_at,
    make_T,
    quat_wxyz,
    random_rotation,
    rotation_about,
    rotation_between,
)

AXIS = np.array([1.0, -2.0, 3.0])
R = rotation_about(AXIS, 0.7)
T = make_T(R, (0.3, -0.4, 0.5))


def test_rotation_about_follows_the_right_hand_whatever_the_length_of_the_axis():
    quarter = np.pi / 2
    assert rotation_about((0, 0, 2), quarter) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    assert rotation_about((0.01, 0, 0), quarter) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert np.linalg.norm(R @ AXIS - AXIS) < 1e-12
    assert np.trace(R) == pytest.approx(1 + 2 * np.cos(0.7))
    assert rotation_about(5 * AXIS, 0.7) == pytest.approx(R)


def test_a_transform_turns_and_then_moves():
    assert apply_T(T, (1, 2, 3)) == pytest.approx(R @ [1, 2, 3] + [0.3, -0.4, 0.5])
    many = np.random.default_rng(0).normal(size=(4, 5, 3))
    assert apply_T(T, many)[2, 3] == pytest.approx(R @ many[2, 3] + [0.3, -0.4, 0.5])
    assert make_T() == pytest.approx(np.eye(4))
    assert make_T(R)[:3, 3] == pytest.approx([0, 0, 0])
    assert make_T(None, (1, 2, 3))[:3, :3] == pytest.approx(np.eye(3))


def test_the_inverse_undoes_a_transform():
    assert invert_T(T) @ T == pytest.approx(np.eye(4))
    assert invert_T(T) == pytest.approx(np.linalg.inv(T))


def test_rotation_between_is_the_smallest_that_turns_one_direction_onto_another():
    a, b = np.array([1.0, 2.0, -0.5]), np.array([-3.0, 0.1, 2.0])
    found = rotation_between(a, b)
    assert is_rotation(found)
    assert found @ a / np.linalg.norm(a) == pytest.approx(b / np.linalg.norm(b))
    angle = np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))
    assert np.trace(found) == pytest.approx(1 + 2 * np.cos(angle))
    assert rotation_between(a, 3 * a) == pytest.approx(np.eye(3))


@pytest.mark.parametrize("a", [(1, 2, 3), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, -2)])
def test_rotation_between_opposite_directions_is_half_a_turn(a):
    found = rotation_between(a, -np.asarray(a))
    assert is_rotation(found)
    assert found @ a == pytest.approx(-np.asarray(a, dtype=float))
    assert np.trace(found) == pytest.approx(-1.0)


def test_a_camera_looks_along_z_with_y_down():
    T_world_camera = look_at((1.0, 2.0, 1.5), (0.2, -0.3, 0.4))
    x, y, z = T_world_camera[:3, :3].T
    assert is_rotation(T_world_camera[:3, :3])
    assert T_world_camera[:3, 3] == pytest.approx([1.0, 2.0, 1.5])
    assert z == pytest.approx(np.array([-0.8, -2.3, -1.1]) / np.linalg.norm([0.8, 2.3, 1.1]))
    assert x[2] == pytest.approx(0, abs=1e-12)
    assert y[2] < 0
    tilted = look_at((1.0, 2.0, 1.5), (0.2, -0.3, 0.4), up=(1.0, 0.2, 0.0))
    assert tilted[:3, 0] @ [1.0, 0.2, 0.0] == pytest.approx(0, abs=1e-12)
    assert tilted[:3, 1] @ [1.0, 0.2, 0.0] < 0


@pytest.mark.parametrize("direction", [(0, 0, 1), (0, 0, -1)])
def test_a_camera_that_looks_along_up_is_a_rotation_all_the_same(direction):
    T_world_camera = look_at((0.1, 0.2, 0.3), np.array([0.1, 0.2, 0.3]) + direction)
    assert is_rotation(T_world_camera[:3, :3])
    assert T_world_camera[:3, 2] == pytest.approx(direction)


def test_scale_shear_mirror_and_rounding_are_told_apart():
    assert is_rotation(R)
    assert is_rotation(np.round(R, 4))
    assert not is_rotation(1.01 * R)
    assert not is_rotation(FLIP_YZ[:3, :3] @ np.diag([1, 1, -1]) @ R)
    assert not is_rotation(R + np.array([[0, 0.01, 0], [0, 0, 0], [0, 0, 0]]))
    assert is_rotation(FLIP_YZ[:3, :3])


def test_quaternions_have_the_scalar_first():
    wanted = np.concatenate([[np.cos(0.35)], np.sin(0.35) * AXIS / np.linalg.norm(AXIS)])
    assert quat_wxyz(R) * np.sign(quat_wxyz(R)[0]) == pytest.approx(wanted)


def test_random_rotations_come_from_their_generator_and_differ():
    first = random_rotation(np.random.default_rng(3))
    assert is_rotation(first)
    assert random_rotation(np.random.default_rng(3)) == pytest.approx(first)
    rng = np.random.default_rng(0)
    mean = np.mean([random_rotation(rng) for _ in range(2000)], axis=0)
    assert np.abs(mean).max() < 0.06  # uniform: no direction is preferred


def test_cross_products_follow_the_right_hand_over_any_number_of_axes():
    assert cross(np.array([2.0, 3.0, 5.0]), np.array([7.0, 11.0, 13.0])) == pytest.approx([-16.0, 9.0, 1.0])
    rng = np.random.default_rng(1)
    for shapes in (((4, 5, 3), (4, 5, 3)), ((4, 1, 3), (5, 3)), ((3,), (2, 3))):
        a, b = (rng.normal(size=shape) for shape in shapes)
        np.testing.assert_allclose(cross(a, b), np.cross(a, b), atol=1e-15)
    single = np.ones(3, np.float32)
    assert cross(single, single).dtype == np.float32
    assert cross(single, np.ones(3)).dtype == np.float64
