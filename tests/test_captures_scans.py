"""Whole LiDAR scans as recordings: which clouds are scans, how they stand, and what is refused."""

import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import real_data
import trimesh
from placed_boxes import box
from recorded_calls import recorded, rows_of, run
from scipy.spatial import KDTree

from gfp_grasp.camera import HDL_64, scan_meshes
from gfp_grasp.captures import Capture, complete_capture, read_capture
from gfp_grasp.captures.scans import is_scan, scan_of
from gfp_grasp.completion import CompletedScene
from gfp_grasp.detect import GivenBoxes
from gfp_grasp.errors import GfpGraspError, InvalidCloud, InvalidOption, InvalidView, NothingDetected, TooFewPoints
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import LIDAR, TABLETOP, Detection, OrientedBox, RangeImage

UP = np.array([0.0, 0.0, 1.0])
CAR = OrientedBox(make_T(rotation_about(UP, 0.4), (9.0, 3.0, -0.98)), np.array([4.0, 1.7, 1.5]))
# What the sensor's frame is in the frame of a file, by how that frame lies.
FRAMES = {
    "y forward, x right": (rotation_about(UP, np.pi / 2), None),
    "z down, x forward": (np.diag([1.0, -1.0, -1.0]), "-z up"),
    "z down, y forward": (np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]), "-z up"),
    "y down, z forward": (np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), "-y up"),
    "y up, z backward": (np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]]), "with y up"),
    "x up": (np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), "with x up"),
}


@pytest.fixture(scope="module")
def street() -> RangeImage:
    """A road 1.73 m under the sensor that rises ahead, a car to the left, a wall to the right, a kiosk behind."""
    things = [
        trimesh.creation.box(CAR.extents, CAR.T_world_box),
        box((70.0, 0.3, 6.0), (3.0, -9.0, -1.73)),
        box((2.0, 3.0, 2.6), (-14.0, 2.0, -1.73), 20.0),
    ]
    return scan_meshes(things, T_world_sensor=np.eye(4), ground_m=-1.73, rng=np.random.default_rng(0))[0]


@pytest.fixture(scope="module")
def points(street: RangeImage) -> np.ndarray:
    """(n, 3) m, within 60 m, as KITTI's files have them."""
    return street.points()[(street.range_m > 0) & (street.range_m < 60)]


def car_of(image: RangeImage, *, up: np.ndarray | None = None) -> tuple[Detection, ...]:
    """A detector that knows where the car is, seen from the sensor."""
    return GivenBoxes([OrientedBox(image.T_world_sensor @ CAR.T_world_box, CAR.extents)])(image, up=up)


def test_a_scan_of_points_in_the_shots_directions_is_the_scan_that_they_come_from(
    street: RangeImage, points: np.ndarray
) -> None:
    found, up = scan_of(points, viewpoint=None, up=None, sensor=LIDAR)
    np.testing.assert_array_equal(up, UP)
    np.testing.assert_array_equal(found.T_world_sensor, np.eye(4))
    expected = np.where(street.range_m < 60, street.range_m, 0.0)
    np.testing.assert_allclose(found.range_m, expected, atol=1e-5)


@pytest.mark.filterwarnings("ignore:the road of the scan")
@pytest.mark.parametrize("frame", FRAMES)
def test_a_scan_in_any_frame_of_axes_is_seen_with_its_road_below(frame: str, points: np.ndarray) -> None:
    T = make_T(FRAMES[frame][0], (30.0, -20.0, 4.0))
    turned = apply_T(T, points)
    found, up = scan_of(turned, viewpoint=T[:3, 3], up=None, sensor=LIDAR)
    np.testing.assert_allclose(up, T[:3, 2], atol=1e-9)
    np.testing.assert_allclose(found.T_world_sensor[:3, 2], up, atol=1e-9)
    np.testing.assert_array_equal(found.viewpoint, T[:3, 3])
    seen = found.points()[found.range_m > 0]
    # Each stays in its own frame, as far as the middle of a pixel may be from a point at 60 m.
    assert KDTree(turned).query(seen)[0].max() < 60 * np.pi / HDL_64.columns
    # A turn by a quarter lays shots on the border between two pixels, where two may meet in one.
    assert len(seen) > 0.65 * len(points)


