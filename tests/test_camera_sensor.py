"""The sensor model gives the statistics that it was asked for."""

import numpy as np
import pytest

from gfp_grasp.camera import SensorModel, apply_sensor, intrinsics, render_mesh_view
from gfp_grasp.errors import InvalidOption
from gfp_grasp.transforms import look_at
from gfp_grasp.types import DepthImage

WIDTH, HEIGHT = 240, 180
K = intrinsics(WIDTH, HEIGHT, 35.0)


def wall(depth_m):
    return DepthImage(np.full((HEIGHT, WIDTH), depth_m), K, np.eye(4))


def table(elevation_deg):
    angle = np.radians(elevation_deg)
    T = look_at((0.6 * np.cos(angle), 0, 0.6 * np.sin(angle)), (0, 0, 0))
    return render_mesh_view(
        [], T_world_camera=T, K=intrinsics(WIDTH, HEIGHT, 5.0), width=WIDTH, height=HEIGHT, table_height=0
    )[0]


def step():
    depth = np.full((HEIGHT, WIDTH), 0.6)
    depth[:, WIDTH // 2 :] = 0.9
    return DepthImage(depth, K, np.eye(4))


def errors(image, model, seed=0):
    noisy = apply_sensor(image, model, np.random.default_rng(seed)).depth_m.astype(float)
    return (noisy - image.depth_m)[noisy > 0]


def test_the_ideal_sensor_changes_nothing():
    image = step()
    assert (apply_sensor(image, SensorModel.ideal(), np.random.default_rng(0)).depth_m == image.depth_m).all()


def test_one_millimetre_of_noise_is_one_millimetre_at_any_depth_and_angle():
    for image in (wall(0.3), wall(2.0), table(20)):
        error = errors(image, SensorModel(sigma_m=0.001))
        assert error.std() == pytest.approx(0.001, rel=0.02)
        assert len(error) == image.depth_m.size
    assert SensorModel.gaussian(0.001) == SensorModel(sigma_m=0.001)


def test_noise_grows_with_depth_squared():
    model = SensorModel(sigma_per_m2=0.002)
    assert errors(wall(0.5), model).std() == pytest.approx(0.0005, rel=0.02)
    assert errors(wall(1.5), model).std() == pytest.approx(0.0045, rel=0.02)


def test_noise_grows_with_the_grazing_angle():
    model = SensorModel(sigma_grazing_m=0.001)
    assert errors(table(89), model).std() < 1e-5
    assert errors(table(45), model).std() == pytest.approx(0.001, rel=0.1)
    assert errors(table(30), model).std() == pytest.approx(0.004, rel=0.2)  # 60 degrees: (2 / 1)^2


def test_neighbours_share_noise_without_changing_its_size():
    image, model = wall(0.6), SensorModel(sigma_m=0.001, correlation_px=1.5)
    noise = apply_sensor(image, model, np.random.default_rng(0)).depth_m.astype(float) - 0.6
    assert noise.std() == pytest.approx(0.001, rel=0.05)
    shared = np.corrcoef(noise[:, :-1].ravel(), noise[:, 1:].ravel())[0, 1]
    assert shared == pytest.approx(np.exp(-1 / (4 * 1.5**2)), abs=0.03)  # of a Gaussian window with itself


def test_holes_take_the_share_that_was_asked_for_and_come_in_blobs():
    shares, alone = [], []
    for seed in range(8):
        lost = (
            apply_sensor(wall(0.6), SensorModel(hole_share=0.05, hole_radius_px=3), np.random.default_rng(seed)).depth_m
            == 0
        )
        shares.append(lost.mean())
        alone.append(lost[:, 1:][lost[:, :-1]].mean())
    assert np.mean(shares) == pytest.approx(0.05, rel=0.25)
    assert np.mean(alone) > 0.6


def test_returns_are_lost_at_steep_angles_only():
    model = SensorModel(lost_angle_deg=70)
    assert len(errors(table(60), model)) == WIDTH * HEIGHT
    assert len(errors(table(20), model)) / (WIDTH * HEIGHT) == pytest.approx(0.5, abs=0.15)
    assert len(errors(table(10), model)) < 0.01 * WIDTH * HEIGHT


def test_flying_pixels_lie_between_the_two_sides_of_a_silhouette_and_nowhere_else():
    image = step()
    noisy = apply_sensor(image, SensorModel(flying_share=0.5), np.random.default_rng(0)).depth_m
    changed = noisy != image.depth_m
    columns = np.nonzero(changed)[1]
    assert set(columns) <= {WIDTH // 2 - 1, WIDTH // 2}
    assert changed[:, WIDTH // 2 - 1 : WIDTH // 2 + 1].mean() == pytest.approx(0.5, abs=0.1)
    assert ((noisy[changed] >= 0.6) & (noisy[changed] <= 0.9)).all()


def test_a_steep_even_surface_is_no_silhouette():
    image = render_mesh_view(
        [], T_world_camera=look_at((0.6, 0, 0.12), (0, 0, 0)), K=K, width=WIDTH, height=HEIGHT, table_height=0
    )[0]
    near = (image.depth_m.min(axis=1) > 0) & (image.depth_m.max(axis=1) < 1.2)
    model = SensorModel(flying_share=1.0, edge_m=0.004)
    noisy = apply_sensor(image, model, np.random.default_rng(0)).depth_m
    assert np.diff(image.depth_m[near], axis=0).min() < -0.004
    assert (noisy[near] == image.depth_m[near]).all()


def test_depth_is_rounded_and_cut_to_the_range():
    depth = np.tile(np.linspace(0.1, 2.0, WIDTH), (HEIGHT, 1))
    model = SensorModel(step_m=0.001, nearest_m=0.3, farthest_m=1.5)
    noisy = apply_sensor(DepthImage(depth, K, np.eye(4)), model, np.random.default_rng(0)).depth_m.astype(float)
    assert np.abs(noisy / 0.001 - np.round(noisy / 0.001)).max() < 1e-3
    assert ((noisy > 0) == ((depth >= 0.3) & (depth <= 1.5))).all()


def test_the_same_seed_gives_the_same_picture_and_another_does_not():
    image, model = step(), SensorModel.realsense()
    first, again, other = (apply_sensor(image, model, np.random.default_rng(seed)).depth_m for seed in (7, 7, 8))
    assert (first == again).all()
    assert (first != other).any()


def test_presets_have_one_to_three_millimetres_at_desk_range():
    for model, depth in ((SensorModel.realsense(), 0.6), (SensorModel.kinect(), 0.8)):
        error = errors(wall(depth), model)
        assert 0.001 <= error.std() <= 0.003


@pytest.mark.parametrize(
    "nonsense",
    [
        {"sigma_m": -1},
        {"sigma_m": float("nan")},
        {"hole_share": 2},
        {"lost_angle_deg": 95},
        {"nearest_m": 3, "farthest_m": 1},
        {"flying_share": 0.7, "edge_lost_share": 0.7},
    ],
)
def test_nonsense_is_refused(nonsense):
    with pytest.raises(InvalidOption):
        SensorModel(**nonsense)
