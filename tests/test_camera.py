"""Pinhole geometry, ideal depth of known bodies, organised points."""

import numpy as np
import pytest
import real_data
import trimesh
from scipy.spatial.transform import Rotation

from gfp_grasp import camera
from gfp_grasp.errors import InvalidMesh, InvalidOption, InvalidView, TooFewPoints
from gfp_grasp.transforms import apply_T, look_at, make_T
from gfp_grasp.types import DepthImage

WIDTH, HEIGHT = 160, 120
K = camera.intrinsics(WIDTH, HEIGHT, 35.0)
DOWN = look_at((0.0, 0.0, 0.6), (0.0, 0.0, 0.0))


def view(meshes, T=DOWN, K=K, **options):
    return camera.render_mesh_view(meshes, T_world_camera=T, K=K, width=WIDTH, height=HEIGHT, **options)


def cup(radius=0.04, height=0.1, wall=0.003):
    outer = trimesh.creation.cylinder(radius=radius, height=height, sections=64)
    inner = trimesh.creation.cylinder(radius=radius - wall, height=height, sections=64)
    inner.apply_translation([0, 0, wall])
    both = trimesh.boolean.difference([outer, inner])
    both.apply_translation([0, 0, height / 2])
    return both


def test_intrinsics_see_their_field_from_edge_to_edge():
    top, bottom = ((row - K[1, 2]) / K[1, 1] for row in (-0.5, HEIGHT - 0.5))
    assert np.degrees(np.arctan(bottom) - np.arctan(top)) == pytest.approx(35.0, abs=1e-9)
    assert K[0, 0] == K[1, 1]
    with pytest.raises(InvalidOption, match="field"):
        camera.intrinsics(10, 10, 180.0)


def test_depth_of_a_box_from_above_is_the_distance_to_its_top():
    image, index = view([trimesh.creation.box((0.1, 0.2, 0.08))])
    assert np.abs(image.depth_m[index == 0] - 0.56).max() < 1e-6
    half_u, half_v = 0.05 * K[0, 0] / 0.56, 0.1 * K[1, 1] / 0.56  # look_at puts some world axis along each picture axis
    across = sorted([2 * half_u, 2 * half_v])
    seen = sorted([np.ptp(np.nonzero(index == 0)[1]) + 1, np.ptp(np.nonzero(index == 0)[0]) + 1])
    assert np.abs(np.subtract(seen, across)).max() <= 1.0


def test_depth_of_a_sphere_is_that_of_its_equation():
    radius, K_odd = 0.05, K + np.array([[20.0, 0, 13.3], [0, 0, -7.7], [0, 0, 0]])
    ball = trimesh.creation.icosphere(subdivisions=6, radius=radius)
    image, index = view([ball], K=K_odd)
    rays = camera.pixel_rays(K_odd, WIDTH, HEIGHT)
    a, b, c = (rays**2).sum(-1), -2 * rays[..., 2] * 0.6, 0.6**2 - radius**2
    square = b**2 - 4 * a * c
    inside = square > 0.05 * square.max()
    truth = (-b - np.sqrt(np.where(inside, square, 0))) / (2 * a)
    assert (index[inside] == 0).all()
    assert np.abs(image.depth_m - truth)[inside].max() < 3e-5  # the facets' sagitta at this subdivision is 1.6e-5 m


def test_backprojected_points_project_into_their_own_pixels():
    rng = np.random.default_rng(0)
    T = camera.sample_viewpoint(rng)
    image, _ = view([cup()], T, table_height=0.0)
    pixels, depth = image.project(image.points())
    v, u = np.nonzero(image.depth_m > 0)
    assert np.abs(pixels[v, u] - np.column_stack([u, v])).max() < 1e-9
    assert np.abs(depth[v, u] - image.depth_m[v, u]).max() < 1e-9


def test_cloud_has_the_camera_as_viewpoint_and_only_the_masked_pixels():
    image, index = view([cup()], table_height=0.0)
    cloud = camera.cloud_of(image, index == 0)
    assert len(cloud.points) == (index == 0).sum()
    assert cloud.points[:, 2].min() > 0.0029
    assert cloud.viewpoint == pytest.approx(DOWN[:3, 3])
    with pytest.raises(InvalidView, match="mask"):
        camera.cloud_of(image, np.ones((3, 3)))