@pytest.mark.parametrize("frame", FRAMES)
def test_a_frame_whose_z_is_not_up_is_told(frame: str, points: np.ndarray, recwarn: pytest.WarningsRecorder) -> None:
    R, told = FRAMES[frame]
    scan_of(points @ R.T, viewpoint=None, up=None, sensor=LIDAR)
    messages = [str(warning.message) for warning in recwarn]
    assert messages == [] if told is None else len(messages) == 1 and str(told) in messages[0]


def test_rows_of_nothing_are_dropped_wherever_the_sensor_stands(points: np.ndarray) -> None:
    moved = points + np.array([5.0, 1.0, 2.0])
    rows = np.concatenate([np.zeros((40_000, 3)), moved, np.full((9, 3), np.nan), np.full((1, 3), np.inf)])
    assert is_scan(rows, LIDAR)
    found, _ = scan_of(rows, viewpoint=np.array([5.0, 1.0, 2.0]), up=None, sensor=LIDAR)
    alone, _ = scan_of(moved, viewpoint=np.array([5.0, 1.0, 2.0]), up=None, sensor=LIDAR)
    np.testing.assert_array_equal(found.range_m, alone.range_m)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_strays_out_of_reach_are_dropped_and_counted(points: np.ndarray) -> None:
    strays = np.array([[0.0, 301.0, 0.0], [1e300, 0.0, 0.0]])
    with pytest.warns(UserWarning, match="2 points are more than 300 m from the sensor; dropped"):
        found, _ = scan_of(np.concatenate([points, strays]), viewpoint=None, up=UP, sensor=LIDAR)
    alone, _ = scan_of(points, viewpoint=None, up=UP, sensor=LIDAR)
    np.testing.assert_array_equal(found.range_m, alone.range_m)


