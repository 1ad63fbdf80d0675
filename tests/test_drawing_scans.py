"""The picture of a scan: its frame, its colours, and where its objects are in it."""

from dataclasses import replace

import numpy as np
import pytest
from toy_street import ROAD_M, THINGS, toy_street

from gfp_grasp.camera import intrinsics
from gfp_grasp.completion import CompletedScene
from gfp_grasp.drawing import ClassColours, draw_scan, first_look, height_greys, level_frame_of, paled, scan_points
from gfp_grasp.drawing.scans import _with_legend
from gfp_grasp.transforms import apply_T, invert_T, look_at, make_T, rotation_about
from gfp_grasp.types import RangeImage

WIDTH, HEIGHT = 480, 256
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def scene() -> CompletedScene:
    return toy_street()


@pytest.fixture(scope="module")
def picture(scene: CompletedScene) -> np.ndarray:
    return draw_scan(scene, width=WIDTH, height=HEIGHT)


def pixel_of(scene: CompletedScene, point: np.ndarray) -> tuple[int, int]:
    """Row and column of a point (3,) m."""
    local = apply_T(invert_T(look_at(*first_look(scene))), point[None])[0]
    u, v, _ = intrinsics(WIDTH, HEIGHT, 36.0) @ local / local[2]
    return round(v), round(u)


def test_classes_are_coloured_by_how_frequent_they_are_and_guessed_surface_is_paler() -> None:
    colours = ClassColours.of(["b", "a", "b", "c"])
    assert colours.counts == {"b": 2, "a": 1, "c": 1}
    assert len({tuple(rgb) for rgb in colours.rgb.values()}) == 3
    seen, guessed = colours.of_vertices("b", np.array([True, False]))
    np.testing.assert_array_equal(seen, colours.rgb["b"])
    np.testing.assert_array_equal(guessed, paled(colours.rgb["b"]))
    assert (guessed > seen).all()


def test_the_higher_a_point_the_darker_its_grey() -> None:
    greys = height_greys(np.array([-1.0, 0.0, 0.5, 2.0, 4.0, 9.0]))
    assert (greys == greys[:, :1]).all()
    assert greys[0, 0] == greys[1, 0]
    assert greys[-1, 0] == greys[-2, 0]
    assert (np.diff(greys[1:5, 0].astype(int)) < 0).all()


def test_in_the_level_frame_the_road_under_the_sensor_is_the_origin_however_the_scan_lies(
    scene: CompletedScene,
) -> None:
    np.testing.assert_allclose(level_frame_of(scene), make_T(None, (0.0, 0.0, -ROAD_M)), atol=1e-9)
    assert isinstance(scene.view, RangeImage)
    turned = replace(scene, view=scene.view.moved(make_T(rotation_about(UP, 0.7), (0.0, 0.0, 0.0))))
    np.testing.assert_allclose(level_frame_of(turned)[:3, :3], rotation_about(UP, -0.7), atol=1e-9)


def test_points_of_objects_are_left_out_of_the_scan_s(scene: CompletedScene) -> None:
    assert isinstance(scene.view, RangeImage)
    rest = scan_points(scene)
    own = sum(len(completion.detection.cloud.points) for completion in scene)
    assert own > 500
    assert len(rest) + own == (scene.view.range_m > 0).sum()
    np.testing.assert_allclose(rest[:, 2], ROAD_M, atol=1e-6)


def test_objects_have_the_hue_of_their_class_where_they_stand_and_the_paper_is_light(
    scene: CompletedScene, picture: np.ndarray
) -> None:
    assert picture.shape[1] == WIDTH
    assert picture.dtype == np.uint8
    assert picture.shape[0] > HEIGHT  # the legend is below
    colours = ClassColours.of([category for category, *_ in THINGS])
    for completion in scene:
        row, column = pixel_of(scene, completion.mesh.bounds.mean(axis=0))
        shown = picture[row, column].astype(float) - picture[row, column].mean()
        expected = colours.rgb[completion.category].astype(float)
        expected -= expected.mean()
        assert shown @ expected / np.linalg.norm(shown) / np.linalg.norm(expected) > 0.95
    assert (picture[2, 2] >= 240).all()


def test_a_picture_without_the_objects_is_grey(scene: CompletedScene) -> None:
    bare = draw_scan(replace(scene, completions=()), width=WIDTH, height=HEIGHT)[:HEIGHT]
    assert np.ptp(bare.astype(int), axis=2).max() <= 3
    assert 0.02 < (bare.mean(axis=2) < 230).mean() < 0.6


def test_a_legend_of_many_classes_fits_in_smaller_words() -> None:
    few, many = (ClassColours.of(names) for names in (["car"], [f"traffic thing {k}" for k in range(7)]))
    picture = np.zeros((40, 1600, 3), dtype=np.uint8)
    assert _with_legend(picture, few).shape == (40 + 62, 1600, 3)  # 2.6 times words of 24 px
    legend = _with_legend(picture, many)[40:]
    assert 26 <= len(legend) < 62
    assert (legend[:, -3:] == legend[0, 0]).all()  # nothing reaches the edge
    assert (legend[:, 1400:-3] != legend[0, 0]).any()
