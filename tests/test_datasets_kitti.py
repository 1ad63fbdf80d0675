"""KITTI's layouts on small trees that are written by hand: boxes land where the points are."""

from pathlib import Path

import numpy as np
import pytest

from gfp_grasp.datasets import TrafficBox, accumulated, read_bin, read_scans, read_tracks
from gfp_grasp.errors import InvalidOption, UnreadableFile
from gfp_grasp.transforms import apply_T

# The camera looks along the scan's x, its x to the right and y down, 0.27 m in front of the scanner and 0.08 below.
CALIBRATION = """P0: 1 0 0 0 0 1 0 0 0 0 1 0
{rectify} 1 0 0 0 1 0 0 0 1
{scan} 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.27
calib_time: 09-Jan-2012 13:57:47
"""
# Class, truncation, occlusion, alpha, picture, height width length, x y z of the middle of the foot, turn about y.
CAR = "Car 0 0 0 0 0 0 0 1.5 1.6 4.0 -3.0 1.65 12.0 {turn}"
WALKER = "Pedestrian 0 0 0 0 0 0 0 1.8 0.6 0.7 2.0 1.65 6.0 0.0"
NOWHERE = "DontCare -1 -1 -10 1 2 3 4 -1 -1 -1 -1000 -1000 -1000 -10"


