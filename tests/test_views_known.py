"""Views of both forms: what projects where, what is behind, beside and beyond, and what moves with a view."""

import numpy as np
import pytest

from gfp_grasp.camera import mask_of_points
from gfp_grasp.errors import InvalidOption, InvalidView
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import LIDAR, TABLETOP, DepthImage, RangeImage, SensorProfile, get_sensor

K = np.array([[150.0, 7.0, 20.5], [0.0, 140.0, 11.25], [0.0, 0.0, 1.0]])
T = make_T(rotation_about((1.0, -2.0, 0.5), 2.3), (0.3, 0.1, 0.4))
DEPTH = np.random.default_rng(1).uniform(0.4, 0.9, (24, 32))
RINGS = np.radians([12.0, 8.0, 3.0, -1.0, -6.0])  # uneven, as those of real sensors are
RANGES = np.random.default_rng(2).uniform(5.0, 60.0, (5, 72))
VIEWS = (DepthImage(DEPTH, K, T), RangeImage(RANGES, RINGS, 0.4, T))


def test_a_skewed_pixel_is_where_its_matrix_says() -> None:
    view = DepthImage(DEPTH, K, np.eye(4))
    pixel, depth = view.project([0.2, -0.3, 2.0])
    np.testing.assert_allclose(pixel, [150 * 0.1 + 7 * -0.15 + 20.5, 140 * -0.15 + 11.25])
    assert depth == pytest.approx(2.0)
    np.testing.assert_allclose(view.unproject(pixel, 2.0), [0.2, -0.3, 2.0])


def test_what_is_behind_the_camera_has_no_pixel() -> None:
    pixels, depth = DepthImage(DEPTH, K, np.eye(4)).project([[0.0, 0.0, -1.0], [0.1, 0.1, 0.0], [0.0, 0.0, 1e-6]])
    assert np.isnan(pixels).all(axis=1).tolist() == [True, True, False]
    np.testing.assert_allclose(depth, [-1.0, 0.0, 1e-6])


def test_a_lidar_sees_forward_in_the_column_of_its_azimuth_and_turns_clockwise() -> None:
    view = RangeImage(np.ones((5, 8)), RINGS, 0.0, np.eye(4))
    angles = np.radians([0.0, -45.0, -90.0, 90.0, 44.0])  # counter-clockwise from x
    points = np.column_stack([np.cos(angles), np.sin(angles), np.full(5, np.tan(RINGS[2]))])
    pixels, distance = view.project(10.0 * points)
    np.testing.assert_allclose(pixels[:, 0], [0.0, 1.0, 2.0, 6.0, 8 * (360 - 44) / 360], atol=1e-9)
    np.testing.assert_allclose(pixels[:, 1], 2.0, atol=1e-9)
    np.testing.assert_allclose(distance, 10.0 / np.cos(RINGS[2]))
    started = RangeImage(np.ones((5, 8)), RINGS, np.radians(90.0), np.eye(4)).project([0.0, 3.0, 0.0])[0]
    np.testing.assert_allclose(started[0], 0.0, atol=1e-9)


def test_a_direction_between_the_last_and_the_first_column_belongs_to_the_nearer() -> None:
    view = RangeImage(np.ones((5, 8)), RINGS, 0.0, np.eye(4))
    near_first, near_last = np.radians(10.0), np.radians(35.0)  # columns are 45 degrees apart
    columns = [view.project([np.cos(a), np.sin(a), 0.0])[0][0] for a in (near_first, near_last)]
    np.testing.assert_allclose(columns, [-10 / 45, 8 - 35 / 45], atol=1e-9)


def test_a_direction_between_two_rings_lies_between_them_and_beyond_all_there_is_none() -> None:
    view = RangeImage(np.ones((5, 8)), RINGS, 0.0, np.eye(4))

    def row(degrees: float) -> float:
        angle = np.radians(degrees)
        return float(view.project([np.cos(angle), 0.0, np.sin(angle)])[0][1])

    assert row(8.0) == pytest.approx(1.0)
    assert row(5.0) == pytest.approx(1.6)  # three fifths of the way from 8 down to 3 degrees
    assert row(13.5) == pytest.approx(-0.375)
    assert row(-7.5) == pytest.approx(4.3)
    assert np.isnan([row(14.5), row(-9.0), row(60.0), row(-60.0)]).all()


@pytest.mark.parametrize("view", VIEWS)
def test_projecting_is_the_inverse_of_unprojecting(view: DepthImage | RangeImage) -> None:
    points = view.points()
    pixels, range_m = view.project(points)
    row, column = np.indices(view.shape)
    np.testing.assert_allclose(pixels[..., 0], column, atol=1e-6)
    np.testing.assert_allclose(pixels[..., 1], row, atol=1e-6)
    np.testing.assert_allclose(range_m, view.free_range_m, rtol=1e-6)
    between = np.array([[3.3, 1.6], [20.7, 2.2]])
    again, range_m = view.project(view.unproject(between, [0.7, 8.0]))
    np.testing.assert_allclose(again, between, atol=1e-9)
    np.testing.assert_allclose(range_m, [0.7, 8.0])


@pytest.mark.parametrize("view", VIEWS)
def test_a_moved_view_sees_the_moved_points_in_the_same_pixels(view: DepthImage | RangeImage) -> None:
    points = view.points()
    view.project(points)  # what is computed once must not be carried along
    move = make_T(rotation_about((0.3, 0.2, -1.0), 1.2), (-0.2, 0.5, 0.7))
    moved = view.moved(move)
    np.testing.assert_allclose(moved.points(), apply_T(move, points), atol=1e-9)
    np.testing.assert_allclose(moved.viewpoint, apply_T(move, view.viewpoint), atol=1e-12)
    np.testing.assert_allclose(moved.project(apply_T(move, points))[0], view.project(points)[0], atol=1e-6)
    np.testing.assert_array_equal(moved.free_range_m, view.free_range_m)
    np.testing.assert_array_equal(view.viewpoint, T[:3, 3])
    assert not moved.viewpoint.flags.writeable


