"""The cubes that peers see an object in, and what they see in them."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import KDTree

from gfp_grasp.peers import (
    Cube,
    Seen,
    cell_middles,
    cube_of_box,
    cube_of_seen,
    network_class,
    seen_in,
    tidied,
    true_box,
)
from gfp_grasp.peers.seen import distance_to_points, empty_cells, fixed_number, occupied_cells
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import PointCloud

UP = np.array([0.0, 0.0, 1.0])
EYE = np.array([0.6, 0.0, 0.2])


def front_of_cylinder(radius_m: float = 0.04, height_m: float = 0.12) -> PointCloud:
    """Points on the side that faces +x."""
    angle, height = np.meshgrid(np.linspace(-np.pi / 2, np.pi / 2, 61), np.linspace(0, height_m, 40))
    circle = radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return PointCloud(np.concatenate([circle.reshape(-1, 2), height.reshape(-1, 1)], axis=1), EYE)


def front_of_ball(radius: float = 0.25) -> Seen:
    """The half of a ball around the origin that faces +x, in sides of a cube."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(6000, 3))
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    return Seen(points[points[:, 0] > radius**2 / 3.0], np.array([3.0, 0.0, 0.0]))


def test_the_cube_of_what_was_seen_stands_upright_faces_the_viewer_and_has_its_room_behind() -> None:
    cube = cube_of_seen(front_of_cylinder(), UP)
    assert cube.side_m == pytest.approx(1.5 * 0.12, rel=0.02)
    np.testing.assert_allclose(cube.T_world_cube[:3, :3], np.eye(3), atol=1e-9)
    inside = cube.inward(front_of_cylinder().points)
    np.testing.assert_allclose(inside[:, 1:].min(axis=0) + inside[:, 1:].max(axis=0), 0, atol=0.01)
    assert 0.5 - inside[:, 0].max() == pytest.approx(0.125 / 1.5, abs=0.005)
    assert cube.inward(np.array([[-0.04, 0.0, 0.06]]))[0, 0] > -0.5  # the side that nobody saw


def test_the_cube_moves_turns_and_grows_with_the_cloud() -> None:
    cloud, grown, T = front_of_cylinder(), 2.5, make_T(rotation_about(UP, 0.7), (0.3, -0.2, 0.1))
    moved = PointCloud(apply_T(T, grown * cloud.points), apply_T(T, grown * EYE[None])[0])
    here, there = (cube_of_seen(tidied(c), UP) for c in (cloud, moved))
    assert there.side_m == pytest.approx(grown * here.side_m, rel=1e-6)
    np.testing.assert_allclose(seen_in(there, moved).points, seen_in(here, cloud).points, atol=1e-6)


def test_what_goes_in_comes_out_where_it_was() -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    cube = Cube(make_T(rotation_about((1.0, 2.0, 0.5), 0.4), (1.0, 0.0, -2.0)), 0.3)
    np.testing.assert_allclose(cube.outward(cube.inward(points)), points, atol=1e-12)


def test_pixels_that_fly_off_an_edge_do_not_make_the_cube_larger() -> None:
    cloud = front_of_cylinder()
    streak = np.array([0.0, 0.04, 0.06]) + np.linspace(0.02, 0.4, 12)[:, None] * [-1.0, 0.02, 0.0]
    with_streak = PointCloud(np.concatenate([cloud.points, streak]), EYE)
    assert cube_of_seen(with_streak, UP).side_m >= cube_of_seen(cloud, UP).side_m
    kept = tidied(with_streak)
    assert KDTree(kept.points).query(streak)[0].min() > 0.01
    assert cube_of_seen(kept, UP).side_m == pytest.approx(cube_of_seen(cloud, UP).side_m, rel=0.02)


def test_the_true_box_lies_along_the_objects_own_axes_and_its_cube_holds_all_of_the_object() -> None:
    mesh = trimesh.creation.box((0.1, 0.06, 0.2))
    mesh.apply_translation((0.01, 0.0, 0.1))
    T = make_T(rotation_about((0.3, 1.0, 0.2), 1.1), (0.5, 0.5, 0.0))
    box = true_box(mesh, T)
    np.testing.assert_allclose(box.extents, (0.1, 0.06, 0.2))
    cube = cube_of_box(box)
    assert cube.side_m == pytest.approx(1.1 * 0.2)
    corners = cube.inward(apply_T(T, np.asarray(mesh.vertices)))
    np.testing.assert_allclose(np.abs(corners).max(axis=0), np.array([0.1, 0.06, 0.2]) / 0.4 / 1.1)


def test_a_fixed_number_of_points_is_taken_from_many_and_made_of_few() -> None:
    many = np.random.default_rng(0).uniform(-0.5, 0.5, (5000, 3))
    assert fixed_number(many, 1024).shape == (1024, 3)
    assert len(np.unique(fixed_number(many, 1024), axis=0)) == 1024
    few = fixed_number(many[:100], 1024)
    assert few.shape == (1024, 3)
    assert len(np.unique(few, axis=0)) == 100


def test_cells_are_occupied_where_points_lie_and_nowhere_else() -> None:
    points = np.array([[-0.49, -0.49, -0.49], [0.01, 0.26, -0.3], [0.7, 0.0, 0.0]])
    cells = occupied_cells(points, 4)
    assert sorted(map(tuple, np.argwhere(cells))) == [(0, 0, 0), (2, 3, 0)]


def test_distances_are_those_to_the_points_up_to_their_reach() -> None:
    points = front_of_ball().points
    distance = distance_to_points(points, 32, reach=3.0)
    exact = np.minimum(32 * KDTree(points).query(cell_middles(32))[0], 3.0).reshape(32, 32, 32)
    assert distance.max() == 3.0
    assert np.abs(distance - exact).mean() < 0.05
    assert np.abs(distance - exact).max() < 1.0  # the mean of a cell's points stands for them
    assert (distance_to_points(points + 5.0, 32, reach=3.0) == 3.0).all()


def test_cells_before_what_was_seen_are_empty_and_those_behind_and_beside_it_are_unknown() -> None:
    seen = front_of_ball()
    empty = empty_cells(seen, 32).ravel()
    middles = cell_middles(32)
    radius = np.linalg.norm(middles, axis=1)
    beside = np.linalg.norm(middles[:, 1:], axis=1)
    assert not empty[radius < 0.25 - 1 / 32].any()
    assert empty[(middles[:, 0] > 0.3) & (beside < 0.2)].all()
    assert not empty[(beside > 0.3)].any()
    assert not empty[(middles[:, 0] < 0.1) & (beside < 0.2)].any()


def test_nothing_is_known_to_be_empty_without_a_viewpoint() -> None:
    assert not empty_cells(Seen(front_of_ball().points, None), 32).any()


@pytest.mark.parametrize("name", ["3d-epn", "3d-sc", "scrg"])
def test_grids_of_the_mirror_image_are_mirror_images_of_the_grids(name: str) -> None:
    given, seen = network_class(name).given, front_of_ball()
    here, mirrored = given(seen), given(seen.mirrored())
    assert here.dtype == np.float32
    assert np.mean(np.abs(mirrored - here[:, :, ::-1]) > 0.3) < 2e-3  # pixels at the edge of the silhouette
    assert set(np.unique(given(front_of_ball()))) >= {0.0, 1.0} or name == "3d-epn"