def test_a_scan_cut_to_a_cameras_field_of_view_stands_as_the_whole_one(points: np.ndarray) -> None:
    ahead = points[(np.abs(points[:, 1]) < 0.8 * points[:, 0])]
    found, up = scan_of(ahead, viewpoint=None, up=None, sensor=LIDAR)
    np.testing.assert_array_equal(up, UP)
    assert not found.range_m[:, : HDL_64.columns // 4].any()


@pytest.mark.filterwarnings("ignore:.*lies above or below the rings")
def test_an_up_that_is_given_is_not_doubted_and_a_sloping_roads_normal_is_not_the_sensors_axis(
    points: np.ndarray,
) -> None:
    high = points - (0.0, 0.0, 5.0)  # no road within 3 m
    normal = np.array([0.1, 0.0, 2.0])
    found, up = scan_of(high, viewpoint=None, up=normal, sensor=LIDAR)
    np.testing.assert_allclose(up, normal / np.linalg.norm(normal))
    np.testing.assert_array_equal(found.T_world_sensor, np.eye(4))
    tilted = rotation_about((0, 1, 0), 0.5)
    near = points[points[:, 2] < -1.7]
    found, up = scan_of(near @ tilted.T, viewpoint=None, up=tilted[:, 2], sensor=LIDAR)
    np.testing.assert_allclose(found.T_world_sensor[:3, 2], tilted[:, 2], atol=1e-9)


def test_points_outside_of_the_rings_are_left_out_with_a_word(points: np.ndarray) -> None:
    trees = np.random.default_rng(1).uniform((-20, 9, 3), (20, 12, 9), (len(points) // 4, 3))
    with pytest.warns(UserWarning, match="20% of the scan lies above or below the rings"):
        scan_of(np.concatenate([points, trees]), viewpoint=None, up=UP, sensor=LIDAR)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda p: 1000 * p, InvalidCloud, r"across and metres are expected: .*in millimetres .*divide by 1000"),
        (lambda p: p - (0, 0, 5.0), InvalidView, r"no axis .* a road 1 to 3 m under the sensor .*give viewpoint"),
        (lambda p: p[:: len(p) // 10], TooFewPoints, r"1\d points, .* 30 are needed"),
        (lambda p: p + 1e6, TooFewPoints, r"and 0 that are .* within 300 m .* is the viewpoint the sensor's place"),
        (lambda p: 1e200 * p, InvalidCloud, r"no common unit"),
        (lambda p: np.full_like(p, np.nan), TooFewPoints, r"and 0 that are finite, not zero"),
        (lambda p: np.zeros_like(p), TooFewPoints, r"and 0 that are finite, not zero"),
        (lambda p: np.random.default_rng(0).uniform(-60, 60, p.shape), InvalidView, "no axis"),
    ],
)
def test_what_is_no_scan_of_a_street_in_metres_is_refused_within_two_seconds(
    change: Callable[[np.ndarray], np.ndarray], error: type[GfpGraspError], words: str, points: np.ndarray
) -> None:
    started = time.perf_counter()
    with pytest.raises(error, match=words):
        scan_of(change(points), viewpoint=None, up=None, sensor=LIDAR)
    assert time.perf_counter() - started < 2.0


def test_a_place_from_which_no_ring_meets_a_point_is_refused(points: np.ndarray) -> None:
    with pytest.raises(InvalidView, match="no point lies on the rings"):
        scan_of(points, viewpoint=np.array([0.0, 0.0, 250.0]), up=UP, sensor=LIDAR)


@pytest.mark.parametrize("turn_deg", [0, 33, 45, 120])
def test_how_wide_a_cloud_is_does_not_depend_on_its_axes(turn_deg: float) -> None:
    narrow = np.random.default_rng(0).uniform((0, -2, -1.7), (26.5, 2, 2), (4000, 3))
    turned = narrow @ rotation_about((1, 2, 3), np.deg2rad(turn_deg)).T
    assert is_scan(turned, LIDAR)
    assert not is_scan(0.95 * turned, LIDAR)


def test_a_lidars_cloud_wider_than_any_object_is_a_scan(points: np.ndarray) -> None:
    lorry = np.random.default_rng(0).uniform((-12, -1.3, 0), (12, 1.3, 4), (4000, 3))
    assert is_scan(points, LIDAR)
    assert not is_scan(points, TABLETOP)
    assert not is_scan(lorry, LIDAR)
    assert is_scan(lorry, replace(LIDAR, largest_m=20.0))
    assert not is_scan(np.empty((0, 3)), LIDAR)
    lone = np.concatenate([lorry, [[90.0, 0, 0]]])
    assert not is_scan(lone, LIDAR)


def test_a_scan_goes_to_the_detector_as_a_view_and_an_object_does_not(
    monkeypatch: pytest.MonkeyPatch, points: np.ndarray
) -> None:
    scene = recorded(monkeypatch, "gfp_grasp.captures.capture.complete_scene", "scene")
    single = recorded(monkeypatch, "gfp_grasp.captures.capture.complete_to_mesh", "one")
    whole = Capture("a", points, up=UP, up_is_assumed=True)
    assert complete_capture(whole, sensor="lidar", seed=3) == "scene"
    (view,), named = scene.only
    assert isinstance(view, RangeImage)
    np.testing.assert_array_equal(named.pop("up"), UP)
    assert named == {"detector": None, "config": None, "seed": 3}  # complete_scene chooses one
    car = Capture("b", points[np.abs(apply_T(invert_T(CAR.T_world_box), points)).max(axis=1) < 2.1], up=UP)
    assert complete_capture(car, sensor="lidar") == ("one",)
    assert complete_capture(car, sensor="lidar", detector=car_of) == "scene"
    assert scene.calls[1][1]["detector"] is car_of
    assert len(single.calls) == 1


def test_a_detector_is_refused_for_points_that_no_lidar_saw(points: np.ndarray) -> None:
    with pytest.raises(InvalidOption, match=r"a holds points only; if they are a whole LiDAR scan, say so"):
        complete_capture(Capture("a", points), detector="votes")


def test_an_empty_street_and_a_box_of_few_points_have_nothing_to_complete(points: np.ndarray) -> None:
    in_box = (np.abs(apply_T(invert_T(CAR.T_world_box), points)) < CAR.extents / 2 + 0.05).all(axis=1)
    empty = points[~in_box & (points[:, 2] < -1.6)]
    with pytest.raises(NothingDetected):
        complete_capture(Capture("a", empty), detector=car_of, sensor="lidar")
    few = np.concatenate([empty, points[in_box][::100][:10]])
    with pytest.raises(NothingDetected, match="none of 1 boxes holds 30 points"):
        complete_capture(Capture("a", few), detector=car_of, sensor="lidar")


@pytest.mark.parametrize("suffix", [".bin", ".npz", ".npy", ".pcd", ".csv"])
def test_the_same_scan_comes_out_of_every_format(tmp_path: Path, suffix: str, points: np.ndarray) -> None:
    path = tmp_path / f"scan{suffix}"
    rows = np.column_stack([points, np.full(len(points), 0.5)]).astype(np.float32)
    if suffix == ".bin":
        rows.tofile(path)
    elif suffix == ".npz":
        np.savez(path, points=rows, boxes=np.zeros((0, 7)), classes=np.array([], "U3"))
    elif suffix == ".npy":
        np.save(path, rows)
    elif suffix == ".pcd":
        head = "VERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        head += f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA binary\n"
        path.write_bytes(head.encode() + rows.tobytes())
    else:
        path.write_text("x,y,z,intensity\n" + "\n".join(",".join(f"{value:.6f}" for value in row) for row in rows))
    capture = read_capture(path)
    assert capture.points is not None
    np.testing.assert_allclose(capture.points, points, atol=1e-5)
    assert is_scan(capture.points, LIDAR)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: b"", "scan.bin has 0 bytes"),
        (lambda rows: rows.tobytes()[:-3], "it is cut short, or its points hold more or fewer numbers"),
        (lambda rows: np.column_stack([rows, np.arange(len(rows)) % 32]).astype("<f4").tobytes(), "nuScenes"),
        (lambda rows: rows.astype("<f8").tobytes(), "make no sense as these"),
        (lambda rows: (1000 * rows).tobytes(), "InvalidCloud: .*divide by 1000"),
        (lambda rows: rows[:10].tobytes(), "TooFewPoints"),
        (lambda rows: (0 * rows).tobytes(), "InvalidCloud: all points of the cloud are the same point"),
        (lambda rows: rows[rows[:, 2] < -1.6].tobytes(), "NothingDetected"),
    ],
)
def test_the_command_refuses_a_broken_scan_in_one_line(
    change: Callable[[np.ndarray], bytes],
    words: str,
    points: np.ndarray,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = np.column_stack([points, np.full(len(points), 0.5)]).astype("<f4")
    (tmp_path / "scan.bin").write_bytes(change(rows))
    started = time.perf_counter()
    street = words == "NothingDetected"  # is looked at as a whole; the others are refused before
    detector = " --detector test_captures_scans:car_of" if street else ""
    assert run(f"complete {tmp_path / 'scan.bin'} --sensor lidar{detector} -o", tmp_path / "a.glb") == 2
    assert time.perf_counter() - started < 2.0
    told = capsys.readouterr().err
    assert re.search(words, told), told
    assert told.count("\n") == 1
    assert not (tmp_path / "a.glb").exists()


def test_the_command_completes_a_real_scan_with_z_down_into_one_scene(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with np.load(real_data.folder() / "kitti" / "scan_001584.npz") as stored:
        rows = stored["points"] * np.array([1, -1, -1, 1], np.float32)
    rows.tofile(tmp_path / "scan.bin")
    words = "--sensor lidar --detector test_captures_scans:nearest_cars"
    assert run(f"complete {tmp_path / 'scan.bin'} {words} -o", tmp_path / "street.glb") == 0
    printed = capsys.readouterr()
    assert "with -z up" in printed.err
    assert "up is taken to be z" not in printed.err
    names = [row.split()[0] for row in rows_of(printed.out)]
    assert names == ["car", "car_2"]
    scene = trimesh.load_scene(tmp_path / "street.glb")
    assert {name for name in scene.graph.nodes_geometry} >= set(names)


def nearest_cars(image: RangeImage, *, up: np.ndarray | None = None) -> tuple[Detection, ...]:
    """A detector that knows the labels of one scan."""
    with np.load(real_data.folder() / "kitti" / "scan_001584.npz") as stored:
        labels = stored["boxes"][:2]
    placed = [make_T(rotation_about(UP, label[6]), label[:3]) for label in labels]
    boxes = [OrientedBox(image.T_world_sensor @ T, label[3:6]) for T, label in zip(placed, labels, strict=True)]
    return GivenBoxes(boxes)(image, up=up)


def test_a_completed_scan_is_in_the_frame_of_its_file(points: np.ndarray) -> None:
    T = make_T(FRAMES["y down, z forward"][0], (2.0, 1.0, -3.0))
    level = complete_capture(Capture("a", points), detector=car_of, sensor="lidar")
    with pytest.warns(UserWarning, match="-y up"):
        turned = complete_capture(Capture("a", apply_T(T, points), viewpoint=T[:3, 3]), detector=car_of, sensor="lidar")
    assert isinstance(turned, CompletedScene)
    assert len(turned) == len(level) == 1
    np.testing.assert_allclose(turned[0].detection.up, T[:3, 2], atol=0.02)
    expected = level[0].mesh.copy().apply_transform(T)
    np.testing.assert_allclose(turned[0].mesh.bounds, expected.bounds, atol=0.05)
