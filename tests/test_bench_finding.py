"""The pictures of tables, clutter and rooms of the bench, and how detections are matched with their objects."""

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from clocks import SteadyClock
from PIL import Image
from scipy.spatial import KDTree

from gfp_grasp import shapes
from gfp_grasp.bench import finding
from gfp_grasp.bench.clutter import draw_clutter
from gfp_grasp.bench.finding import (
    LabelledPicture,
    best_iou,
    clutter_pictures,
    match_detectors,
    match_pictures,
    room_pictures,
    table_pictures,
)
from gfp_grasp.camera import SensorModel
from gfp_grasp.errors import InvalidOption, NothingDetected
from gfp_grasp.types import DepthImage


@dataclass
class Found:
    """What the bench reads of a detection."""

    mask: np.ndarray | None


def mask(first: int, last: int, shape=(12, 16)) -> np.ndarray:
    """Pixels of some columns."""
    mask = np.zeros(shape, dtype=bool)
    mask[:, first:last] = True
    return mask


def picture(name: str, *objects: tuple[int, int], up=None, least_px: int = 1) -> LabelledPicture:
    """A picture whose objects are columns of it."""
    labels = np.zeros((12, 16), dtype=int)
    for number, (first, last) in enumerate(objects, start=1):
        labels[:, first:last] = 2 * number
    view = DepthImage(np.ones((12, 16)), np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]]), np.eye(4))
    return LabelledPicture(name, view, labels, up, least_px)


def test_the_best_detection_of_a_mask_is_that_of_the_largest_overlap():
    found: Any = (Found(None), Found(mask(0, 2)), Found(mask(1, 5)), Found(mask(5, 9)))
    assert best_iou(mask(0, 4), found) == 0.6
    assert best_iou(mask(0, 4), ()) == 0.0
    assert best_iou(mask(0, 4), (Found(None),)) == 0.0  # type: ignore[arg-type]


def test_objects_are_matched_with_detections_and_refused_pictures_are_counted(monkeypatch):
    asked = []

    def detect(image, *, up) -> Any:
        asked.append((image, up))
        if up is not None:
            raise NothingDetected("nothing")
        return (Found(mask(1, 5)), Found(mask(6, 9)), Found(mask(13, 16)), Found(mask(0, 16)))

    monkeypatch.setattr(finding, "time", SteadyClock(1.5))
    first = picture("a", (1, 5), (6, 10), (11, 15))  # 1.0, 0.75, 0.4
    second = picture("b", (0, 4), (5, 6), up=(0, 0, 1), least_px=20)  # nothing, and too small
    assert match_pictures([first, second], detect) == {
        "pictures": 2,
        "refused": 1,
        "objects": 4,
        "matched": 2,
        "share": 0.5,
        "mean_iou": round((1 + 0.75 + 0.4) / 4, 3),
        "missed": {"a": 1, "b": 1},
        "median_seconds": 1.5,
    }
    assert [up for _, up in asked] == [None, (0, 0, 1)]
    assert asked[0][0] is first.view


def test_every_detector_sees_every_set():
    sets = {"one": lambda: [picture("a", (1, 5))], "two": lambda: iter([picture("b", (0, 8)), picture("c")])}
    detectors: Any = {
        "left": lambda view, up: (Found(mask(0, 8)),),
        "none": lambda view, up: (),
    }
    report = match_detectors(sets, detectors)
    assert {name: {kind: row["share"] for kind, row in rows.items()} for name, rows in report.items()} == {
        "left": {"one": 0.0, "two": 1.0},
        "none": {"one": 0.0, "two": 0.0},
    }
    assert report["left"]["two"]["pictures"] == 2
    assert match_pictures([], detectors["left"])["mean_iou"] is None


def test_tables_of_a_folder_are_pictures_with_labels(tmp_path):
    columns, rows = np.meshgrid(np.arange(16), np.arange(12))
    points = np.stack([(columns - 7.5) / 20, (rows - 5.5) / 20, np.ones((12, 16))], axis=-1)
    label = picture("", (1, 5), (6, 10)).labels
    (tmp_path / "captures").mkdir()
    for name in ("table_b", "table_a", "room_c"):
        np.savez(tmp_path / "captures" / f"{name}.npz", points_cam=points, label=label)
    tables = list(table_pictures(tmp_path))
    assert [table.name for table in tables] == ["table_a", "table_b"]
    np.testing.assert_array_equal(tables[0].labels, label)
    assert (tables[0].up, tables[0].least_px, tables[0].view.shape) == (None, 1, (12, 16))


