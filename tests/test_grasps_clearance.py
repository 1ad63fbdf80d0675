"""What stands about a grasp: how near it is, how high the support lies below, and what hides the jaws."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from grasped_bodies import GRIPPER, UP, completion_of

from gfp_grasp.grasps import GraspConfig
from gfp_grasp.grasps.clearance import clearance_around, height_above, hidden_share
from gfp_grasp.grasps.contact import obstacle_of, surface_of
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import DepthImage, PointCloud, SupportPlane


def test_clearance_is_that_of_the_swept_boxes_in_any_pose():
    rng = np.random.default_rng(0)
    T = np.stack([make_T(rotation_about(rng.normal(size=3), 1.0 + k), rng.normal(size=3)) for k in range(5)])
    opening = np.linspace(0.0, 0.08, 5)
    local = rng.uniform(-0.15, 0.15, (40, 3))
    for one, width in zip(T, opening, strict=True):
        boxes = GRIPPER.solids(np.array([width]))[0]
        boxes[:, 0, 2] -= 0.07
        outside = np.maximum(boxes[:, 0] - local[:, None], local[:, None] - boxes[:, 1]).max(axis=2)
        found = clearance_around(one[None], np.array([width]), apply_T(one, local), gripper=GRIPPER, standoff_m=0.07)
        assert found[0] == pytest.approx(outside.min(), abs=1e-6)


def test_the_height_above_a_slanted_support_is_that_of_the_lowest_corner_of_the_whole_approach():
    normal = rotation_about((1, 2, 0), 0.3) @ UP
    support = SupportPlane(normal, 0.05)
    for turn in (0.4, 2.9):  # from above, and from below, where the approach begins lower than it ends
        T = make_T(rotation_about((2, 1, 0.3), turn), (0.1, 0.2, 0.6))
        corners = []
        for low, high in GRIPPER.solids(np.array([0.05]))[0]:
            picks = [np.where(mask, high, low) for mask in np.ndindex(2, 2, 2)]
            corners += [corner + shift for corner in picks for shift in ([0, 0, 0], [0, 0, -0.07])]
        known = (apply_T(T, corners) @ normal).min() - 0.05
        found = height_above(T[None], np.array([0.05]), support, gripper=GRIPPER, standoff_m=0.07)
        assert found[0] == pytest.approx(known, abs=1e-9)


def test_obstacles_are_the_surface_the_parts_with_their_corners_and_what_stands_about():
    mesh = trimesh.creation.box((0.04, 0.05, 0.1))
    mesh.apply_translation((0, 0, 0.05))
    part = trimesh.creation.icosphere(radius=0.01)
    part.apply_translation((0.2, 0, 0.1))
    eye = make_T(np.diag([1.0, -1.0, -1.0]), (0, 0, 1.0))  # looks straight down from 1 m
    K = np.array([[100.0, 0, 50], [0, 100, 50], [0, 0, 1]])
    depth = np.ones((100, 100), dtype=np.float32)  # the table
    depth[45:55, 45:55] = 0.9  # the object
    depth[45:55, 75:80] = 0.92  # a neighbour, about 25 cm away along x
    depth[45:55, 95:99] = 0.92  # another, about 43 cm away: out of reach
    depth[80:84, 45:55] = 0.995  # too low to tell from the table
    mask = np.zeros((100, 100), dtype=bool)
    mask[45:55, 45:55] = True
    view = DepthImage(depth, K, eye)
    support = SupportPlane(UP, 0.0)
    completion = completion_of(mesh, support=support, view=view, mask=mask, parts=(part,))
    config, rng = GraspConfig(num_points=200), np.random.default_rng(0)
    surface = surface_of(completion, config, rng)
    obstacle = obstacle_of(completion, surface, config, rng)
    rows = {tuple(row) for row in obstacle.round(9)}
    assert {tuple(row) for row in surface.points.round(9)} <= rows
    assert {tuple(row) for row in np.asarray(part.vertices).round(9)} <= rows
    on_part = np.abs(np.linalg.norm(obstacle - (0.2, 0, 0.1), axis=1) - 0.01) < 1e-3
    assert on_part.sum() == 100 + len(part.vertices)
    beside = obstacle[(np.abs(obstacle[:, 2] - 0.08) < 1e-6) & (obstacle[:, 0] > 0.22)]
    assert len(beside) == 50
    assert np.abs(beside[:, 0] - 0.25).max() < 0.05
    assert len(obstacle) == 200 + 100 + len(part.vertices) + 50
    alone = replace(completion, detection=replace(completion.detection, view=None, mask=None))
    assert len(obstacle_of(alone, surface, config, rng)) == len(obstacle) - 50
    unsupported = replace(completion, detection=replace(completion.detection, support=None))
    assert len(obstacle_of(unsupported, surface, config, rng)) == len(obstacle) - 50


def test_what_was_seen_and_not_completed_is_kept_clear_of_but_strays_are_not():
    mesh = trimesh.creation.box((0.04, 0.05, 0.1))
    rng = np.random.default_rng(2)
    clump = (0.05, 0.0, 0.01) + 0.002 * rng.uniform(-1, 1, (8, 3))
    fewer = (-0.05, 0.0, 0.01) + 0.002 * rng.uniform(-1, 1, (7, 3))
    near = (0.0, 0.028, 0.0) + 0.002 * rng.uniform(-1, 1, (20, 3))
    completion = completion_of(mesh)
    cloud = PointCloud(np.concatenate([near, clump, fewer]))
    completion = replace(completion, detection=replace(completion.detection, cloud=cloud))
    config = GraspConfig(num_points=2000)
    surface = surface_of(completion, config, rng)
    obstacle = obstacle_of(completion, surface, config, rng)
    off = obstacle[np.abs(obstacle[:, 0]) > 0.021]
    assert {tuple(row) for row in off.round(9)} == {tuple(row) for row in clump.round(9)}
    assert len(obstacle) == len(surface.points) + 8


def test_samples_of_parts_are_shared_out_by_area():
    mesh = trimesh.creation.box((0.04, 0.05, 0.1))
    small, large = trimesh.creation.icosphere(radius=0.01), trimesh.creation.icosphere(radius=0.03)
    small.apply_translation((1, 0, 0))
    large.apply_translation((-1, 0, 0))
    completion = completion_of(mesh, parts=(small, large))
    config, rng = GraspConfig(num_points=400), np.random.default_rng(0)
    x = obstacle_of(completion, surface_of(completion, config, rng), config, rng)[:, 0]
    corners = len(small.vertices)
    assert ((x > 0.5).sum() - corners, (x < -0.5).sum() - corners) == (21, 180)  # each rounded up


def test_the_hidden_share_counts_eight_places_in_each_box_of_the_jaws():
    """A plate hides exactly one jaw of two from a camera behind it."""
    plate = trimesh.creation.box((0.3, 0.001, 0.3))
    T = make_T(rotation_about((0, 0, 1), 0.3) @ rotation_about((1, 0, 0), 0.2), (0.4, 0.1, 0.0))
    plate.apply_transform(T)
    eye = apply_T(T, np.array([[0.01, 0.5, 0.02]]))[0]
    assert hidden_share(T[None], np.array([0.06]), plate, eye, GRIPPER)[0] == pytest.approx(0.5)
    both = make_T(T[:3, :3], apply_T(T, np.array([[0, -0.2, 0.0]]))[0])
    before = make_T(T[:3, :3], apply_T(T, np.array([[0, 0.2, 0.0]]))[0])
    shares = hidden_share(np.stack([both, before]), np.full(2, 0.06), plate, eye, GRIPPER)
    np.testing.assert_array_equal(shares, [1.0, 0.0])


def test_places_are_three_fifths_of_the_way_to_the_corners_of_the_boxes():
    """Two boxes a jaw, 20 mm wide along x: a plate that hides all beyond 5 mm, or beyond 7 mm, of a far camera."""
    opening, eye = np.array([0.06]), np.array([0.0, 1000.0, 0.0])
    for inner_m, share in ((0.005, 0.5), (0.007, 0.0)):
        plate = trimesh.creation.box(bounds=[[inner_m, 0.2, -0.3], [0.3, 0.201, 0.3]])
        assert hidden_share(np.eye(4)[None], opening, plate, eye, GRIPPER)[0] == pytest.approx(share)
