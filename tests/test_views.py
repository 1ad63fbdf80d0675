"""Views of pinhole cameras and of LiDARs: pixels, ranges, and the way back; silhouettes of both."""

import numpy as np
import pytest

from gfp_grasp.camera import cloud_of, mask_of_points
from gfp_grasp.errors import InvalidView
from gfp_grasp.level import make_level_view
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import (
    LIDAR,
    DepthImage,
    Detection,
    OrientedBox,
    PointCloud,
    RangeImage,
    SupportPlane,
    pixels_of,
)

T_WORLD_SENSOR = make_T(rotation_about((1.0, 2.0, 3.0), 0.7), (0.4, -0.7, 1.9))
RINGS = np.radians([10.0, 4.0, 0.0, -2.0, -10.0])  # not evenly apart
COLUMNS = 360


def _scan(range_m: np.ndarray | None = None) -> RangeImage:
    ranges = np.full((len(RINGS), COLUMNS), 20.0) if range_m is None else range_m
    return RangeImage(ranges, RINGS, np.radians(90.0), T_WORLD_SENSOR)


def _beam(elevation_deg: float, azimuth_deg: float, distance_m: float) -> np.ndarray:
    """(1, 3) m, world: a point in a direction of the sensor, azimuth counter-clockwise from its x."""
    e, a = np.radians([elevation_deg, azimuth_deg])
    local = distance_m * np.array([[np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)]])
    return apply_T(T_WORLD_SENSOR, local)


@pytest.mark.parametrize(
    ("elevation_deg", "azimuth_deg", "column", "row"),
    [
        (10.0, 90.0, 0.0, 0.0),
        (4.0, 80.0, 10.0, 1.0),  # columns run clockwise
        (-10.0, -90.0, 180.0, 4.0),
        (7.0, 45.5, 44.5, 0.5),  # halfway between two rings
        (-1.0, 90.3, -0.3, 2.5),  # a little before the first column
        (-6.0, 91.0, 359.0, 3.5),
        (12.0, 0.0, 90.0, -1 / 3),  # above the highest ring by a third of the distance to the next
    ],
)
def test_a_point_is_seen_by_the_ring_and_column_of_its_direction(elevation_deg, azimuth_deg, column, row):
    pixels, distance = _scan().project(_beam(elevation_deg, azimuth_deg, 12.5))
    assert pixels[0] == pytest.approx([column, row], abs=1e-9)
    assert distance == pytest.approx([12.5])
    np.testing.assert_allclose(_scan().unproject(pixels, distance), _beam(elevation_deg, azimuth_deg, 12.5), atol=1e-9)


@pytest.mark.parametrize("elevation_deg", [13.5, -14.5, 60.0, -90.0])
def test_what_is_above_or_below_all_rings_is_seen_by_no_pixel(elevation_deg):
    pixels, _ = _scan().project(_beam(elevation_deg, 30.0, 5.0))
    assert np.isnan(pixels).all()


def test_points_of_a_scan_lie_on_its_beams_and_missing_returns_are_none():
    ranges = np.full((len(RINGS), COLUMNS), 8.0)
    ranges[1, 10], ranges[2, 20], ranges[3, 30] = 0.0, np.nan, -1.0
    scan = _scan(ranges)
    points = scan.points()
    assert points.shape == (5, 360, 3)
    assert np.isnan(points).any(axis=2).sum() == 3
    np.testing.assert_allclose(points[4, 180], _beam(-10.0, -90.0, 8.0)[0], atol=1e-6)
    assert scan.free_range_m[1, 10] == 0.0
    cloud = cloud_of(scan)
    assert len(cloud.points) == 5 * 360 - 3
    assert cloud.viewpoint == pytest.approx(T_WORLD_SENSOR[:3, 3])


