"""Noise, boxes, clouds and single objects: known figures, and refusals on either side of their bounds."""

import warnings

import numpy as np
import pytest
import trimesh

from gfp_grasp.camera import intrinsics, render_mesh_view
from gfp_grasp.detect import DetectConfig, clean_cloud, detect_objects, detect_single, estimate_sigma, make_detection
from gfp_grasp.detect.merging import smallest_rectangle
from gfp_grasp.detect.upright import _possible_ups
from gfp_grasp.errors import InvalidCloud, InvalidOption, InvalidView, NothingDetected, TooFewPoints
from gfp_grasp.transforms import look_at, make_T, rotation_about
from gfp_grasp.types import LIDAR, DepthImage, PointCloud, RangeImage, SupportPlane

UP = np.array([0.0, 0.0, 1.0])
EYE = np.array([0.5, -0.3, 0.5])


def _surface(extents: tuple[float, float, float], place=(0.0, 0.0, 0.0), count: int = 4000) -> np.ndarray:
    box = trimesh.creation.box(extents, transform=make_T(None, place))
    return np.asarray(trimesh.sample.sample_surface(box, count, seed=1)[0])


# Noise


def _plane(sigma_m: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-0.1, 0.1, (6000, 2)), rng.normal(0.0, sigma_m, 6000)])


def test_noise_across_a_plane_is_its_standard_deviation() -> None:
    assert estimate_sigma(_plane(0.001)) == pytest.approx(0.001, rel=0.12)


@pytest.mark.parametrize(("degrees", "factor"), [(0.0, 1.0), (60.0, 2.0), (80.0, 1 / 0.3), (86.0, 1 / 0.3)])
def test_noise_along_the_ray_is_larger_where_the_surface_is_seen_from_the_side(degrees: float, factor: float) -> None:
    angle = np.radians(degrees)
    far = 1000.0 * np.array([np.sin(angle), 0.0, np.cos(angle)])
    points = _plane(0.0008)
    assert estimate_sigma(points, far) == pytest.approx(factor * estimate_sigma(points), rel=0.05)


def test_noise_is_believed_between_half_a_millimetre_and_six() -> None:
    assert estimate_sigma(_plane(0.00001)) == pytest.approx(0.0005)
    assert estimate_sigma(10 * _plane(0.001)) == pytest.approx(0.006)
    assert estimate_sigma(_plane(0.002)[:31]) == pytest.approx(0.0005)
    assert estimate_sigma(_plane(0.02)[:32]) > 0.0005


# Boxes


def test_the_smallest_rectangle_lies_along_an_edge_with_the_longer_side_first() -> None:
    turn = rotation_about(UP, 0.5)[:2, :2]
    for sides in ((0.3, 0.1), (0.1, 0.3)):
        corners = (np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.3]]) * sides) @ turn.T + [0.2, -0.4]
        axes, low, high = smallest_rectangle(corners)
        np.testing.assert_allclose(high - low, [0.3, 0.1], atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1.0)
        np.testing.assert_allclose(axes.T @ ((low + high) / 2), corners[:4].mean(axis=0), atol=1e-12)


def test_points_on_a_line_have_a_rectangle_without_width() -> None:
    line = np.outer(np.linspace(0, 1, 20), [0.6, 0.8]) + np.array([1.0, 2.0])
    axes, low, high = smallest_rectangle(line)
    np.testing.assert_allclose(high - low, [1.0, 0.0], atol=1e-12)
    assert abs(axes[0] @ [0.6, 0.8]) == pytest.approx(1.0)


# Clouds


def test_thirty_points_are_a_cloud_and_twenty_nine_are_not() -> None:
    points = _surface((0.1, 0.2, 0.3), count=30)
    assert len(clean_cloud(points)) == 30
    with pytest.raises(TooFewPoints, match="29 finite"):
        clean_cloud(points[:29])
    assert len(clean_cloud(points[:12], min_points=12)) == 12


@pytest.mark.parametrize(
    ("size", "words"), [(0.0165, None), (0.0135, "at least"), (4.9, None), (5.3, "in centimetres it would be 0.05")]
)
def test_extents_between_fifteen_millimetres_and_five_metres_are_metres(size: float, words: str | None) -> None:
    points = _surface((size, 0.8 * size, 0.9 * size))
    if words is None:
        assert len(clean_cloud(points)) == len(points)
    else:
        with pytest.raises(InvalidCloud, match=words):
            clean_cloud(points)
    assert len(clean_cloud(20 * points, sensor=LIDAR)) == len(points)


