"""The bench of detection, with detectors and classifiers whose answers are known."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gfp_grasp.bench import bench_detection, detection
from gfp_grasp.bench.detection import name_capture, name_views
from gfp_grasp.bench.finding import clutter_pictures, room_pictures, table_pictures
from gfp_grasp.errors import NothingDetected
from gfp_grasp.train import Example
from gfp_grasp.types import DepthImage

EYE = np.array([0.3, 0.4, 0.5])


@dataclass
class Found:
    """What the bench reads of a detection."""

    mask: np.ndarray | None
    category: str = "cup"
    scores: Any = None


def mask(first: int, last: int, shape=(12, 16)) -> np.ndarray:
    """Pixels of some columns."""
    mask = np.zeros(shape, dtype=bool)
    mask[:, first:last] = True
    return mask


def picture(shape=(12, 16)) -> np.ndarray:
    """Points (h, w, 3) m of a plane at 1 m, as a camera of 20 px focal length sees them."""
    height, width = shape
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    return np.stack([(columns - 7.5) / 20, (rows - 5.5) / 20, np.ones(shape)], axis=-1)


@pytest.fixture
def table(tmp_path):
    """A capture with three labelled objects: columns 1 to 4, 6 to 9 and 11 to 14."""
    label = np.zeros((12, 16), dtype=int)
    for number, first in ((1, 1), (2, 6), (7, 11)):
        label[:, first : first + 4] = number
    (tmp_path / "captures").mkdir()
    np.savez(tmp_path / "captures" / "table_b.npz", points_cam=picture(), label=label)
    return tmp_path


def test_the_biggest_object_of_a_capture_is_named(tmp_path, monkeypatch):
    asked = []

    def detect(view, **how):
        asked.append((view, how))
        return (Found(None, "mug", {"cup": 0.12345, "mug": 0.8}), Found(None, "cup", {}))

    monkeypatch.setattr(detection, "detect_objects", detect)
    K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
    np.savez(tmp_path / "mug.npz", depth_m=np.full((12, 16), 0.7), K=K)
    assert name_capture(tmp_path / "mug.npz") == {
        "detections": 2,
        "category": "mug",
        "scores": {"cup": 0.123, "mug": 0.8},
    }
    (view, how) = asked[0]
    assert isinstance(view, DepthImage)
    assert how == {"up": None}
    np.testing.assert_array_equal(view.T_world_camera, np.eye(4))
    np.testing.assert_array_equal(view.K, K)


def test_a_capture_that_is_refused_is_a_row_that_says_why(tmp_path, monkeypatch):
    def detect(view, **how):
        raise NothingDetected("no plane")

    monkeypatch.setattr(detection, "detect_objects", detect)
    np.savez(tmp_path / "room.npz", depth_m=np.full((12, 16), 0.7), K=np.eye(3))
    assert name_capture(tmp_path / "room.npz") == {"detections": 0, "refused": "no plane"}


def example(
    category: str, answers: tuple[str, ...], accepted: tuple[str, ...], says: str, resting="upright"
) -> Example:
    """A view whose classifier says a class: the number of its points on the table tells which."""
    points = np.zeros((5, 3))
    points[:, 2] = [0.0, 0.005, 0.007, 0.1, 0.2]
    points[2:, 0] = ("cup", "mug", "bottle").index(says)
    return Example(points, EYE, category, "", answers, accepted, resting, None)


@pytest.fixture
def classified(monkeypatch) -> list:
    asked = []

    def classify(points, up, support, *, viewpoint):
        asked.append((points, up, support, viewpoint))
        named = ("cup", "mug", "bottle")[int(points[0, 0])]
        return {"cup": 0.2, "mug": 0.1, "bottle": 0.15, named: 0.6}

    three = SimpleNamespace(categories=("bottle", "cup", "mug"))
    monkeypatch.setattr(detection, "classify", classify)
    monkeypatch.setattr(detection, "PrimitiveLibrary", SimpleNamespace(shipped=lambda: three))
    return asked


def test_views_are_counted_by_true_and_by_named_class(classified):
    either = ("cup", "mug")
    found = name_views(
        [
            example("cup", ("cup",), either, "cup"),
            example("cup", ("cup",), either, "mug"),
            example("mug", ("mug",), ("mug",), "mug"),
            example("mug", either, either, "cup"),
            example("bottle", ("bottle",), ("bottle",), "mug"),
            example("bottle", ("bottle",), ("bottle",), "bottle"),
        ]
    )
    assert found == {
        "views": 6,
        "accuracy": 0.8333,
        "accuracy_named_as_taught": 0.6667,
        "calibration": [{"from": 0.5, "views": 6, "mean_score": 0.6, "right": 0.8333}],
        "confusion_rows_true": {"bottle": [1, 0, 1], "cup": [0, 1, 1], "mug": [0, 0, 1]},
        "several_right": {"mug": [0, 1, 0]},
        "columns_named": ["bottle", "cup", "mug"],
    }
    points, up, support, viewpoint = classified[0]
    assert points[:, 2].tolist() == [0.007, 0.1, 0.2]  # what lies within 6 mm of the table belongs to it
    assert up.tolist() == support.normal.tolist() == [0.0, 0.0, 1.0]
    assert support.height_m == 0.0
    assert viewpoint is EYE


def test_the_whole_bench_has_found_objects_captures_and_views(table, classified, monkeypatch):
    asked: dict[str, list] = {"sets": [], "class": [], "assorted": []}
    for name in ("mug_red", "bowl"):
        np.savez(table / "captures" / f"{name}.npz", depth_m=np.ones((2, 2)), K=np.eye(3))
    (table / "captures" / "readme.txt").write_text("no capture")

    def of_class(*which, **how):
        asked["class"].append((which, how))
        name = which[0]
        return [example(name, (name,), (name,), "cup"), example(name, (name,), (name,), name, "lying")]

    def assorted(*which, **how):
        asked["assorted"].append((which, how))
        return [example("knife", (), (), "cup")] * 2

    def matched(sets):
        asked["sets"].append(
            {name: (pictures.func, pictures.args, pictures.keywords) for name, pictures in sets.items()}
        )
        return "found"

    fakes = {
        "class_examples": of_class,
        "assorted_examples": assorted,
        "match_detectors": matched,
        "name_capture": lambda path: f"capture {path.name}",
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(detection, name, fake)
    monkeypatch.setattr(detection, "platform", SimpleNamespace(machine=lambda: "abacus"))
    monkeypatch.setattr(detection, "os", SimpleNamespace(cpu_count=lambda: 3))
    report = bench_detection(table, cache=table / "cache", num_views=5, workers=2)
    views, upright = report.pop("procedural_test"), report.pop("procedural_test_upright")
    assert report == {
        "match_iou": 0.7,
        "machine": "abacus, 3 cores",
        "captures": {"bowl": "capture bowl.npz", "mug_red": "capture mug_red.npz"},
        "found": "found",
        "foreign_mean_top_score": 0.6,
    }
    assert (views["views"], views["accuracy"]) == (6, 0.6667)
    assert (upright["views"], upright["accuracy"]) == (3, 0.3333)
    classes = ("bottle", "cup", "mug")
    how = {"num_views": 5, "workers": 2, "folder": table / "cache", "classes": classes}
    assert asked["class"] == [((name, "test"), how) for name in classes]
    rendered = {"clutter": (clutter_pictures, (40,), {"seed": 0}), "rooms": (room_pictures, (40,), {"seed": 0})}
    assert asked["sets"] == [{**rendered, "tables": (table_pictures, (table,), {})}]
    others = {"num_members": 2, "num_views": 2, "workers": 2, "folder": table / "cache"}
    assert asked["assorted"] == [((2000, 18), others)]
    assert "captures" not in bench_detection(None)
    assert asked["sets"][1] == rendered
    assert asked["class"][3][1] == {**how, "num_views": 4, "workers": 1, "folder": detection.CACHE}