def test_a_moved_scan_sees_the_moved_points_in_the_same_pixels():
    T = make_T(rotation_about((3.0, -1.0, 2.0), -1.2), (5.0, 0.2, -3.0))
    points = np.concatenate([_beam(-3.0, 20.0, 7.0), _beam(8.0, 200.0, 30.0)])
    here, distance = _scan().project(points)
    there, moved_distance = _scan().moved(T).project(apply_T(T, points))
    np.testing.assert_allclose(there, here, atol=1e-9)
    np.testing.assert_allclose(moved_distance, distance)
    np.testing.assert_allclose(_scan().moved(T).viewpoint, apply_T(T, _scan().viewpoint))
    assert _scan().step_rad == pytest.approx(np.radians(1.0))


def test_a_moved_picture_projects_anew_and_skew_is_kept():
    K = np.array([[150.0, 7.0, 70.3], [0.0, 190.0, 55.6], [0.0, 0.0, 1.0]])
    image = DepthImage(np.full((120, 160), 2.0), K, T_WORLD_SENSOR)
    local = np.array([[0.2, -0.1, 1.6], [-0.3, 0.2, 0.9], [0.1, 0.1, -1.0]])
    pixels, depth = image.project(apply_T(T_WORLD_SENSOR, local))
    assert pixels[0] == pytest.approx([150 * 0.2 / 1.6 + 7 * -0.1 / 1.6 + 70.3, 190 * -0.1 / 1.6 + 55.6])
    assert np.isnan(pixels[2]).all()  # behind the camera
    assert depth == pytest.approx([1.6, 0.9, -1.0])
    np.testing.assert_allclose(image.unproject(pixels[:2], depth[:2]), apply_T(T_WORLD_SENSOR, local[:2]), atol=1e-12)
    T = make_T(rotation_about((0.0, 1.0, 0.2), 0.4), (1.0, 2.0, 3.0))
    again, _ = image.moved(T).project(apply_T(T @ T_WORLD_SENSOR, local[:2]))
    np.testing.assert_allclose(again, pixels[:2], atol=1e-9)
    np.testing.assert_array_equal(image.moved(T).depth_m, image.depth_m)
    assert image.step_rad == pytest.approx(1 / 190)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"elevation_rad": RINGS[::-1]}, "from the highest down"),
        ({"elevation_rad": RINGS[:3]}, r"shape \(3,\); one angle for each of 5 rings"),
        ({"range_m": np.full((5, 360), 8000.0)}, "median of 8000 and metres are expected"),
        ({"range_m": np.ones(7)}, r"shape \(7,\)"),
        ({"T_world_sensor": np.diag([2.0, 2, 2, 1])}, "no rigid motion"),
    ],
)
def test_a_range_image_that_makes_no_sense_is_refused(changes, message):
    given = {"range_m": np.ones((5, 360)), "elevation_rad": RINGS, "azimuth_rad": 0.0, "T_world_sensor": np.eye(4)}
    with pytest.raises(InvalidView, match=message):
        RangeImage(**{**given, **changes})


def test_pixels_of_points_are_those_that_round_to_a_pixel_of_the_view():
    points = np.concatenate([_beam(4.4, 80.4, 6.0), _beam(60.0, 0.0, 6.0), _beam(-1.1, 359.6, 9.0)])
    index, flat, _, range_m = pixels_of(points, _scan())
    assert index.tolist() == [0, 2]
    assert flat.tolist() == [1 * 360 + 10, 3 * 360 + 90]
    assert range_m == pytest.approx([6.0, 9.0])


def test_a_mask_is_the_pixels_that_saw_the_points_at_their_own_range():
    ranges = np.full((5, 360), 20.0)
    ranges[1, 10], ranges[4, 7] = 6.0, 0.0
    scan = _scan(ranges)
    points = np.concatenate([_beam(4.0, 80.0, 6.04), _beam(0.0, 80.0, 6.0), _beam(-10.0, 83.0, 0.01)])
    mask = mask_of_points(points, scan, tolerance_m=0.05)
    assert np.argwhere(mask).tolist() == [[1, 10]]
    assert not mask_of_points(points, scan, tolerance_m=0.03).any()


