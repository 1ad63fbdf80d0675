"""Known answers for the geometry of a camera: skewed intrinsics, depth jumps, organised points, rays, viewpoints."""

import numpy as np
import pytest
import trimesh
from depth_pictures import HEIGHT, WIDTH, K, image_of

from gfp_grasp import camera
from gfp_grasp.errors import InvalidOption, InvalidView, TooFewPoints
from gfp_grasp.transforms import look_at, make_T, rotation_about
from gfp_grasp.types import DepthImage

K_SKEW = np.array([[150.0, 7.0, 61.5], [0.0, 140.0, 40.25], [0.0, 0.0, 1.0]])


def test_intrinsics_are_square_pixels_around_the_middle() -> None:
    np.testing.assert_allclose(camera.intrinsics(8, 6, 90.0), [[3, 0, 3.5], [0, 3, 2.5], [0, 0, 1]], atol=1e-12)
    for width, height, field in ((0, 5, 30.0), (5, 0, 30.0), (5, 5, 0.0), (5, 5, 180.0)):
        with pytest.raises(InvalidOption, match="field"):
            camera.intrinsics(width, height, field)
    assert camera.intrinsics(1, 1, 179.0).shape == (3, 3)


def test_rays_of_a_skewed_camera_project_back_into_their_pixels() -> None:
    rays = camera.pixel_rays(K_SKEW, WIDTH, HEIGHT)
    assert rays.shape == (HEIGHT, WIDTH, 3)
    pixels = (3.0 * rays) @ K_SKEW.T
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    np.testing.assert_allclose(pixels[..., 0] / pixels[..., 2], u, atol=1e-9)
    np.testing.assert_allclose(pixels[..., 1] / pixels[..., 2], v, atol=1e-9)
    np.testing.assert_array_equal(rays[..., 2], 1.0)


def test_camera_points_are_depth_along_the_rays_and_nan_where_nothing_came_back() -> None:
    depth = np.random.default_rng(0).uniform(0.4, 0.9, (HEIGHT, WIDTH)).astype(np.float32)
    depth[3, 4] = 0.0
    points = camera.camera_points(image_of(depth, K_SKEW))
    assert np.isnan(points[3, 4]).all()
    assert np.isnan(points).sum() == 3
    seen = depth > 0
    np.testing.assert_allclose(points[..., 2][seen], depth[seen])
    rays = camera.pixel_rays(K_SKEW, WIDTH, HEIGHT)
    np.testing.assert_allclose(points[seen], (rays * depth[..., None].astype(float))[seen])


