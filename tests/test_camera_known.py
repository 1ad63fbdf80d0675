"""Known answers for the camera: skewed intrinsics, depth jumps, what a sensor tears and loses, ends of the range."""

import os
from dataclasses import asdict

import numpy as np
import pytest
import trimesh

from gfp_grasp import camera
from gfp_grasp.camera import SensorModel, apply_sensor, opengl_probe
from gfp_grasp.errors import InvalidOption, InvalidView, TooFewPoints
from gfp_grasp.transforms import look_at, make_T, rotation_about
from gfp_grasp.types import DepthImage

WIDTH, HEIGHT = 120, 90
K_SKEW = np.array([[150.0, 7.0, 61.5], [0.0, 140.0, 40.25], [0.0, 0.0, 1.0]])
K = camera.intrinsics(WIDTH, HEIGHT, 35.0)


def _image(depth: np.ndarray, K: np.ndarray = K) -> DepthImage:
    return DepthImage(depth, K, np.eye(4))


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
    points = camera.camera_points(_image(depth, K_SKEW))
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
    normals = camera.surface_normals(_image(depth, K_SKEW))
    np.testing.assert_allclose(normals, np.broadcast_to([0.0, 0.0, -1.0], normals.shape), atol=1e-5)


def test_a_jump_is_a_depth_difference_of_more_than_what_is_allowed() -> None:
    depth = np.full((HEIGHT, WIDTH), 0.6)
    depth[:, WIDTH // 2 :] = 0.608
    image, edge = _image(depth), np.s_[5:-5, WIDTH // 2 - 1 : WIDTH // 2 + 1]
    assert (camera.surface_normals(image)[edge][..., 2] > -0.9).all()  # 8 mm: one surface, by default up to 1 cm
    assert (camera.surface_normals(image, max_jump_m=0.007)[edge][..., 2] < -0.999).all()


def test_a_pixel_without_neighbours_has_no_normal() -> None:
    depth = np.zeros((HEIGHT, WIDTH))
    depth[10, 10] = depth[30, 30] = depth[30, 31] = depth[31, 30] = 0.5
    normals = camera.surface_normals(_image(depth))
    assert np.isnan(normals[10, 10]).all()
    np.testing.assert_allclose(normals[30, 30], [0, 0, -1], atol=1e-6)
    assert np.isfinite(normals).all(axis=2).sum() == 1


def test_normals_of_a_slanted_plane_with_skew_are_exact() -> None:
    normal = np.array([0.3, -0.4, -np.sqrt(0.75)])
    rays = camera.pixel_rays(K_SKEW, WIDTH, HEIGHT)
    depth = (normal @ [0.02, 0.01, 0.7]) / (rays @ normal)
    normals = camera.surface_normals(_image(depth, K_SKEW))
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


# The sensor


def _step(near: float = 0.6, far: float = 0.9) -> np.ndarray:
    depth = np.full((HEIGHT, WIDTH), near)
    depth[:, WIDTH // 2 :] = far
    return depth


def _noisy(depth: np.ndarray, model: SensorModel, seed: int = 0) -> np.ndarray:
    return apply_sensor(_image(depth), model, np.random.default_rng(seed)).depth_m.astype(float)


def test_presets_are_those_that_the_committed_figures_were_measured_with() -> None:
    common = {"lost_angle_soft_deg": 3.0, "edge_m": 0.01}
    assert asdict(SensorModel.realsense()) == common | {
        "sigma_m": 0.0004, "sigma_per_m2": 0.0022, "sigma_grazing_m": 0.0006, "correlation_px": 1.2,
        "lost_angle_deg": 82.0, "hole_share": 0.005, "hole_radius_px": 3.0, "flying_share": 0.25,
        "edge_lost_share": 0.25, "step_m": 0.001, "nearest_m": 0.2, "farthest_m": 3.0,
    }  # fmt: skip
    assert asdict(SensorModel.kinect()) == common | {
        "sigma_m": 0.0008, "sigma_per_m2": 0.0019, "sigma_grazing_m": 0.0005, "correlation_px": 1.0,
        "lost_angle_deg": 78.0, "hole_share": 0.01, "hole_radius_px": 5.0, "flying_share": 0.1,
        "edge_lost_share": 0.4, "step_m": 0.002, "nearest_m": 0.4, "farthest_m": 4.0,
    }  # fmt: skip
    assert set(asdict(SensorModel()).items()) == {
        *((name, 0.0) for name in ("sigma_m", "sigma_per_m2", "sigma_grazing_m", "correlation_px", "hole_share")),
        *((name, 0.0) for name in ("flying_share", "edge_lost_share", "step_m", "nearest_m")),
        ("lost_angle_deg", 90.0), ("lost_angle_soft_deg", 3.0), ("hole_radius_px", 4.0), ("edge_m", 0.01),
        ("farthest_m", np.inf),
    }  # fmt: skip


def test_silhouettes_lose_the_share_that_was_asked_for_and_nothing_else_is_lost() -> None:
    lost = _noisy(_step(), SensorModel(edge_lost_share=0.3)) == 0
    edge = lost[:, WIDTH // 2 - 1 : WIDTH // 2 + 1]
    assert edge.mean() == pytest.approx(0.3, abs=0.1)
    assert lost.sum() == edge.sum()


def test_flying_pixels_are_spread_evenly_between_both_sides() -> None:
    noisy = _noisy(_step(), SensorModel(flying_share=1.0))
    flying = noisy[:, WIDTH // 2 - 1 : WIDTH // 2 + 1]
    assert np.quantile(flying, [0.02, 0.25, 0.5, 0.75, 0.98]) == pytest.approx([0.6, 0.675, 0.75, 0.825, 0.9], abs=0.04)


def test_a_step_is_a_silhouette_when_it_is_higher_than_the_edge() -> None:
    for height, torn in ((0.012, True), (0.008, False)):
        noisy = _noisy(_step(0.6, 0.6 + height), SensorModel(flying_share=1.0))
        assert (noisy != _step(0.6, 0.6 + height).astype(np.float32)).any() == torn


def test_flying_and_lost_pixels_share_the_silhouette() -> None:
    noisy = _noisy(_step(), SensorModel(flying_share=0.5, edge_lost_share=0.5))[:, WIDTH // 2 - 1 : WIDTH // 2 + 1]
    ideal = _step()[:, WIDTH // 2 - 1 : WIDTH // 2 + 1].astype(np.float32)
    assert (noisy != ideal).all()
    assert (noisy == 0).mean() == pytest.approx(0.5, abs=0.1)


def test_no_flying_pixel_appears_where_nothing_came_back() -> None:
    depth = _step()
    depth[:, WIDTH // 2 :] = 0.0
    noisy = _noisy(depth, SensorModel(flying_share=1.0, edge_m=0.01))
    assert (noisy[:, WIDTH // 2 :] == 0).all()
    assert (noisy[:, : WIDTH // 2] == np.float32(0.6)).all()


def test_noise_adds_up_from_its_three_parts() -> None:
    model = SensorModel(sigma_m=0.001, sigma_per_m2=0.002)
    error = _noisy(np.full((HEIGHT, WIDTH), 2.0), model) - 2.0
    assert error.std() == pytest.approx(0.001 + 0.002 * 4.0, rel=0.03)
    assert error.mean() == pytest.approx(0.0, abs=4e-4)


def test_noise_at_grazing_angles_is_that_of_eighty_five_degrees_at_most() -> None:
    rays = camera.pixel_rays(K, WIDTH, HEIGHT)
    normal = np.array([np.sin(np.radians(88.0)), 0.0, -np.cos(np.radians(88.0))])
    depth = (normal @ [0.0, 0.0, 0.6]) / (rays @ normal)
    middle = np.s_[:, WIDTH // 2 - 1 : WIDTH // 2 + 1]
    depth[depth <= 0] = 0.0
    model = SensorModel(sigma_grazing_m=1e-5, edge_m=10.0)
    noise = np.concatenate(
        [(_noisy(depth, model, seed) - depth.astype(np.float32))[middle].ravel() for seed in range(8)]
    )
    assert noise.std() == pytest.approx(1e-5 * (85.0 / 5.0) ** 2, rel=0.1)


def test_shared_noise_has_the_width_of_its_window_along_both_axes() -> None:
    noise = _noisy(np.full((HEIGHT, WIDTH), 0.6), SensorModel(sigma_m=0.001, correlation_px=2.0)) - 0.6
    assert noise.std() == pytest.approx(0.001, rel=0.1)
    for lag in (1, 3):
        expected = np.exp(-(lag**2) / (4 * 2.0**2))
        assert np.corrcoef(noise[lag:].ravel(), noise[:-lag].ravel())[0, 1] == pytest.approx(expected, abs=0.08)
        assert np.corrcoef(noise[:, lag:].ravel(), noise[:, :-lag].ravel())[0, 1] == pytest.approx(expected, abs=0.08)


def test_larger_holes_are_fewer_for_the_same_share() -> None:
    def num_edges(radius: float) -> float:
        lost = [
            _noisy(np.full((HEIGHT, WIDTH), 0.6), SensorModel(hole_share=0.1, hole_radius_px=radius), s) == 0
            for s in range(4)
        ]
        assert np.mean(lost) == pytest.approx(0.1, abs=0.04)
        return float(np.mean([(mask[:, 1:] != mask[:, :-1]).sum() for mask in lost]))

    assert num_edges(2.0) == pytest.approx(2 * num_edges(4.0), rel=0.4)


def test_the_transition_of_lost_returns_is_as_wide_as_asked() -> None:
    rays = camera.pixel_rays(K, WIDTH, HEIGHT)

    def kept(degrees: float, soft: float) -> float:
        normal = np.array([0.0, np.sin(np.radians(degrees)), -np.cos(np.radians(degrees))])
        depth = np.maximum((normal @ [0.0, 0.0, 0.6]) / (rays @ normal), 0.0)
        middle = np.s_[HEIGHT // 2 - 1 : HEIGHT // 2 + 1, WIDTH // 2 - 15 : WIDTH // 2 + 15]
        model = SensorModel(lost_angle_deg=60.0, lost_angle_soft_deg=soft, edge_m=1.0)
        return float(np.mean([(_noisy(depth, model, seed) > 0)[middle].mean() for seed in range(10)]))

    # Share that comes back: 1 / (1 + exp(4 (angle - 60) / soft)).
    assert kept(60.0, 3.0) == pytest.approx(0.5, abs=0.1)
    assert kept(61.0, 3.0) == pytest.approx(1 / (1 + np.exp(4 / 3)), abs=0.1)
    assert kept(61.0, 12.0) == pytest.approx(1 / (1 + np.exp(1 / 3)), abs=0.1)
    assert kept(59.0, 3.0) == pytest.approx(1 / (1 + np.exp(-4 / 3)), abs=0.1)


def test_the_ends_of_the_range_come_back() -> None:
    depth = np.full((HEIGHT, WIDTH), 0.5)
    depth[0, :4] = (0.25, 0.249, 1.5, 1.501)
    noisy = _noisy(depth, SensorModel(nearest_m=0.25, farthest_m=1.5))
    assert (noisy[0, :4] > 0).tolist() == [True, False, True, False]


@pytest.mark.parametrize(
    "nonsense",
    [
        {"flying_share": 1.1},
        {"edge_lost_share": 1.1},
        {"lost_angle_deg": 90.5},
        {"lost_angle_soft_deg": 0.0},
        {"edge_m": 0.0},
        {"nearest_m": 1.0, "farthest_m": 1.0},
        {"step_m": -0.001},
    ],
)
def test_nonsense_in_a_sensor_is_refused(nonsense: dict) -> None:
    with pytest.raises(InvalidOption):
        SensorModel(**nonsense)


def test_shares_up_to_one_and_angles_up_to_ninety_are_sense() -> None:
    SensorModel(hole_share=1.0, flying_share=1.0)
    SensorModel(flying_share=0.5, edge_lost_share=0.5, lost_angle_deg=90.0)


# Which OpenGL


@pytest.mark.parametrize(
    ("asked", "system", "candidates"),
    [
        (None, "Linux", ("egl", "osmesa")),
        (None, "Darwin", ("cgl",)),
        (None, "Windows", ("glfw",)),
        (" OSMesa ", "Linux", ("osmesa",)),
        ("egl", "Darwin", ("egl",)),
        ("glfw", "Linux", ("glfw",)),
        ("cgl", "Linux", ("cgl",)),
        ("off", "Linux", ()),
        ("disable", "Linux", ()),
        ("disabled", "Linux", ()),
        ("false", "Linux", ()),
        ("0", "Linux", ()),
    ],
)
def test_the_user_may_choose_the_opengl_that_is_tried(
    monkeypatch: pytest.MonkeyPatch, asked: str | None, system: str, candidates: tuple[str, ...]
) -> None:
    monkeypatch.delenv("GFP_GRASP_GL", raising=False)
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    if asked is not None:
        monkeypatch.setenv("MUJOCO_GL", asked)
    monkeypatch.setattr(opengl_probe.platform, "system", lambda: system)
    tried: list[str] = []
    monkeypatch.setattr(opengl_probe, "_works", lambda name: bool(tried.append(name)))
    assert opengl_probe.opengl_backend() == "none"
    assert tuple(tried) == candidates
    assert os.environ["GFP_GRASP_GL"] == "none"
    monkeypatch.delenv("GFP_GRASP_GL")


def test_the_first_opengl_that_works_is_kept_for_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GFP_GRASP_GL", "egl")
    monkeypatch.setattr(opengl_probe, "_works", lambda name: pytest.fail("asked again"))
    assert opengl_probe.opengl_backend() == "egl"
    monkeypatch.delenv("GFP_GRASP_GL")
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(opengl_probe.platform, "system", lambda: "Linux")
    monkeypatch.setattr(opengl_probe, "_works", lambda name: name == "osmesa")
    assert opengl_probe.opengl_backend() == "osmesa"
    assert os.environ["GFP_GRASP_GL"] == "osmesa"
    monkeypatch.delenv("GFP_GRASP_GL")


def test_the_probe_is_asked_in_a_child_that_finds_this_package(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict = {}

    def run(command: list[str], **options) -> object:
        asked.update(options, command=command)
        return type("Done", (), {"returncode": asked["code"], "stdout": asked["says"]})()

    monkeypatch.setattr(opengl_probe.subprocess, "run", run)
    for code, says, works in ((0, b"mujoco talks. works", True), (1, b"works", False), (0, b"wrong", False)):
        asked.update(code=code, says=says)
        assert opengl_probe._works("osmesa") == works
    assert asked["command"][-1] == "osmesa"
    assert asked["env"]["MUJOCO_GL"] == asked["env"]["GFP_GRASP_GL"] == "osmesa"
    assert asked["env"]["PYTHONPATH"].split(os.pathsep) == [place for place in opengl_probe.sys.path if place]
    assert asked["timeout"] == 30.0


def test_a_probe_that_hangs_or_cannot_start_does_not_work(monkeypatch: pytest.MonkeyPatch) -> None:
    for error in (OSError("no such file"), opengl_probe.subprocess.TimeoutExpired("probe", 30.0)):

        def fail(*_, error=error, **__) -> None:
            raise error

        monkeypatch.setattr(opengl_probe.subprocess, "run", fail)
        assert not opengl_probe._works("egl")