@pytest.mark.parametrize(("thickness", "flat"), [(8e-5, True), (1.3e-4, False)])
def test_a_cloud_a_ten_thousandth_as_thick_as_long_is_flat(thickness: float, flat: bool) -> None:
    rng = np.random.default_rng(0)
    sheet = rng.normal(size=(500, 3)) * [0.1, 0.1, 0.1 * thickness] + [0.3, 0.2, 0.1]
    line = rng.normal(size=(500, 3)) * [0.1, 0.1 * thickness, 0.1 * thickness] + [0.3, 0.2, 0.1]
    if not flat:
        assert len(clean_cloud(sheet)) == len(clean_cloud(line)) == 500
        return
    with pytest.raises(InvalidCloud, match="plane"):
        clean_cloud(sheet)
    with pytest.raises(InvalidCloud, match="line"):
        clean_cloud(line)


def test_strays_five_metres_away_are_dropped_with_a_warning_and_nearer_ones_kept() -> None:
    points = np.vstack([_surface((0.1, 0.1, 0.1)), [[0.0, 0.0, 4.9], [5.2, 0.0, 0.0], [0.0, -5.2, 0.0]]])
    with pytest.warns(UserWarning, match="2 points are more than 5 m"):
        kept = clean_cloud(points)
    np.testing.assert_array_equal(kept, points[:-2])


def test_copies_are_left_out_where_they_are_most_of_the_cloud() -> None:
    points = _surface((0.1, 0.1, 0.1), count=200)
    assert len(clean_cloud(np.repeat(points, 3, axis=0))) == 200
    half_again = np.vstack([points, points[:100]])
    assert len(clean_cloud(half_again)) == 300
    with pytest.raises(TooFewPoints, match="only 10 different"):
        clean_cloud(np.repeat(points[:10], 9, axis=0))


def test_masked_rows_and_named_fields_are_read() -> None:
    points = _surface((0.1, 0.1, 0.1), count=100)
    masked = np.ma.masked_array(points, mask=np.zeros_like(points, bool))
    masked[7, 1] = np.ma.masked
    with pytest.warns(UserWarning, match="1 of 100"):
        np.testing.assert_array_equal(clean_cloud(masked), np.delete(points, 7, axis=0))
    fields = np.zeros(100, dtype=[("z", "f8"), ("rgb", "u4"), ("x", "f8"), ("y", "f8")])
    for k, name in enumerate("xyz"):
        fields[name] = points[:, k]
    np.testing.assert_array_equal(clean_cloud(fields), points)


# One object


def test_an_object_without_table_keeps_all_that_hangs_together() -> None:
    detection = detect_single(_surface((0.06, 0.07, 0.1), (0.0, 0.0, 0.3)), viewpoint=EYE, category="cup")
    assert detection.support is None
    assert len(detection.cloud.points) == 4000
    np.testing.assert_array_equal(detection.up, UP)
    np.testing.assert_allclose(detection.box.extents, [0.07, 0.06, 0.1], atol=2e-3)
    np.testing.assert_array_equal(detection.cloud.viewpoint, EYE)


@pytest.mark.parametrize(("gap", "used"), [(0.05, 2), (0.075, 1)])
def test_clusters_within_six_centimetres_may_be_one_object_behind_an_occluder(gap: float, used: int) -> None:
    left, right = _surface((0.06, 0.06, 0.1), (0.0, 0.0, 0.05)), _surface((0.05, 0.05, 0.1), (0.055 + gap, 0.0, 0.05))
    with pytest.warns(UserWarning, match=f"2 clusters; {used} of them"):
        detection = detect_single(np.vstack([left, right]), category="cup")
    assert (detection.cloud.points[:, 0].max() > 0.05) == (used == 2)


@pytest.mark.parametrize(("count", "told"), [(60, None), (400, "9% of the points .* it would be|be 0.21 m long")])
def test_a_second_cluster_of_less_than_a_tenth_is_left_out_and_told_where_it_is_much(
    count: int, told: str | None
) -> None:
    large, small = _surface((0.1, 0.1, 0.15), (0, 0, 0.08)), _surface((0.02, 0.02, 0.02), (0.15, 0, 0.08), count=count)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if told is not None:
            with pytest.warns(UserWarning, match=told):
                detection = detect_single(np.vstack([large, small]), category="cup")
        else:
            detection = detect_single(np.vstack([large, small]), category="cup")
    assert detection.cloud.points[:, 0].max() < 0.06


SIDE = np.array([-1.5, 0.0, 0.1])


def _strips(gap_m: float, *, count: int = 12) -> np.ndarray:
    """A wall along x that is seen at a slant from SIDE: upright strips of points, each farther from the last."""
    x = np.cumsum(gap_m * np.arange(1, count + 1))
    z = np.linspace(0.02, 0.18, 80)
    return np.array([(0.06 + a, 0.0, height) for a in x for height in z])


