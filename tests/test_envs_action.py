"""A grasp goes through the action space and back; what is no grasp or no action is refused."""

import numpy as np
import pytest

from gfp_grasp.envs import ActionCode
from gfp_grasp.envs.spaces import NUM_ACTION
from gfp_grasp.errors import InvalidAction, InvalidGrasp, InvalidOption
from gfp_grasp.transforms import make_T, random_rotation
from gfp_grasp.types import Grasp


@pytest.mark.parametrize("seed", range(50))
def test_any_grasp_comes_back_within_a_tenth_of_a_millimetre_and_degree(seed):
    rng = np.random.default_rng(seed)
    code = ActionCode()
    position = np.asarray(code.centre_m) + rng.uniform(-1, 1, 3) * code.half_m
    grasp = Grasp(make_T(random_rotation(rng), position), rng.uniform(0, code.max_width_m))
    action = code.encode(grasp)
    back = code.decode(action)
    assert action.dtype == np.float32
    assert np.abs(action).max() <= 1
    assert np.linalg.norm(back.T_world_gripper[:3, 3] - position) < 1e-6
    assert abs(back.width_m - grasp.width_m) < 1e-6
    cosine = (np.trace(back.T_world_gripper[:3, :3].T @ grasp.T_world_gripper[:3, :3]) - 1) / 2
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))) < 0.1


def test_every_vector_of_the_box_is_a_rigid_grasp():
    rng = np.random.default_rng(0)
    vectors = [rng.uniform(-1, 1, NUM_ACTION) for _ in range(100)] + [np.zeros(NUM_ACTION), np.ones(NUM_ACTION)]
    for vector in vectors:
        R = ActionCode().decode(vector.astype(np.float32)).T_world_gripper[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1.0)


def test_the_zero_action_comes_straight_down_at_the_centre():
    grasp = ActionCode().decode(np.zeros(NUM_ACTION))
    np.testing.assert_allclose(grasp.T_world_gripper[:3, 2], (0, 0, -1))
    np.testing.assert_allclose(grasp.T_world_gripper[:3, 3], ActionCode().centre_m)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (np.full(NUM_ACTION, np.nan), "not finite"),
        (np.zeros(3), "shape"),
        (np.full(NUM_ACTION, 2.0), "between -1 and 1"),
    ],
)
def test_what_is_not_an_action_is_refused(action, message):
    with pytest.raises(InvalidAction, match=message):
        ActionCode().decode(action)


def test_a_grasp_outside_of_the_workspace_is_refused():
    with pytest.raises(InvalidAction, match="workspace"):
        ActionCode().encode(Grasp(make_T(t=(5.0, 0, 0)), 0.05))


def test_an_empty_workspace_is_refused():
    with pytest.raises(InvalidOption, match="half_m"):
        ActionCode(half_m=(0.0, 0.1, 0.1))


def test_an_action_is_placed_within_the_workspace_axis_by_axis():
    code = ActionCode(centre_m=(0.1, -0.2, 0.3), half_m=(0.2, 0.3, 0.4), max_width_m=0.1)
    grasp = code.decode(np.array([0.5, -0.5, 0.25, 1, 0, 0, 0, 1, 0, 0.5]))
    np.testing.assert_allclose(grasp.T_world_gripper[:3, 3], (0.2, -0.35, 0.4))
    assert grasp.width_m == pytest.approx(0.075)
    np.testing.assert_allclose(
        grasp.T_world_gripper[:3, :3], np.column_stack([(0, 0, -1), (0, 1, 0), (1, 0, 0)]), atol=1e-12
    )
    assert code.decode(np.array([0.0] * 9 + [-1.0])).width_m == 0.0


def test_short_directions_are_taken_as_given_down_to_a_ten_thousandth():
    code = ActionCode()
    for length, taken in ((0.05, True), (1.1e-4, True), (0.9e-4, False)):
        action = np.zeros(10)
        action[3], action[8] = length, length
        T = code.decode(action).T_world_gripper
        np.testing.assert_allclose(T[:3, 2], (1, 0, 0) if taken else (0, 0, -1), atol=1e-12)
        np.testing.assert_allclose(T[:3, 1], (0, 0, 1) if taken else (0, -1, 0), atol=1e-12)


def test_a_closing_axis_is_made_square_to_the_approach_and_not_the_other_way():
    action = np.zeros(10)
    action[3:6], action[6:9] = (0.6, 0.0, -0.8), (0.5, 0.5, 0.0)
    T = ActionCode().decode(action).T_world_gripper
    np.testing.assert_allclose(T[:3, 2], (0.6, 0, -0.8))
    square = np.array([0.5, 0.5, 0]) - 0.3 * np.array([0.6, 0, -0.8])
    np.testing.assert_allclose(T[:3, 1], square / np.linalg.norm(square))
    action[6:9] = 0.3 * action[3:6]  # along the approach: any axis square to it
    T = ActionCode().decode(action).T_world_gripper
    np.testing.assert_allclose(T[:3, 2], (0.6, 0, -0.8))
    assert T[:3, 1] @ T[:3, 2] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("pose", [np.eye(3), np.full((4, 4), np.nan), "down", None])
def test_a_grasp_without_a_pose_is_refused_as_a_grasp(pose):
    with pytest.raises(InvalidGrasp, match="T_world_gripper"):
        Grasp(pose, 0.05)


@pytest.mark.parametrize("width_m", [-1e-6, np.inf, np.nan, "wide", None, (0.01, 0.02)])
def test_a_grasp_without_a_width_is_refused_as_a_grasp(width_m):
    with pytest.raises(InvalidGrasp, match="width_m"):
        Grasp(np.eye(4), width_m)
    assert Grasp(np.eye(4), 0).width_m == 0.0