def _block_of_a_street() -> tuple[Detection, RangeImage, np.ndarray]:
    """A block of 4 x 1.8 x 1.5 m at 12 m, as a level scanner of 40 rings sees it from 1.7 m, with 1 cm of noise."""
    rings = np.radians(np.linspace(3.0, -20.0, 40))
    T = make_T(None, (0.0, 0.0, 1.7))
    empty = RangeImage(np.zeros((40, 1800)), rings, np.pi, T)
    rays = empty.unproject(np.stack(np.meshgrid(np.arange(1800), np.arange(40)), axis=-1), np.ones((40, 1800))) - (
        0.0,
        0.0,
        1.7,
    )
    low, high = np.array([10.0, 1.0, 0.0]), np.array([14.0, 2.8, 1.5])
    with np.errstate(divide="ignore", invalid="ignore"):
        near, far = ((side - (0.0, 0.0, 1.7)) / rays for side in (low, high))
        enter, leave = np.fmin(near, far).max(axis=-1), np.fmax(near, far).min(axis=-1)
        hits = (enter < leave) & (enter > 0)
        ground = np.where(rays[..., 2] < 0, -1.7 / rays[..., 2], np.inf)
    enter = enter + np.random.default_rng(0).normal(scale=0.01, size=enter.shape)
    ranges = np.where(hits, enter, np.where(ground < 100.0, ground, 0.0))
    scan = RangeImage(ranges, rings, np.pi, T)
    points = scan.points()[hits]
    detection = Detection(
        cloud=PointCloud(points, scan.viewpoint),
        up=np.array([0.0, 0.0, 1.0]),
        support=SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0),
        category="",
        scores={},
        box=OrientedBox(make_T(None, (low + high) / 2), high - low),
        view=scan,
        mask=hits,
        sensor_sigma_m=0.02,
        sensor=LIDAR,
    )
    return detection, scan, hits


def test_space_that_a_lidar_saw_free_pushes_back_what_stands_in_it():
    detection, scan, hits = _block_of_a_street()
    view = make_level_view(detection)
    assert hits.sum() > 800
    assert view.silhouette is not None
    assert view.silhouette.certain
    assert view.floor_m == 0.0
    assert view.floor_sigma_m == pytest.approx((0.0267, 0.0267), abs=1e-4)  # of 2 cm of noise
    to_level = np.linalg.inv(view.T_world_level)
    beside = np.array([10.0, 0.0, 0.3])  # ground is seen behind it
    behind = np.array([15.0, 2.9, 0.3])  # in the shadow of the block
    above = np.array([10.0, 2.0, 2.1])  # against the sky, of which nothing came back
    index, back = view.silhouette.free_space_violation(apply_T(to_level, np.array([beside, behind, above])))
    assert index.tolist() == [0]
    # The way back leads to the far edge of the block's side, (14, 1), at the same distance from the sensor.
    brought = apply_T(view.T_world_level, apply_T(to_level, beside) + back[0])
    assert brought[1] / brought[0] == pytest.approx(1 / 14, abs=0.006)
    assert np.linalg.norm(brought - scan.viewpoint) == pytest.approx(np.linalg.norm(beside - scan.viewpoint))


def test_points_of_a_level_view_are_the_same_whatever_frame_they_come_in():
    from gfp_grasp.level import move_detection

    detection, _, _ = _block_of_a_street()
    T = make_T(rotation_about((1.0, -2.0, 0.5), 0.9), (100.0, -50.0, 7.0))
    here, there = make_level_view(detection), make_level_view(move_detection(detection, T))
    np.testing.assert_allclose(there.points, here.points, atol=1e-9)
    np.testing.assert_allclose(there.normals, here.normals, atol=1e-6)
    np.testing.assert_allclose(there.T_world_level, T @ here.T_world_level, atol=1e-9)
    assert here.silhouette is not None
    assert there.silhouette is not None
    np.testing.assert_array_equal(there.silhouette.free_range_m, here.silhouette.free_range_m)