@pytest.mark.parametrize("view", VIEWS)
def test_what_did_not_come_back_is_nan_and_frees_nothing(view: DepthImage | RangeImage) -> None:
    ranges = view.free_range_m.astype(float)
    ranges[1, 2:6] = (0.0, -1.0, np.nan, np.inf)
    holed = DepthImage(ranges, K, T) if isinstance(view, DepthImage) else RangeImage(ranges, RINGS, 0.4, T)
    assert (holed.free_range_m[1, 2:6] == 0).all()
    assert np.isnan(holed.points()[1, 2:6]).all()
    assert np.isnan(holed.points()).sum() == 12
    assert holed.free_range_m.dtype == np.float32


def test_the_step_is_the_finer_of_rows_and_columns() -> None:
    assert DepthImage(DEPTH, K, T).step_rad == pytest.approx(1 / 150)
    assert VIEWS[1].step_rad == pytest.approx(np.radians(4.0))
    assert RangeImage(np.ones((5, 360)), RINGS, 0.0, T).step_rad == pytest.approx(np.radians(1.0))
    assert RangeImage(np.ones((1, 36)), RINGS[:1], 0.0, T).step_rad == pytest.approx(np.radians(10.0))


def test_a_lidar_of_one_ring_sees_half_a_hundredth_above_and_below() -> None:
    view = RangeImage(np.ones((1, 36)), np.zeros(1), 0.0, np.eye(4))
    rows = [view.project([np.cos(a), 0.0, np.sin(a)])[0][1] for a in (0.0, 0.0049, -0.0049, 0.0051, -0.0051)]
    assert np.isnan(rows).tolist() == [False, False, False, True, True]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: DepthImage(1000 * DEPTH, K, T), "1000"),
        (lambda: DepthImage(DEPTH[0], K, T), "shape"),
        (lambda: DepthImage(np.zeros((0, 4)), K, T), "shape"),
        (lambda: DepthImage(DEPTH, K * [[-1], [1], [1]], T), "positive"),
        (lambda: DepthImage(DEPTH, np.diag([150.0, 0.0, 1.0]), T), "positive"),
        (lambda: DepthImage(DEPTH, K, T * 2), "rigid"),
        (lambda: DepthImage(DEPTH, K, np.diag([1.0, 1.0, -1.0, 1.0])), "rigid"),
        (lambda: RangeImage(RANGES, RINGS[::-1], 0.0, T), "highest down"),
        (lambda: RangeImage(RANGES, RINGS[:4], 0.0, T), "5 rings"),
        (lambda: RangeImage(20 * RANGES, RINGS, 0.0, T), "1000"),
        (lambda: RangeImage(RANGES, RINGS, 0.0, T * 2), "rigid"),
    ],
)
def test_what_is_no_view_is_refused(make, words: str) -> None:
    with pytest.raises(InvalidView, match=words):
        make()


def test_a_picture_of_forty_nine_metres_is_one_and_of_fifty_one_is_in_millimetres() -> None:
    assert DepthImage(np.full((2, 2), 49.0), K, T).depth_m.max() == 49.0
    with pytest.raises(InvalidView):
        DepthImage(np.full((2, 2), 51.0), K, T)
    assert RangeImage(np.full((5, 2), 499.0), RINGS, 0.0, T).range_m.max() == 499.0
    with pytest.raises(InvalidView):
        RangeImage(np.full((5, 2), 501.0), RINGS, 0.0, T)


@pytest.mark.parametrize("view", VIEWS)
def test_points_are_in_the_pixels_that_saw_them_at_their_range(view: DepthImage | RangeImage) -> None:
    points = view.points()[1:3, 4:9]
    toward = (view.viewpoint - points) / np.linalg.norm(view.viewpoint - points, axis=-1, keepdims=True)
    expected = np.zeros(view.shape, dtype=bool)
    expected[1:3, 4:9] = True
    for shift_m, mask in ((0.0, expected), (0.004, expected), (0.02, np.zeros(view.shape, dtype=bool))):
        found = mask_of_points((points + shift_m * toward).reshape(-1, 3), view, tolerance_m=0.006)
        np.testing.assert_array_equal(found, mask)
    behind = 2 * view.viewpoint - points.reshape(-1, 3)
    assert not mask_of_points(behind, view, tolerance_m=0.006).any()


def test_sensors_are_taken_by_name_and_profiles_as_they_are() -> None:
    assert get_sensor("tabletop") is TABLETOP
    assert get_sensor("lidar") is LIDAR
    assert get_sensor(LIDAR) is LIDAR
    for nonsense in ("sonar", None, 3):
        with pytest.raises(InvalidOption, match="tabletop, lidar"):
            get_sensor(nonsense)  # type: ignore[arg-type]


def test_a_sensor_believes_a_third_to_four_times_its_noise() -> None:
    assert TABLETOP.sigma_range_m == pytest.approx((0.0005, 0.006))


@pytest.mark.parametrize(
    "lengths", [(0.0, 9, 9, 2, 1), (2.0, 9, 9, 2, 1), (0.1, 0.0, 9, 2, 1), (0.1, 9, 1.5, 2, 1), (0.1, 9, 9, 1, 1)]
)
def test_a_sensor_whose_lengths_do_not_rise_is_refused(lengths: tuple[float, ...]) -> None:
    SensorProfile("fine", 0.1, 9.0, 2.0, 2.0, 1.0)
    with pytest.raises(InvalidOption):
        SensorProfile("none", *lengths)