def test_normals_on_either_side_of_a_step_are_those_of_their_own_side() -> None:
    depth = np.full((HEIGHT, WIDTH), 0.6)
    depth[:, WIDTH // 2 :] = 0.65
    depth[: HEIGHT // 3] = 0.7
    normals = camera.surface_normals(image_of(depth, K_SKEW))
    np.testing.assert_allclose(normals, np.broadcast_to([0.0, 0.0, -1.0], normals.shape), atol=1e-5)


def test_a_jump_is_a_depth_difference_of_more_than_what_is_allowed() -> None:
    depth = np.full((HEIGHT, WIDTH), 0.6)
    depth[:, WIDTH // 2 :] = 0.608
    image, edge = image_of(depth), np.s_[5:-5, WIDTH // 2 - 1 : WIDTH // 2 + 1]
    assert (camera.surface_normals(image)[edge][..., 2] > -0.9).all()  # 8 mm: one surface, by default up to 1 cm
    assert (camera.surface_normals(image, max_jump_m=0.007)[edge][..., 2] < -0.999).all()


def test_a_pixel_without_neighbours_has_no_normal() -> None:
    depth = np.zeros((HEIGHT, WIDTH))
    depth[10, 10] = depth[30, 30] = depth[30, 31] = depth[31, 30] = 0.5
    normals = camera.surface_normals(image_of(depth))
    assert np.isnan(normals[10, 10]).all()
    np.testing.assert_allclose(normals[30, 30], [0, 0, -1], atol=1e-6)
    assert np.isfinite(normals).all(axis=2).sum() == 1


def test_normals_of_a_slanted_plane_with_skew_are_exact() -> None:
    normal = np.array([0.3, -0.4, -np.sqrt(0.75)])
    rays = camera.pixel_rays(K_SKEW, WIDTH, HEIGHT)
    depth = (normal @ [0.02, 0.01, 0.7]) / (rays @ normal)
    normals = camera.surface_normals(image_of(depth, K_SKEW))
    np.testing.assert_allclose(normals, np.broadcast_to(normal, normals.shape), atol=2e-3)  # depth is float32


def test_organised_points_come_with_the_pose_that_was_given() -> None:
    T = make_T(rotation_about((0.2, 1.0, 0.1), 0.7), (0.4, -0.1, 0.3))
    rays = camera.pixel_rays(K, WIDTH, HEIGHT)
    depth = np.random.default_rng(1).uniform(0.4, 0.9, (HEIGHT, WIDTH, 1))
    image = camera.view_from_points(rays * depth, T_world_camera=T)
    np.testing.assert_array_equal(image.T_world_camera, T)
    np.testing.assert_array_equal(camera.view_from_points(rays * depth).T_world_camera, np.eye(4))


def test_fifty_organised_points_fit_intrinsics_and_forty_nine_do_not() -> None:
    rays = camera.pixel_rays(K, WIDTH, HEIGHT)
    points = np.full((HEIGHT, WIDTH, 3), np.nan)
    points[20:27, 30:37] = 0.5 * rays[20:27, 30:37]
    with pytest.raises(TooFewPoints, match="49"):
        camera.view_from_points(points)
    points[40, 50] = 0.5 * rays[40, 50]
    np.testing.assert_allclose(camera.view_from_points(points).K, K, atol=1e-6)


def test_points_behind_the_camera_are_no_returns() -> None:
    points = 0.5 * camera.pixel_rays(K, WIDTH, HEIGHT)
    points[4, 5] *= -1.0
    image = camera.view_from_points(points)
    assert image.depth_m[4, 5] == 0.0
    assert (image.depth_m > 0).sum() == WIDTH * HEIGHT - 1


def test_a_line_of_organised_points_spans_too_little_and_a_warp_of_two_pixels_is_no_pinhole() -> None:
    rays = 0.5 * camera.pixel_rays(K, WIDTH, HEIGHT)
    line = np.full_like(rays, np.nan)
    line[:, 7:9] = rays[:, 7:9]
    with pytest.raises(TooFewPoints, match="columns"):
        camera.view_from_points(line)
    with pytest.raises(TooFewPoints, match="rows"):
        camera.view_from_points(np.where(np.arange(HEIGHT)[:, None, None] // 2 == 5, rays, np.nan))
    for pixels, fits in ((0.9, True), (1.8, False)):
        warp = pixels * np.sqrt(2) / K[0, 0] * 0.5 * np.sin(np.arange(WIDTH))[None, :]
        warped = rays + np.stack([np.broadcast_to(warp, rays.shape[:2]), 0 * rays[..., 0], 0 * rays[..., 0]], axis=-1)
        if fits:
            np.testing.assert_allclose(camera.view_from_points(warped).K, K, atol=1.0)
        else:
            with pytest.raises(InvalidView, match="no pinhole"):
                camera.view_from_points(warped)


def test_what_is_farther_than_the_limit_is_not_seen() -> None:
    near, far = trimesh.creation.box((0.2, 0.2, 0.1)), trimesh.creation.box((4.0, 4.0, 0.1))
    far.apply_translation([0, 0, -2.6])  # its top is 3.05 m below the camera, that of the near one 0.45 m
    T = look_at((0.0, 0.0, 0.5), (0.0, 0.0, 0.0))

    def view(**options) -> tuple[DepthImage, np.ndarray]:
        return camera.render_mesh_view([near, far], T_world_camera=T, K=K, width=WIDTH, height=HEIGHT, **options)

    image, index = view()
    assert set(np.unique(index)) == {-1, 0}  # the limit is 3 m along the optical axis
    image, index = view(farthest_m=3.1)
    assert set(np.unique(index)) == {0, 1}
    np.testing.assert_allclose(image.depth_m[index == 1], 3.05, atol=1e-5)
    image, index = view(farthest_m=0.4)
    assert set(np.unique(index)) == {-1}
    assert not image.depth_m.any()
    image, index = view(table_height=-0.3, farthest_m=3.1)
    assert set(np.unique(index)) == {0, 2}
    np.testing.assert_allclose(image.depth_m[index == 2], 0.8, atol=1e-6)


def test_two_meshes_are_told_apart_and_the_nearer_is_seen() -> None:
    low, high = trimesh.creation.box((0.3, 0.3, 0.02)), trimesh.creation.box((0.05, 0.06, 0.02))
    high.apply_translation([0.05, 0.02, 0.1])
    T = look_at((0.0, 0.0, 0.6), (0.0, 0.0, 0.0))
    image, index = camera.render_mesh_view([high, low], T_world_camera=T, K=K, width=WIDTH, height=HEIGHT)
    np.testing.assert_allclose(image.depth_m[index == 0], 0.49, atol=1e-6)
    np.testing.assert_allclose(image.depth_m[index == 1], 0.59, atol=1e-6)
    assert (index == 0).sum() == pytest.approx(0.05 * 0.06 * (K[0, 0] / 0.49) ** 2, rel=0.1)


def test_rays_keep_their_own_length_and_origin() -> None:
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    origins = np.array([[5.0, 0.3, 0.2], [0.1, -7.0, 0.2]])
    distance, _, mesh = camera.cast_rays(
        [(box.vertices, box.faces)], origins, np.array([[-2.0, 0.0, 0.0], [0.0, 0.5, 0.0]])
    )
    np.testing.assert_allclose(distance, [2.0, 12.0], rtol=1e-6)
    assert mesh.tolist() == [0, 0]
    nothing = camera.cast_rays([], origins, np.ones((2, 3)))
    assert [list(part) for part in nothing] == [[np.inf, np.inf], [-1, -1], [-1, -1]]


def test_a_viewpoint_may_be_straight_above_and_nowhere_impossible() -> None:
    rng = np.random.default_rng(0)
    T = camera.sample_viewpoint(rng, elevation_deg=(90.0, 90.0), distance_m=0.5)
    np.testing.assert_allclose(T[:3, 3], [0.0, 0.0, 0.55], atol=1e-12)
    T = camera.sample_viewpoint(rng, elevation_deg=(-90.0, -90.0), distance_m=0.5)
    np.testing.assert_allclose(T[:3, 3], [0.0, 0.0, -0.45], atol=1e-12)
    nonsenses: tuple[dict, ...] = ({"elevation_deg": (-91.0, 0.0)}, {"elevation_deg": (0.0, 91.0)}, {"distance_m": 0.0})
    for nonsense in nonsenses:
        with pytest.raises(InvalidOption, match="elevation"):
            camera.sample_viewpoint(rng, **nonsense)


def test_viewpoints_are_uniform_in_elevation_and_all_around() -> None:
    rng = np.random.default_rng(0)
    places = np.array([camera.sample_viewpoint(rng, target=(0, 0, 0))[:3, 3] for _ in range(400)])
    elevation = np.degrees(np.arcsin(places[:, 2] / 0.6))
    assert np.quantile(elevation, [0.0, 0.5, 1.0]) == pytest.approx([20.0, 40.0, 60.0], abs=4.0)
    azimuth = np.degrees(np.arctan2(places[:, 1], places[:, 0]))
    assert np.quantile(azimuth, [0.0, 0.25, 0.5, 0.75, 1.0]) == pytest.approx([-180, -90, 0, 90, 180], abs=20)
