"""The road under a scan: flat, sloped and bent, with things on it and reflections below it."""

import numpy as np
import pytest

from gfp_grasp.camera import LidarModel
from gfp_grasp.detect import find_road
from gfp_grasp.errors import NothingDetected
from gfp_grasp.scenes import draw_street, scan_street
from gfp_grasp.transforms import apply_T, make_T, rotation_about

UP = np.array([0.0, 0.0, 1.0])
COARSE = LidarModel(elevation_deg=tuple(np.linspace(2, -24, 40).tolist()), columns=700, sigma_m=0.02)


@pytest.fixture(scope="module")
def street_points() -> np.ndarray:
    """(n, 3) m of a street on z = 0, seen from 1.73 m; a third of its points are on kerbs, houses and vehicles."""
    rng = np.random.default_rng(4)
    image, _ = scan_street(draw_street(rng, num_things=10), rng, lidar=COARSE)
    points = image.points().reshape(-1, 3)
    return points[np.isfinite(points).all(axis=1)]


def places(num: int = 200) -> np.ndarray:
    """(n, 3) m on the road's lanes, z = 0."""
    rng = np.random.default_rng(1)
    return np.column_stack([rng.uniform(-25, 25, num), rng.uniform(-1.5, 4.5, num), np.zeros(num)])


def test_a_level_road_is_where_it_is(street_points: np.ndarray):
    road = find_road(street_points, UP, viewpoint=np.array([0, 0, 1.73]))
    assert np.abs(road.heights(places())).max() < 0.06
    assert road.heights(places() + 1.3 * UP) == pytest.approx(1.3, abs=0.06)


@pytest.mark.parametrize("slope_deg", [-6.0, 8.0])
def test_a_slope_is_followed_and_its_plane_told(street_points: np.ndarray, slope_deg: float):
    T = make_T(rotation_about((0, 1, 0), np.deg2rad(slope_deg)), (3.0, -2.0, 0.5))
    road = find_road(apply_T(T, street_points), UP, viewpoint=apply_T(T, np.array([0, 0, 1.73])))
    assert np.abs(road.heights(apply_T(T, places()))).max() < 0.1
    support = road.support_at(apply_T(T, np.array([10.0, 1.0, 1.0])))
    np.testing.assert_allclose(support.normal, T[:3, 2], atol=0.01)
    assert support.distances(apply_T(T, np.array([[10.0, 1.0, 1.0]])))[0] == pytest.approx(1.0, abs=0.06)


def test_a_road_that_bends_up_is_followed(street_points: np.ndarray):
    """The start of a hill: 1 m up at 30 m, by the square of the distance ahead."""

    def bent(points: np.ndarray) -> np.ndarray:
        return points + np.outer((points[:, 0] / 30.0) ** 2, UP)

    road = find_road(bent(street_points), UP, viewpoint=np.array([0, 0, 1.73]))
    assert np.abs(road.heights(bent(places()))).max() < 0.12
    normal = road.support_at(np.array([15.0, 1.0, 1.0])).normal
    assert -normal[0] / normal[2] == pytest.approx(2 * 15.0 / 900.0, abs=0.012)


def test_reflections_below_the_road_do_not_move_it(street_points: np.ndarray):
    rng = np.random.default_rng(0)
    below = street_points[rng.integers(len(street_points), size=len(street_points) // 30)] - 1.5 * UP
    road = find_road(np.concatenate([street_points, below]), UP, viewpoint=np.array([0, 0, 1.73]))
    assert np.abs(road.heights(places())).max() < 0.08


def test_too_little_ground_is_refused():
    points = np.random.default_rng(0).normal(scale=0.3, size=(500, 3))
    with pytest.raises(NothingDetected, match="no road"):
        find_road(points, UP)
