"""The level view of a detection: floor, silhouette, points and normals have known values."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from toy_completions import toy_completion, toy_image

from gfp_grasp import level
from gfp_grasp.errors import TooFewPoints
from gfp_grasp.level import MIN_POINTS, guessed_silhouette, level_frame, make_level_view
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import LIDAR, Detection, LevelView, OrientedBox, PointCloud, SupportPlane, get_sensor

TABLETOP = get_sensor("tabletop")
UP = np.array([0.0, 0.0, 1.0])


def shell(num: int, **more: Any) -> Detection:
    """Points of a dome of 5 cm that stands on z = 0.01, seen from the front and above."""
    rng = np.random.default_rng(1)
    way = rng.normal(size=(num, 3))
    way[:, 2] = np.abs(way[:, 2])
    points = 0.05 * way / np.linalg.norm(way, axis=1, keepdims=True) + (0.2, 0.1, 0.01)
    own = toy_completion(**more).detection
    return replace(own, cloud=replace(own.cloud, points=points))


def test_a_view_stands_on_its_support_and_looks_at_the_viewer() -> None:
    support = SupportPlane(UP, 0.01)
    detection = shell(300, support=support, viewpoint=(0.2, 0.6, 0.5), sensor_sigma_m=0.0017)
    view = make_level_view(detection, seed=3)
    middle = detection.cloud.points.mean(axis=0)
    np.testing.assert_allclose(view.T_world_level[:3, 3], (*middle[:2], 0.01), atol=1e-12)
    np.testing.assert_allclose(view.T_world_level[:3, 2], UP, atol=1e-12)
    towards = np.array([0.2, 0.6]) - middle[:2]
    np.testing.assert_allclose(view.T_world_level[:2, 0], towards / np.linalg.norm(towards), atol=1e-12)
    np.testing.assert_allclose(
        np.sort(apply_T(view.T_world_level, view.cloud.points), axis=0), np.sort(detection.cloud.points, axis=0)
    )
    assert view.cloud.viewpoint is not None
    np.testing.assert_allclose(apply_T(view.T_world_level, view.cloud.viewpoint), (0.2, 0.6, 0.5))
    assert (view.floor_m, view.floor_seen, view.sigma_m, view.sensor) == (0.0, True, 0.0017, TABLETOP)
    assert view.floor_sigma_m == pytest.approx((0.002, 0.002))


def test_thousands_of_points_are_thinned_to_a_thousand_with_normals_and_to_four_hundred() -> None:
    view = make_level_view(shell(9000, viewpoint=(0.2, 0.6, 0.5)))
    assert 800 < len(view.dense_points) <= 1200
    assert 320 < len(view.points) <= 480
    middle = apply_T(invert_T(view.T_world_level), np.array([0.2, 0.1, 0.01]))
    out = view.dense_points - middle
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    assert np.median(np.abs(np.einsum("ij,ij->i", out, view.dense_normals))) > 0.99
    assert view.cloud.viewpoint is not None
    assert (np.einsum("ij,ij->i", view.cloud.viewpoint - view.points, view.normals) >= 0).all()


def test_where_no_support_was_seen_the_floor_is_as_much_below_the_points_as_the_view_is_steep() -> None:
    level = toy_completion(support=None, viewpoint=(1.0, 0.0, 0.05), num_points=400)
    steep = toy_completion(support=None, viewpoint=(0.0, 0.0, 1.0), num_points=400)
    blind = toy_completion(support=None, viewpoint=None, num_points=400)
    below = {}
    for name, made in (("level", level), ("steep", steep), ("blind", blind)):
        view = make_level_view(made.detection)
        lowest = np.quantile(view.cloud.points[:, 2], 0.001)
        below[name] = lowest - view.floor_m
        assert view.floor_sigma_m == pytest.approx((0.0015, 0.003))
        assert not view.floor_seen
    assert below["level"] == pytest.approx(0.0, abs=1e-5)
    assert below["steep"] == pytest.approx(8 / 3 * 0.0015, abs=1e-5)
    assert below["blind"] == 0.0
    under = toy_completion(support=None, viewpoint=(0.0, 0.0, -1.0), num_points=400)
    view = make_level_view(under.detection)
    assert view.floor_m == pytest.approx(np.quantile(view.cloud.points[:, 2], 0.001))


def test_a_seed_chooses_the_points_that_are_kept_of_very_many(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[int] = []
    order = level.order_points

    def ordered(points: np.ndarray, *, seed: int = 0) -> np.ndarray:
        seeds.append(seed)
        return order(points, seed=seed)

    monkeypatch.setattr("gfp_grasp.level.order_points", ordered)
    make_level_view(toy_completion().detection, seed=7)
    make_level_view(toy_completion().detection)
    assert (seeds[0], seeds[2]) == (7, 0)


def test_fewer_than_twenty_points_are_too_few() -> None:
    assert MIN_POINTS == 20
    make_level_view(toy_completion(num_points=20).detection)
    with pytest.raises(TooFewPoints, match="19 points, 20 are needed"):
        make_level_view(toy_completion(num_points=19).detection)


def test_a_mask_frees_what_lies_beside_it_up_to_the_returns_and_tells_the_way_to_the_object() -> None:
    image, mask = toy_image(0.45), np.zeros((24, 32), dtype=bool)
    mask[10:14, 12:20] = True
    view = make_level_view(toy_completion(view=image, mask=mask).detection)
    silhouette = view.silhouette
    assert silhouette is not None
    assert silhouette.certain
    assert silhouette.margin_m == pytest.approx(4 * 0.0015)
    np.testing.assert_array_equal(silhouette.free_range_m[mask], 0.0)
    np.testing.assert_allclose(silhouette.free_range_m[~mask], image.free_range_m[~mask])
    np.testing.assert_array_equal(silhouette.offset_px[:, 11, 15], (0, 0))
    np.testing.assert_array_equal(silhouette.offset_px[:, 2, 5], (8, 7))
    np.testing.assert_array_equal(silhouette.offset_px[:, 20, 25], (-7, -6))
    np.testing.assert_allclose(view.T_world_level @ silhouette.view.T_world_camera, image.T_world_camera, atol=1e-12)  # type: ignore[union-attr]
    empty = make_level_view(toy_completion(view=image, mask=np.zeros((24, 32), dtype=bool)).detection)
    assert empty.silhouette is not None
    assert not empty.silhouette.offset_px.any()


def test_without_a_mask_the_silhouette_is_guessed_and_without_a_viewpoint_there_is_none() -> None:
    assert make_level_view(toy_completion(viewpoint=None).detection).silhouette is None
    guessed = make_level_view(toy_completion(view=toy_image()).detection).silhouette
    assert guessed is not None
    assert not guessed.certain


def test_a_guessed_picture_has_pixels_of_the_points_spacing_and_a_border_of_60() -> None:
    x, y = np.meshgrid(np.arange(20) * 0.002, np.arange(10) * 0.002)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(200)])
    middle = points.mean(axis=0)
    made = guessed_silhouette(points, middle + np.array((0.0, 0.0, 0.5)), TABLETOP)
    focal = 0.5 / (1.5 * 0.002)  # a pixel is one and a half spacings wide
    K = made.view.K  # type: ignore[union-attr]
    assert K[0, 0] == K[1, 1] == pytest.approx(focal, rel=1e-5)
    spans = sorted(np.ceil(np.array([19, 9]) * 0.002 / 0.5 * focal) + 121)
    assert sorted(made.free_range_m.shape) == spans
    seen = made.free_range_m == 0
    assert np.isinf(made.free_range_m[~seen]).all()
    rows, columns = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    assert (rows[0], columns[0]) == (60, 60)
    assert seen[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].all()  # small holes are closed
    assert (made.certain, made.margin_m) == (False, pytest.approx(0.006))


def test_a_guessed_picture_of_dense_points_is_no_wider_than_250_pixels() -> None:
    x, y = np.meshgrid(np.linspace(0, 0.2, 900), [0.0, 0.0002])
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(1800)])
    made = guessed_silhouette(points, points.mean(axis=0) + np.array((0.0, 0.0, 0.5)), TABLETOP)
    assert max(made.free_range_m.shape) == 250 + 121


def test_large_holes_of_a_guessed_picture_stay_open() -> None:
    x, y = np.meshgrid(np.arange(30) * 0.002, np.arange(30) * 0.002)
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(900)])
    hole = np.linalg.norm(points[:, :2] - 0.029, axis=1) > 0.016
    made = guessed_silhouette(points[hole], np.array([0.029, 0.029, 0.5]), TABLETOP)
    seen = made.free_range_m == 0
    height, width = seen.shape
    assert not seen[height // 2, width // 2]


def test_x_of_a_level_frame_is_the_short_side_with_the_longer_tail_where_nothing_is_seen_from() -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(200, 3)) * (0.01, 0.05, 0.1)
    points[:8, 0] += 0.03  # the tail
    for turn in (0.0, 2.0):
        R = rotation_about(UP, turn)
        T = level_frame(points @ R.T, 2 * UP, None)
        np.testing.assert_allclose(T[:3, 2], UP, atol=1e-12)
        assert (R.T @ T[:3, 0])[0] > 0.98
    above = level_frame(points, UP, points.mean(axis=0) + np.array((0.0009, 0.0, 1.0)))  # as good as right above
    np.testing.assert_allclose(above, level_frame(points, UP, None))
    aside = level_frame(points, UP, points.mean(axis=0) + np.array((0.0, -0.0011, 1.0)))
    np.testing.assert_allclose(aside[:3, 0], (0.0, -1.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(make_T(aside[:3, :3], points.mean(axis=0)), aside)


def side_of_a_bus(distance_m: float, *, num_rings: int = 20) -> np.ndarray:
    """(n, 3) m, world: a wall 8 m long seen from 1.7 m up, as rings from the highest of a LiDAR down have it."""
    assert LIDAR.highest_rad is not None
    elevation = LIDAR.highest_rad - LIDAR.step_rad * np.arange(num_rings)
    y = np.linspace(-4.0, 4.0, 60)
    return np.array([(distance_m, place, 1.7 + distance_m * np.tan(angle)) for angle in elevation for place in y])


def seen_by_lidar(points: np.ndarray) -> LevelView:
    eye = np.array([0.0, 0.0, 1.7])
    box = OrientedBox(make_T(None, points.mean(axis=0)), np.ptp(points, axis=0) + 0.1)
    detection = Detection(PointCloud(points, eye), np.array([0, 0, 1.0]), None, "", {}, box, sensor=LIDAR)
    return make_level_view(detection)


def test_what_reaches_the_highest_ring_goes_on_above_it_as_far_as_anyone_knows() -> None:
    view = seen_by_lidar(side_of_a_bus(10.0))
    assert view.cut is not None
    assert view.viewpoint is not None
    assert LIDAR.highest_rad is not None
    away = -view.viewpoint
    ahead = np.array([*away[:2], 0.0]) / np.linalg.norm(away[:2])
    limit = LIDAR.highest_rad - LIDAR.step_rad
    for angle, beyond in ((limit + 0.005, True), (limit - 0.005, False)):
        direction = np.cos(angle) * ahead + np.sin(angle) * np.array([0, 0, 1.0])
        assert (direction @ view.cut > 0) == beyond
    silhouette = view.silhouette
    assert silhouette is not None
    above = view.viewpoint + 10.0 * ahead + np.array([[0, 0, 0.5]])
    below = view.viewpoint + 10.0 * ahead + np.array([[0, 0, -1.9]])
    assert len(silhouette.free_space_violation(above)[0]) == 0
    assert len(silhouette.free_space_violation(below)[0]) == 1


def test_what_ends_below_the_highest_ring_was_seen_to_its_top() -> None:
    assert seen_by_lidar(side_of_a_bus(10.0)[4 * 60 :]).cut is None


def test_a_foot_and_a_top_between_two_rings_may_be_half_a_step_beyond_the_points() -> None:
    """At 10 m rings are 7.3 cm apart: the floor is guessed half of that lower, and half of it above is not free."""
    points = side_of_a_bus(10.0)[4 * 60 :]
    view = seen_by_lidar(points)
    lowest = float((points - points.mean(axis=0))[:, 2].min())
    sine = float((1.7 - points.mean(axis=0)[2]) / np.linalg.norm(points.mean(axis=0) - [0, 0, 1.7]))
    assert view.floor_m == pytest.approx(lowest - 8 / 3 * 0.02 * sine - 10.0 * LIDAR.step_rad / 2, abs=0.01)
    assert view.silhouette is not None
    top = np.array([0.0, 0.0, float((points - points.mean(axis=0))[:, 2].max())])
    free = [len(view.silhouette.free_space_violation(top[None] + [0, 0, up])[0]) for up in (0.03, 0.12)]
    assert free == [0, 1]


def test_returns_that_a_lidar_lost_are_no_free_space() -> None:
    """A pane in a wall gives none; what lies beside the wall is free, as it is for a depth camera in the pane too."""
    points = side_of_a_bus(10.0)[4 * 60 :]
    pane = (np.abs(points[:, 1]) < 1.5) & (np.abs(points[:, 2] - 0.9) < 0.35)
    view = seen_by_lidar(points[~pane])
    assert view.silhouette is not None
    centre = points[~pane].mean(axis=0)
    T_level_world = invert_T(view.T_world_level)
    within, beside = (apply_T(T_level_world, np.array([[10.0, y, 0.9]])) for y in (0.0, 5.0))
    assert len(view.silhouette.free_space_violation(within)[0]) == 0
    assert len(view.silhouette.free_space_violation(beside)[0]) == 1
    assert centre[0] == pytest.approx(10.0)
