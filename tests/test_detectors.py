"""Detectors by name, the user's own among them."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from gfp_grasp import complete_scene
from gfp_grasp.camera import cloud_of, intrinsics, render_mesh_view
from gfp_grasp.captures import read_capture
from gfp_grasp.detect import DETECTORS, SCAN_DETECTORS, detect_objects, get_detector, make_detection
from gfp_grasp.errors import InvalidOption, NothingDetected, UnknownDetector
from gfp_grasp.shapes import make_shape
from gfp_grasp.transforms import look_at
from gfp_grasp.types import DepthImage, Detection, RangeImage, SupportPlane

LEFT_M = -0.1


def _picture() -> DepthImage:
    """A cup at the left of a table, a box at its right."""
    cup = make_shape("cup", 3).mesh.copy()
    cup.apply_translation([0.0, LEFT_M, 0.0])
    box = trimesh.creation.box([0.06, 0.08, 0.05])
    box.apply_translation([0.0, 0.12, 0.025])
    image, _ = render_mesh_view(
        [cup, box],
        T_world_camera=look_at((0.6, 0.0, 0.45), (0.0, 0.0, 0.04)),
        K=intrinsics(320, 240, 45.0),
        width=320,
        height=240,
        table_height=0.0,
    )
    return image


def what_stands_at_the_left(image: DepthImage, *, up: np.ndarray | None) -> list[Detection]:
    """A detector as a user writes it: points in a box of the world."""
    cloud = cloud_of(image)
    points = cloud.points[(cloud.points[:, 1] < 0.0) & (cloud.points[:, 2] > 0.004)]
    floor = SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0)
    return [make_detection(points, viewpoint=cloud.viewpoint, support=floor)]


def nothing(image: DepthImage, *, up: np.ndarray | None) -> list[Detection]:
    return []


def points_only(image: DepthImage, *, up: np.ndarray | None) -> np.ndarray:
    return cloud_of(image).points


def test_tabletop_finds_what_stands_on_a_plane_and_names_no_class() -> None:
    assert list(DETECTORS) == ["tabletop", "votes"]
    assert list(SCAN_DETECTORS) == ["pointrcnn"]
    found = get_detector("tabletop")(_picture(), up=np.array([0.0, 0.0, 1.0]))
    assert sorted(round(float(d.cloud.points[:, 1].mean()), 1) for d in found) == [LEFT_M, 0.1]
    assert [d.category for d in found] == ["", ""]
    named = detect_objects(_picture())
    np.testing.assert_array_equal(named[0].cloud.points, found[0].cloud.points)
    assert all(d.category for d in named)


def test_scene_is_completed_by_the_users_own_detector() -> None:
    (only,) = complete_scene(_picture(), detector="test_detectors:what_stands_at_the_left")
    assert abs(only.mesh.centroid[1] - LEFT_M) < 0.01
    assert only.mesh.is_volume
    (same,) = complete_scene(_picture(), detector=what_stands_at_the_left)
    np.testing.assert_array_equal(same.mesh.vertices, only.mesh.vertices)


def test_detection_without_a_class_is_classified_when_it_is_completed() -> None:
    from gfp_grasp.complete import complete_detection
    from gfp_grasp.detect import DetectConfig

    cloud = cloud_of(_picture())
    points = cloud.points[(cloud.points[:, 1] < 0.0) & (cloud.points[:, 2] > 0.004)]
    unnamed = make_detection(points, viewpoint=cloud.viewpoint, config=DetectConfig(classify=False))
    assert unnamed.category == ""
    assert not unnamed.scores
    completion = complete_detection(unnamed)
    assert completion.category in ("cup", "glass")
    assert sum(completion.scores.values()) == pytest.approx(1.0)


def test_a_picture_and_a_scan_have_a_detector_each_where_none_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[object] = []

    def get(name: object) -> object:
        asked.append(name)
        raise UnknownDetector("asked")

    monkeypatch.setattr("gfp_grasp.complete.get_detector", get)
    scan = RangeImage(np.ones((2, 8)), np.array([0.1, 0.0]), np.pi, np.eye(4))
    for view in (DepthImage(np.ones((4, 4)), np.eye(3), np.eye(4)), scan):
        with pytest.raises(UnknownDetector):
            complete_scene(view)
    assert asked == ["votes", "pointrcnn"]


def test_unknown_detector_is_refused_with_those_on_offer() -> None:
    with pytest.raises(
        UnknownDetector, match=r"no detector 'magic': expected tabletop, votes, pointrcnn, or package.module:function"
    ):
        get_detector("magic")
    with pytest.raises(UnknownDetector, match="cannot be imported"):
        complete_scene(_picture(), detector="no_such_module:detect")


def test_detector_of_the_documents_finds_the_mug_of_the_sample() -> None:
    page = (Path(__file__).resolve().parents[1] / "docs" / "own_parts.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    exec(re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)[0], names)
    sample = read_capture("sample")
    assert sample.view is not None
    (mug,) = complete_scene(sample.view, detector=names["detect"])
    assert mug.category == "mug"
    (same,) = complete_scene(sample.view)
    np.testing.assert_allclose(mug.mesh.extents, same.mesh.extents, atol=0.004)


def test_function_of_the_users_own_is_checked_as_a_named_one() -> None:
    with pytest.raises(InvalidOption, match=r"points_only' returned a ndarray"):
        complete_scene(_picture(), detector=points_only)  # pyright: ignore[reportArgumentType]
    with pytest.raises(NothingDetected, match=r"nothing' found no object"):
        complete_scene(_picture(), detector=nothing)


def test_detector_that_cannot_be_asked_is_refused() -> None:
    with pytest.raises(InvalidOption, match=r"<lambda>\(image, up=...\): got an unexpected keyword argument 'up'"):
        complete_scene(_picture(), detector=lambda image: [])  # pyright: ignore[reportArgumentType, reportCallIssue]


def test_detector_that_returns_something_else_is_named() -> None:
    with pytest.raises(InvalidOption, match=r"points_only' returned a ndarray"):
        complete_scene(_picture(), detector="test_detectors:points_only")
    with pytest.raises(NothingDetected, match=r"nothing' found no object"):
        complete_scene(_picture(), detector="test_detectors:nothing")
