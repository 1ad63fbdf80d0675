"""What a sensor adds and loses, to the number: silhouettes, noise, holes, grazing angles, ends of the range."""

from dataclasses import asdict

import numpy as np
import pytest
from depth_pictures import HEIGHT, WIDTH, K, image_of

from gfp_grasp import camera
from gfp_grasp.camera import SensorModel, apply_sensor
from gfp_grasp.errors import InvalidOption


def _step(near: float = 0.6, far: float = 0.9) -> np.ndarray:
    depth = np.full((HEIGHT, WIDTH), near)
    depth[:, WIDTH // 2 :] = far
    return depth


def _noisy(depth: np.ndarray, model: SensorModel, seed: int = 0) -> np.ndarray:
    return apply_sensor(image_of(depth), model, np.random.default_rng(seed)).depth_m.astype(float)


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