def test_strips_of_a_surface_at_a_slant_are_one_object_where_the_viewpoint_tells_that_they_are_neighbours() -> None:
    front = _surface((0.02, 0.1, 0.2), (0.0, 0, 0.1), count=6000)
    points = np.vstack([front, _strips(0.006)])
    with pytest.warns(UserWarning, match="hang apart|clusters"):
        apart = detect_single(points, category="box")
    assert apart.cloud.points[:, 0].max() < 0.25
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        whole = detect_single(points, viewpoint=SIDE, category="box")
    assert whole.cloud.points[:, 0].max() == pytest.approx(points[:, 0].max())


@pytest.mark.parametrize(("far", "words"), [(0.39, None), (0.52, "clusters")])
def test_clusters_more_than_forty_five_centimetres_across_are_no_single_object(far: float, words: str | None) -> None:
    points = np.vstack([_surface((0.06, 0.06, 0.1)), _surface((0.06, 0.06, 0.1), (far - 0.06, 0.0, 0.0))])
    if words is None:
        with pytest.warns(UserWarning, match="clusters"):
            detect_single(points, category="cup")
    else:
        with pytest.raises(InvalidCloud, match=words):
            detect_single(points, category="cup")


@pytest.mark.parametrize(("size", "refused"), [(1.4, False), (1.6, True)])
def test_an_object_is_one_and_a_half_metres_large_at_most(size: float, refused: bool) -> None:
    points = _surface((size, 0.3, 0.3), (0.0, 0.0, 0.2), count=60_000)
    if refused:
        with pytest.raises(InvalidCloud, match="across"):
            detect_single(points, category="cup")
    else:
        assert detect_single(points, category="cup").box.extents[0] == pytest.approx(1.4, abs=0.01)


@pytest.mark.parametrize(
    ("viewpoint", "words"),
    [
        ((19.0, 0.0, 0.0), None),
        ((21.0, 0.0, 0.0), "21"),
        ((0.0, 0.0, 0.0), "inside"),
        ((0.0, 0.0, 0.09), None),  # the top face's corners are seen under 52 degrees
        ((0.0, 0.0, 0.06), "inside"),
    ],
)
def test_a_viewpoint_is_outside_of_the_object_and_within_range(viewpoint: tuple, words: str | None) -> None:
    points = _surface((0.1, 0.1, 0.1))
    points = points[points[:, 2] > 0.0499] if viewpoint[2] else points
    points = np.vstack([points, points - 0.004 * UP])
    if words is None:
        detect_single(points, viewpoint=np.array(viewpoint), category="cup")
    else:
        with pytest.raises(InvalidCloud, match=words):
            detect_single(points, viewpoint=np.array(viewpoint), category="cup")


def _picture(**options) -> tuple[DepthImage, np.ndarray]:
    box = trimesh.creation.box((0.07, 0.09, 0.1), transform=make_T(None, (0.0, 0.0, 0.05)))
    return render_mesh_view(
        [box],
        T_world_camera=look_at(EYE, (0.0, 0.0, 0.05)),
        K=intrinsics(160, 120, 45.0),
        width=160,
        height=120,
        table_height=0.0,
        **options,
    )