def test_clutter_is_seen_by_two_sensors_in_turn(monkeypatch):
    """Two objects in each picture, the table beside them, and pixels without a return."""
    sensors, cameras, renders = [], [], []
    index = np.full((240, 320), 2)
    index[:, :10], index[:, 20:28], index[0] = 0, 1, -1
    depth = np.ones((240, 320))
    depth[:, 5:10] = 0.0
    K = np.array([[289.7, 0, 159.5], [0, 289.7, 119.5], [0, 0, 1]])

    def render(meshes, **how):
        renders.append((len(meshes), how))
        return DepthImage(depth, K, np.eye(4)), index

    def sense(image, sensor, rng):
        sensors.append(sensor)
        return image

    def viewpoint(rng, **how):
        cameras.append(how)
        return np.eye(4)

    monkeypatch.setattr(finding, "draw_clutter", lambda rng: [SimpleNamespace(mesh=None)] * 2)
    monkeypatch.setattr(finding, "render_mesh_view", render)
    monkeypatch.setattr(finding, "apply_sensor", sense)
    monkeypatch.setattr(finding, "sample_viewpoint", viewpoint)
    seen = list(clutter_pictures(3, seed=1))
    assert [one.name for one in seen] == ["clutter_0", "clutter_1", "clutter_2"]
    assert {k: int((seen[0].labels == k).sum()) for k in np.unique(seen[0].labels)} == {
        0: 240 * 320 - 239 * (5 + 8),
        1: 239 * 5,
        2: 239 * 8,
    }
    assert seen[0].least_px == 100
    assert sensors == [SensorModel.realsense(), SensorModel.kinect(), SensorModel.realsense()]
    how = renders[0][1]
    np.testing.assert_allclose(how.pop("K"), K, atol=0.05)  # 45 degrees over 240 rows
    assert how.pop("T_world_camera").tolist() == np.eye(4).tolist()
    assert (renders[0][0], how) == (2, {"width": 320, "height": 240, "table_height": 0.0})
    draws = [float(np.random.default_rng([1, number]).uniform(0.6, 0.9)) for number in range(3)]
    assert cameras == [{"distance_m": draw} for draw in draws]


def test_rooms_are_the_same_for_a_seed_and_hold_several_things():
    first, again = (list(room_pictures(2, seed=4)) for _ in range(2))
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.view.depth_m, other.view.depth_m)
        np.testing.assert_array_equal(one.labels, other.labels)
        assert one.view.shape == one.labels.shape == (480, 640)
        assert len(np.unique(one.labels)) >= 3
        assert (one.view.depth_m[one.labels > 0] > 0).all()
    assert not np.array_equal(first[0].labels, first[1].labels)


# Seeds of the clutter stay what they are: the committed figure is of these scenes. Bounds in mm, low then high.
KNOWN_CLUTTER = [
    [32.1, -228.0, 0.0, 194.2, -65.8, 46.5],
    [55.6, 74.4, 0.0, 239.3, 258.1, 35.1],
    [-202.0, 20.3, 0.0, -27.3, 195.0, 62.3],
    [-14.8, -99.2, 0.0, 47.0, -37.4, 144.8],
]


def test_clutter_stands_apart_on_the_table():
    scenes = [[one.mesh for one in draw_clutter(np.random.default_rng(seed))] for seed in range(2, 7)]
    np.testing.assert_allclose([1e3 * np.ravel(mesh.bounds) for mesh in scenes[0]], KNOWN_CLUTTER, atol=0.1)
    gaps = []
    for meshes in scenes:
        trees = [KDTree(mesh.vertices[:, :2]) for mesh in meshes]
        for number, mesh in enumerate(meshes):
            assert mesh.bounds[0, 2] == pytest.approx(0.0, abs=1e-9)
            gaps += [tree.query(mesh.vertices[:, :2])[0].min() for tree in trees[:number]]
    assert min(gaps) > 0.004


def test_clutter_that_finds_no_room_is_left_out(monkeypatch):
    """Tall cylinders of 100 mm radius: where the first two leave no room, no third stands."""
    disc = trimesh.creation.cylinder(0.1, 0.4)
    disc.apply_translation((0.0, 0.0, 0.2))
    least = []
    monkeypatch.setattr(shapes, "make_shape", lambda family, seed: SimpleNamespace(mesh=disc))
    for seed in range(12):
        middles = [one.mesh.bounds.mean(axis=0)[:2] for one in draw_clutter(np.random.default_rng(seed))]
        assert len(middles) in (1, 2, 3, 4)
        assert np.abs(middles).max() <= 0.18
        apart = [np.linalg.norm(a - b) for n, a in enumerate(middles) for b in middles[:n]]
        assert all(distance > 0.204 for distance in apart)
        least += apart
    assert min(least) < 0.22


def test_rooms_are_painted_side_by_side(tmp_path, monkeypatch):
    (tmp_path / "captures").mkdir()
    K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
    for name, shape in (("room_b", (12, 16)), ("room_a", (10, 16)), ("table_c", (12, 16))):
        np.savez(tmp_path / "captures" / f"{name}.npz", depth_m=np.ones(shape), K=K)
    asked = []

    def detect(image, *, up) -> Any:
        asked.append((image.shape, up))
        return (Found(mask(0, 8, image.shape)), Found(None))

    monkeypatch.setattr(finding, "get_detector", lambda name: detect)
    finding.paint_rooms(tmp_path, tmp_path / "rooms.png")
    picture = np.asarray(Image.open(tmp_path / "rooms.png"))
    assert picture.shape == (5, 16, 3)  # half of the size, the height of the lower one
    colourful = np.ptp(picture.astype(int), axis=2) > 0
    np.testing.assert_array_equal(colourful, np.tile(np.repeat([True, False], 4), (5, 2)))
    assert asked == [((10, 16), None), ((12, 16), None)]


def test_a_folder_without_rooms_is_refused(tmp_path):
    with pytest.raises(InvalidOption, match="has no captures/room_"):
        finding.paint_rooms(tmp_path, tmp_path / "rooms.png")
