"""Recall and precision of found boxes, by hand."""

from pathlib import Path

import numpy as np
import pytest

from gfp_grasp.bench import KittiConfig, bench_kitti, kitti, kitti_detection
from gfp_grasp.train import StreetScan

CAR = np.array([10.0, 2.0, 0.8, 4.0, 1.8, 1.6, 0.0])


def at(x: float, y: float) -> np.ndarray:
    return np.concatenate([(x, y), CAR[2:]])


def cloud(box: np.ndarray, count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.45, 0.45, (count, 3)) * box[3:6] + box[:3]


@pytest.fixture
def scan() -> StreetScan:
    """Cars of 250, 60 and 10 points at 10, 20 and 25 m, a van of 250 at 12 m, a car beside what has labels."""
    boxes = np.stack([CAR, at(20, 2), at(25, 8), at(12, -3), at(3, 12)])
    points = np.concatenate(
        [cloud(box, count) for box, count in zip(boxes, (250, 60, 10, 250, 300), strict=True)]
        + [cloud(at(20, -8), 100)]
    )
    names = np.array(["car", "car", "car", "van", "car"])
    return StreetScan(points, boxes[:4], names[:4], np.zeros(len(points), dtype=int), np.deg2rad(40.5))


def found(monkeypatch: pytest.MonkeyPatch, *boxes: tuple[np.ndarray, str, float]) -> None:
    answer = (
        np.stack([box for box, _, _ in boxes]),
        np.array([score for _, _, score in boxes]),
        np.array([name for _, name, _ in boxes]),
    )
    monkeypatch.setattr(kitti_detection, "find_boxes", lambda points: answer)


def test_recall_and_precision_by_class_and_distance(scan: StreetScan, monkeypatch: pytest.MonkeyPatch):
    """One car is found by 3 of 5 m (IoU 0.6), one not; the van is called a car; two cars are where nothing is."""
    found(
        monkeypatch,
        (at(11, 2), "car", 0.9),
        (at(12, -3), "car", 0.8),
        (at(20, -8), "car", 0.75),
        (at(3, 12), "car", 0.9),  # beside the labelled angle
        (at(20, 2), "car", 0.3),  # not sure enough
    )
    rows = kitti_detection.detection_rows([scan])
    near, far = rows["car"]["0 to 15 m"], rows["car"]["15 to 30 m"]
    assert (near["things"], near["found"]) == (1, 2)
    assert (near["recall_0.5"], near["recall_0.7"]) == (1.0, 0.0)
    assert (near["precision_0.5"], near["precision_0.7"]) == (1.0, 0.5)
    assert (far["things"], far["found"], far["recall_0.5"], far["precision_0.5"]) == (1, 1, 0.0, 0.0)
    assert (rows["van"]["0 to 15 m"]["things"], rows["van"]["0 to 15 m"]["recall_0.7"]) == (1, 1.0)
    clear = rows["car"]["clear"]
    assert (clear["things"], clear["found"], clear["recall_0.5"], clear["precision_0.5"]) == (
        1,
        1,
        1.0,
        1.0,
    )  # the other has 190
    assert rows["car"]["30 to 50 m"] == {"things": 0, "found": 0}


def test_what_is_called_something_else_is_not_found(scan: StreetScan, monkeypatch: pytest.MonkeyPatch):
    found(monkeypatch, (CAR, "pedestrian", 0.9))
    rows = kitti_detection.detection_rows([scan])
    assert rows["car"]["0 to 15 m"]["recall_0.5"] == 0.0
    assert rows["pedestrian"]["0 to 15 m"]["precision_0.5"] == 0.0


def test_a_row_completes_what_the_detector_finds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The detector finds nothing on a bare road: its row says so for the thing, and the others are untouched by it."""
    rng = np.random.default_rng(0)
    road = np.column_stack([rng.uniform(-30, 30, (6000, 2)), rng.normal(-1.73, 0.01, 6000)])
    box = CAR - [0, 0, 1.73, 0, 0, 0, 0]
    points = np.concatenate([road, cloud(box, 200)])
    np.savez(tmp_path / "scan.npz", points=points, boxes=box[None], classes=np.array(["Car"]))
    monkeypatch.setattr(kitti, "_detected", lambda scan: ())
    found(monkeypatch, (CAR, "car", 0.9))
    report = bench_kitti(tmp_path, config=KittiConfig(rows=("partial", "gfpnet-detected")))
    row = report["rows"]["gfpnet-detected"]
    assert (row["things"], row["refused"]) == (1, 1)
    assert row["each"][0]["refused"] == "NothingDetected: the detector did not find it"
    assert report["rows"]["partial"]["refused"] == 0
    assert report["rows"]["partial"]["input_m"] == 0.0
    assert report["detection"]["car"]["0 to 15 m"]["recall_0.5"] == 1.0