def test_a_mask_is_kept_where_it_covers_a_tenth_of_the_points() -> None:
    image, index = _picture()
    points = image.points()[index == 0]
    rows = np.flatnonzero((index == 0).any(axis=1))
    part = (index == 0) & (np.arange(120) < rows[len(rows) // 3])[:, None]
    detection = detect_single(points, view=image, mask=part.astype(float), category="cup")
    np.testing.assert_array_equal(detection.mask, part)
    np.testing.assert_array_equal(detection.cloud.viewpoint, EYE)
    seen = np.flatnonzero(index.ravel() == 0)
    few = np.zeros(part.size, dtype=bool)
    few[seen[::7]] = True  # one in seven
    assert detect_single(points, view=image, mask=few.reshape(part.shape), category="cup").mask is not None
    some = np.zeros_like(part)
    some[np.nonzero(index == 0)[0][:20], np.nonzero(index == 0)[1][:20]] = True
    with pytest.raises(InvalidView, match="covers"):
        detect_single(points, view=image, mask=some, category="cup")
    with pytest.raises(InvalidView, match="shape"):
        detect_single(points, view=image, mask=part.T, category="cup")


def test_a_view_that_did_not_see_the_points_is_refused() -> None:
    image, index = _picture()
    points = image.points()[index == 0]
    with pytest.raises(InvalidView, match="saw nothing"):
        detect_single(points + 0.1 * (EYE - points), view=image, support_height=0.02, category="cup")


def test_the_picture_tells_the_table_of_points_that_do_not_show_it() -> None:
    image, index = _picture()
    detection = detect_single(image.points()[index == 0], view=image, category="cup")
    assert detection.support is not None
    assert detection.support.height_m == pytest.approx(0.0, abs=1e-4)
    assert detection.cloud.points[:, 2].min() > 0.006


def test_ways_up_that_are_tried_follow_from_the_frame() -> None:
    points = np.random.default_rng(0).normal(scale=0.01, size=(50, 3)) + 0.5 * UP
    fine, coarse, _ = _possible_ups(points, None, None)
    expected = np.array([[0.0, -np.cos(np.radians(e)), -np.sin(np.radians(e))] for e in (30, 15, 45, 0, 60)])
    np.testing.assert_allclose(coarse, expected)
    assert len(fine) == 32
    np.testing.assert_allclose(fine[12], expected[0])
    np.testing.assert_allclose(_possible_ups(points, np.array([0.005, 0.0, 0.0]), None)[1], expected)
    # y up and z backward; x forward and z up: no camera of OpenCV's is in the midst of its points.
    np.testing.assert_allclose(_possible_ups(points - UP, None, None)[1], expected * (1, -1, -1))
    ahead = points - 0.5 * UP + (0.5, 0.0, 0.0)
    np.testing.assert_allclose(
        _possible_ups(ahead, None, None)[1], np.stack([expected[:, 2], 0 * expected[:, 0], -expected[:, 1]], axis=1)
    )
    np.testing.assert_allclose(_possible_ups(points - 0.5 * UP, None, None)[1], expected)
    np.testing.assert_array_equal(_possible_ups(points, np.array([0.1, 0.0, 0.9]), None)[0], [UP])
    below = _possible_ups(points, np.array([0.4, -0.3, 0.2]), None)[0]
    np.testing.assert_array_equal(below, [[1, 0, 0], [0, -1, 0], [0, 0, -1]])
    image, _ = _picture()
    ups = _possible_ups(points, EYE, image)[1]
    np.testing.assert_allclose(ups[:5], expected @ image.T_world_camera[:3, :3].T)
    np.testing.assert_array_equal(ups[5], UP)
    T = make_T(rotation_about((1.0, 0.2, 0.0), 0.3), (0, 0, 2))
    scan = RangeImage(np.ones((2, 8)), np.array([0.1, -0.1]), 0.0, T)
    np.testing.assert_allclose(_possible_ups(points, None, scan)[0], [T[:3, 2]])


# Detections


def test_a_detection_keeps_an_even_share_of_its_points_and_no_class_where_none_is_asked_for() -> None:
    points = _surface((0.1, 0.1, 0.1), count=5000)
    config = DetectConfig(max_object_points=1000, classify=False)
    plane = SupportPlane(UP, -0.05)
    detection = make_detection(points, viewpoint=EYE, support=plane, config=config)
    np.testing.assert_array_equal(detection.cloud.points, points[::5])
    assert (detection.category, detection.scores) == ("", {})
    assert detection.support is plane
    assert detection.sensor_sigma_m == estimate_sigma(points[::5], EYE)
    assert make_detection(points, category="mug").scores == {"mug": 1.0}


def test_objects_of_points_stand_on_a_tilted_table_in_the_order_of_their_size() -> None:
    grid = np.stack(np.meshgrid(np.arange(-0.3, 0.3, 0.005), np.arange(-0.3, 0.3, 0.005)), axis=-1).reshape(-1, 2)
    table = np.column_stack([grid, np.zeros(len(grid))])
    small, large = _surface((0.05, 0.06, 0.08), (0.1, 0.1, 0.04)), _surface((0.08, 0.09, 0.12), (-0.1, 0.0, 0.06), 9000)
    T = make_T(rotation_about((0.6, 0.8, 0.0), 0.2), (0.1, 0.2, 0.3))
    cloud = PointCloud(np.vstack([table, small, large]) @ T[:3, :3].T + T[:3, 3], np.array([0.5, 0.2, 0.9]))
    first, second = detect_objects(cloud, config=DetectConfig(classify=False))
    np.testing.assert_allclose(first.up, T[:3, 2], atol=1e-3)
    np.testing.assert_allclose(first.box.extents, [0.09, 0.08, 0.114], atol=4e-3)  # 6 mm are the table's
    np.testing.assert_allclose(second.box.extents, [0.06, 0.05, 0.074], atol=4e-3)
    with pytest.raises(NothingDetected, match="no support"):
        detect_objects(PointCloud(small), config=DetectConfig(classify=False))


@pytest.mark.parametrize("nonsense", [{"max_points": 999}, {"max_object_points": 999}])
def test_fewer_than_a_thousand_points_are_too_few_to_look_at(nonsense: dict) -> None:
    DetectConfig(max_points=1000, max_object_points=1000)
    with pytest.raises(InvalidOption):
        DetectConfig(**nonsense)