def test_a_cup_is_seen_as_hollow_from_above():
    image, index = view([cup(height=0.1, wall=0.003)], table_height=0.0)
    centre = image.depth_m[HEIGHT // 2, WIDTH // 2]
    assert centre == pytest.approx(0.6 - 0.003, abs=1e-6)
    assert image.depth_m[index == 0].min() == pytest.approx(0.5, abs=1e-6)


def test_the_table_is_a_plane_at_its_height_under_any_camera():
    rng = np.random.default_rng(1)
    for height in (0.0, 0.37, -0.2):
        T = camera.sample_viewpoint(rng, target=(0.1, 0.2, height))
        image, index = view([], T, table_height=height)
        points = image.points()[index == 0]
        assert len(points) > 1000
        assert np.abs(points[:, 2] - height).max() < 1e-6


def test_depth_moves_with_the_world():
    T_move = make_T(Rotation.from_euler("xyz", [0.3, -0.5, 1.1]).as_matrix(), [0.4, -0.2, 0.9])
    body, T = cup(), look_at((0.3, 0.2, 0.4), (0, 0, 0.05))
    moved = body.copy()
    moved.apply_transform(T_move)
    before, index = view([body], T)
    after, index_after = view([moved], T_move @ T)
    both = (index == 0) & (index_after == 0)
    assert (index != index_after).sum() < 10
    close = np.abs(before.depth_m - after.depth_m)[both] < 1e-6
    assert close.mean() > 0.995  # silhouettes may fall to either side


def test_meshes_that_would_crash_embree_are_refused():
    broken = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], process=False)
    with pytest.raises(InvalidMesh, match="not finite"):
        view([broken])
    broken = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 7]], process=False)
    with pytest.raises(InvalidMesh, match="index"):
        view([broken])


def test_an_empty_mesh_keeps_the_numbers_of_those_after_it():
    _, index = view([trimesh.Trimesh(), trimesh.creation.box((0.1, 0.1, 0.1))], table_height=-0.05)
    assert set(np.unique(index)) == {1, 2}


def test_rays_that_miss_everything_come_back_infinite():
    box = trimesh.creation.box((1, 1, 1))
    distance, triangle, soup = camera.cast_rays(
        [(box.vertices, box.faces)], np.array([0, 0, 5.0]), np.array([[0, 0, -1.0], [0, 0, 1]])
    )
    assert distance.tolist() == [4.5, np.inf]
    assert soup.tolist() == [0, -1]
    assert box.face_normals[triangle[0]] == pytest.approx([0, 0, 1])
    assert triangle[1] == -1


def test_normals_of_a_plane_are_its_own():
    T = look_at((0.3, -0.2, 0.5), (0, 0, 0))
    image, _ = view([], T, table_height=0.0)
    normals = camera.surface_normals(image)
    assert np.isfinite(normals).all()
    assert np.abs(normals @ T[:3, :3].T - [0, 0, 1]).max() < 1e-3  # depth is float32: 3e-8 over steps of 1 mm


def test_viewpoints_keep_to_their_elevation_and_distance():
    rng = np.random.default_rng(2)
    target = np.array([0.1, -0.3, 0.2])
    for _ in range(50):
        T = camera.sample_viewpoint(rng, elevation_deg=(20, 60), distance_m=0.6, target=target)
        away = T[:3, 3] - target
        assert np.linalg.norm(away) == pytest.approx(0.6)
        assert 20 <= np.degrees(np.arcsin(away[2] / 0.6)) <= 60
        assert T[:3, 2] == pytest.approx(-away / 0.6)
    with pytest.raises(InvalidOption, match="elevation"):
        camera.sample_viewpoint(rng, elevation_deg=(60, 20))


def test_organised_points_give_back_the_camera_that_saw_them():
    odd = K + np.array([[8.0, 0, 5.5], [0, -3.0, -4.25], [0, 0, 0]])
    image, _ = view([cup()], look_at((0.3, 0.2, 0.4), (0, 0, 0.05)), K=odd, table_height=0.0)
    points = camera.camera_points(image)
    again = camera.view_from_points(points, T_world_camera=image.T_world_camera)
    assert np.abs(again.K - odd).max() < 1e-3
    assert np.nanmax(np.abs(again.points() - apply_T(image.T_world_camera, points))) < 1e-6


def test_organised_points_of_another_layout_are_refused():
    image, _ = view([cup()], look_at((0.3, 0.2, 0.4), (0, 0, 0.05)), table_height=0.0)
    points = camera.camera_points(image)
    with pytest.raises(InvalidView, match="no pinhole camera"):
        camera.view_from_points(points * [1, -1, 1])  # y up
    with pytest.raises(InvalidView, match="no pinhole camera"):
        camera.view_from_points(np.random.default_rng(0).permutation(points.reshape(-1, 3)).reshape(points.shape))
    with pytest.raises(InvalidView, match="shape"):
        camera.view_from_points(points.reshape(-1, 3))
    with pytest.raises(TooFewPoints):
        camera.view_from_points(np.full((40, 40, 3), np.nan))


def test_real_kinect_captures_come_in_as_organised_points():
    for file in sorted((real_data.folder() / "captures").glob("table_*.npz")):
        points = np.load(file)["points_cam"]
        image = camera.view_from_points(points)
        assert image.K[0, 0] == pytest.approx(525.0, abs=0.1), file.name
        assert np.nanmax(np.abs(image.points() - points)) < 1e-5


def test_depth_images_of_real_captures_hold_their_segmented_points():
    for name in ("mug_red", "bottle_mustard", "bowl_green"):
        capture = np.load(real_data.folder() / "captures" / f"{name}.npz")
        image = DepthImage(capture["depth_m"], capture["K"], np.eye(4))
        pixels, depth = image.project(capture["object_points_cam"])
        u, v = np.round(pixels).astype(int).T
        assert np.median(np.abs(image.depth_m[v, u] - depth)) < 2e-3