def write_scan(path: Path, points: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    np.column_stack([points, np.full(len(points), 0.25)]).astype("<f4").tofile(path)


def write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.fixture
def objects(tmp_path: Path) -> Path:
    """One scan of the object layout below training/: a car ahead to the left, of which three points are seen."""
    middle = np.array([12.27, 3.0, -1.65 - 0.08 + 0.75])
    points = middle + np.array([[0, 0, 0], [0.7, 1.9, 0.3], [0.9, 0, 0], [0, 0, -0.7], [5.0, 0, 0]])
    root = tmp_path / "training"
    write_scan(root / "velodyne" / "000007.bin", points)
    write_text(root / "calib" / "000007.txt", CALIBRATION.format(rectify="R0_rect:", scan="Tr_velo_to_cam:"))
    write_text(root / "label_2" / "000007.txt", "\n".join([CAR.format(turn=0.0), WALKER, NOWHERE]) + "\n")
    return tmp_path


def test_boxes_of_the_object_layout_are_in_the_frame_of_the_scan(objects: Path):
    (scan,) = read_scans(objects)
    assert scan.name == "000007"
    assert [box.category for box in scan.boxes] == ["car", "pedestrian"]
    car, walker = scan.boxes
    np.testing.assert_allclose(car.centre, [12.27, 3.0, -0.98], atol=1e-9)
    np.testing.assert_allclose(car.size_m, [4.0, 1.6, 1.5])
    # A turn of nothing faces the camera's x, that is the scan's -y.
    assert car.yaw_rad == pytest.approx(-np.pi / 2)
    np.testing.assert_allclose(walker.centre, [6.27, -2.0, -0.83], atol=1e-9)
    np.testing.assert_allclose(scan.intensity, 0.25)


def test_a_crop_keeps_what_is_in_the_turned_box_and_leaves_the_road(objects: Path):
    """Of five points one is 0.9 m aside of a car 1.6 m wide, one on the road, and one another thing's."""
    (scan,) = read_scans(objects)
    car = scan.boxes[0]
    assert car.inside(scan.points).tolist() == [True, True, False, False, False]
    assert car.inside(scan.points, grow_m=0.15).tolist() == [True, True, True, False, False]
    assert car.inside(scan.points, road_m=0.0).tolist() == [True, True, False, True, False]


def test_a_turned_label_turns_the_other_way_in_the_scan(objects: Path):
    label = objects / "training" / "label_2" / "000007.txt"
    label.write_text(CAR.format(turn=-0.5))
    (scan,) = read_scans(objects)
    assert scan.boxes[0].yaw_rad == pytest.approx(-np.pi / 2 + 0.5)


@pytest.fixture
def sequence(tmp_path: Path) -> Path:
    """Two scans of one car that drives 2 m and turns by 0.2; each sees another corner of it."""
    write_text(tmp_path / "calib" / "0003.txt", CALIBRATION.format(rectify="R_rect", scan="Tr_velo_cam"))
    turned = "Car 0 0 0 0 0 0 0 1.5 1.6 4.0 -3.0 1.65 14.0 -1.7708"
    labels = [f"0 5 {CAR.format(turn=-np.pi / 2)}", f"1 5 {turned}", f"1 -1 {NOWHERE}"]
    write_text(tmp_path / "label_02" / "0003.txt", "\n".join(labels))
    for frame, (middle, yaw, corner) in enumerate(
        [((12.27, 3.0, -0.98), 0.0, (1.9, 0.7, 0.2)), ((14.27, 3.0, -0.98), 0.2, (-1.9, 0.7, 0.2))]
    ):
        box = TrafficBox("car", np.array(middle), np.array([4.0, 1.6, 1.5]), yaw)
        write_scan(tmp_path / "velodyne" / "0003" / f"{frame:06d}.bin", apply_T(box.T_scan_box, np.array([corner])))
    return tmp_path


def test_the_tracking_layout_gives_things_over_time(sequence: Path):
    assert [(scan.name, scan.boxes[0].track) for scan in read_scans(sequence)] == [
        ("0003/000000", 5),
        ("0003/000001", 5),
    ]
    ((name, views),) = read_tracks(sequence).items()
    assert name == "0003/5_car"
    assert [len(points) for points, _ in views] == [1, 1]
    whole = accumulated(views, 1)
    # In the second scan the car is turned by 0.2: its front left corner, seen in the first, goes with it.
    ahead, left = np.array([np.cos(0.2), np.sin(0.2), 0.0]), np.array([-np.sin(0.2), np.cos(0.2), 0.0])
    expected = np.array([14.27, 3.0, -0.78]) + np.array([1.9 * ahead + 0.7 * left, -1.9 * ahead + 0.7 * left])
    np.testing.assert_allclose(whole, expected, atol=2e-4)
    assert len(accumulated(views, 1, reach=0)) == 1


def test_scans_and_tracks_may_be_npz(tmp_path: Path):
    boxes = np.array([[5.0, 1, -1, 4, 1.6, 1.5, 0.3], [9.0, 1, -1, 30, 2.5, 3.5, 0.0]])
    points = np.array([[5.0, 1, -1, 0.5], [9.0, 1, -1, 0.7]])
    np.savez(tmp_path / "b.npz", points=points, boxes=boxes, classes=np.array(["Van", "Tram"]))
    np.savez(tmp_path / "t_cyclist.npz", frames=[3, 4], counts=[1, 1], points=points, boxes=boxes)
    (scan,) = read_scans(tmp_path)
    assert ([box.category for box in scan.boxes], scan.boxes[0].yaw_rad) == (["van", "tram"], 0.3)
    np.testing.assert_allclose(scan.intensity, [0.5, 0.7])
    ((name, views),) = read_tracks(tmp_path).items()
    assert (name, views[1][1].category, views[1][0].tolist()) == ("t_cyclist", "cyclist", [[9.0, 1.0, -1.0]])


@pytest.mark.parametrize("rows", [120, 123])  # 120 points of five numbers are a whole number of points of four, too
def test_points_of_five_numbers_as_nuscenes_has_them_are_told(tmp_path: Path, rows: int):
    rng = np.random.default_rng(0)
    five = np.column_stack([rng.uniform(-40, 40, (rows, 3)), rng.integers(0, 255, rows), np.arange(rows) % 32])
    five.astype("<f4").tofile(tmp_path / "lidar.pcd.bin")
    with pytest.raises(UnreadableFile, match=r"five a point, nuScenes' x, y, z, intensity, ring: save"):
        read_bin(tmp_path / "lidar.pcd.bin")


@pytest.mark.parametrize(
    ("columns", "kind", "words"),
    [
        (3, "<f4", "make no sense as these"),
        (6, "<f4", "make no sense as these"),
        (4, "<f8", "make no sense as these"),
        (4, ">f4", "make no sense as these"),
        (7, "<f4", "it is cut short, or its points hold more or fewer numbers"),
    ],
)
def test_values_of_another_layout_are_refused(tmp_path: Path, columns: int, kind: str, words: str):
    values = np.random.default_rng(0).uniform(-40, 40, (399 if columns == 7 else 400, columns)).astype(np.float32)
    values[:, 3:] = np.abs(values[:, 3:])
    values.astype(kind).tofile(tmp_path / "a.bin")
    with pytest.raises(UnreadableFile, match=words):
        read_bin(tmp_path / "a.bin")


def test_a_bin_keeps_zeros_and_nan_and_the_unit_that_it_has(tmp_path: Path):
    rows = np.array([[0, 0, 0, 0], [np.nan, 1, 2, 0.5], [61_000, -2000, 1700, 255], [1.5, -2.5, 0.25, -1]], "<f4")
    rows.tofile(tmp_path / "a.bin")
    points, intensity = read_bin(tmp_path / "a.bin")
    np.testing.assert_array_equal(points, rows[:, :3])
    np.testing.assert_array_equal(intensity, rows[:, 3])


def test_what_is_no_scan_is_refused(tmp_path: Path, objects: Path):
    with pytest.raises(UnreadableFile, match="holds no scans"):
        list(read_scans(tmp_path / "nowhere"))
    with pytest.raises(InvalidOption, match="limit is 0"):
        list(read_scans(objects, limit=0))
    broken = tmp_path / "broken.bin"
    broken.write_bytes(b"12345")
    with pytest.raises(UnreadableFile, match="5 bytes; a KITTI scan has 16 a point"):
        read_bin(broken)
    with pytest.raises(UnreadableFile, match=r"gone\.bin cannot be read"):
        read_bin(tmp_path / "gone.bin")
    broken.write_bytes(b"")
    with pytest.raises(UnreadableFile, match=r"broken\.bin has 0 bytes"):
        read_bin(broken)
    (objects / "training" / "calib" / "000007.txt").write_text("R0_rect: 1 2 3\n")
    with pytest.raises(UnreadableFile, match=r"000007\.txt is no calibration"):
        list(read_scans(objects))
    odd = tmp_path / "odd"
    odd.mkdir()
    np.savez(odd / "x.npz", points=np.zeros((3, 2)), boxes=np.zeros((1, 7)), classes=np.array(["Car"]))
    with pytest.raises(UnreadableFile, match=r"x\.npz has points \(3, 2\)"):
        list(read_scans(odd))
