"""The bench of traffic on things whose truth is known: a box of points that is driven past, completed by hand."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from gfp_grasp.bench import KittiConfig, bench_kitti, kitti
from gfp_grasp.errors import InvalidOption, NotTrained, TooFewPoints
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import CompletedShape

SIZE = np.array([4.0, 1.6, 1.5])
PLACES = [(9.0, 2.0, -0.9, 0.3), (10.0, 2.5, -0.9, 0.4)]  # of the middle, and yaw


def side() -> np.ndarray:
    """(150, 3) m: the left side of a car, in its own frame."""
    x, z = np.meshgrid(np.linspace(-1.9, 1.9, 15), np.linspace(-0.6, 0.7, 10))
    return np.column_stack([x.ravel(), np.full(x.size, 0.75), z.ravel()])


def T_of(place: tuple[float, float, float, float]) -> np.ndarray:
    return make_T(rotation_about((0, 0, 1), place[3]), place[:3])


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A car in two scans of a track, and a van alone, of which a third of the points is too few to count."""
    boxes = np.array([[*place[:3], *SIZE, place[3]] for place in PLACES])
    clouds = [apply_T(T_of(place), side()) for place in PLACES]
    points = np.column_stack([np.concatenate(clouds), np.zeros(300)])
    np.savez(tmp_path / "track_1_car.npz", frames=[0, 1], counts=[150, 150], points=points, boxes=boxes)
    np.savez(tmp_path / "scan_1.npz", points=clouds[0], boxes=boxes[:1], classes=np.array(["Van"]))
    np.savez(tmp_path / "scan_2.npz", points=clouds[0][::3], boxes=boxes[:1], classes=np.array(["Van"]))
    return tmp_path


@pytest.fixture
def completed(monkeypatch: pytest.MonkeyPatch) -> list[SimpleNamespace]:
    """What completes: boxes that are 10 % too long, the second 0.1 m higher, and both turned round."""
    asked: list[SimpleNamespace] = []

    def complete(points, **how):
        asked.append(SimpleNamespace(points=points, **how))
        place = PLACES[0] if np.allclose(points, apply_T(T_of(PLACES[0]), side())) else PLACES[1]
        mesh = trimesh.creation.box(SIZE * (1.1, 1, 1))
        T = T_of(place) @ make_T(rotation_about((0, 0, 1), np.pi), (0, 0, 0.1 * (place is PLACES[1])))
        mesh.apply_transform(T)
        fit = SimpleNamespace(T_world_object=T)
        return SimpleNamespace(mesh=mesh, detection=SimpleNamespace(category="car"), made_by="primitive", fit=fit)

    monkeypatch.setattr(kitti, "complete_to_mesh", complete)
    return asked


def test_things_are_measured_in_their_boxes(tree: Path, completed: list[SimpleNamespace]):
    report = bench_kitti(tree, config=KittiConfig(rows=("gfpnet",)))
    row = report["rows"]["gfpnet"]
    assert (row["things"], row["refused"]) == (3, 0)
    assert row["class_right"] == 1.0  # a van may be taken for a car
    assert row["size_error"] == pytest.approx(0.1 / 3, abs=1e-3)
    assert (row["heading_deg"], row["turned_round"]) == (pytest.approx(0.0, abs=0.1), 1.0)
    # Two boxes that lie on each other but for 0.1 m of height: top and bottom are 0.1 apart, the sides near.
    assert 0.05 < row["consistency_m"] < 0.2
    assert [one["name"] for one in row["each"]] == ["scan_1/0", "track_1_car/0", "track_1_car/1"]
    assert "surface" not in row["each"][0]
    assert row["each"][0]["size_m"] == [4.4, 1.6, 1.5]
    assert row["each"][0]["label_m"] == [4.0, 1.6, 1.5]
    assert set(row["by_class"]) == {"van", "car"}
    assert all(call.category is None for call in completed)
    assert all(call.sensor.name == "lidar" for call in completed)


def test_fidelity_is_the_distance_to_what_all_scans_saw(tree: Path, completed: list[SimpleNamespace]):
    """Of a box, the side that was seen is 0.05 m away, the other far; the cloud itself is at no distance."""
    report = bench_kitti(tree, config=KittiConfig(rows=("partial", "gfpnet")))
    assert report["rows"]["partial"]["fidelity_m"] == 0.0
    assert report["rows"]["partial"]["consistency_m"] == pytest.approx(0.0, abs=1e-4)
    assert 0.4 < report["rows"]["gfpnet"]["fidelity_m"] < 0.9
    # The other way round, a side 0.05 m inside of a box is that far from it, and samples are 0.1 m apart.
    assert report["rows"]["gfpnet"]["seen_m"] == pytest.approx(0.07, abs=0.03)
    assert report["rows"]["gfpnet"]["input_m"] == pytest.approx(0.07, abs=0.03)
    assert 0.1 < report["rows"]["gfpnet"]["mmd_m"] < report["rows"]["partial"]["mmd_m"]


def test_what_is_refused_is_counted_and_told(tree: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(points, **how):
        raise TooFewPoints("no")

    monkeypatch.setattr(kitti, "complete_to_mesh", refuse)
    row = bench_kitti(tree, config=KittiConfig(rows=("gfpnet",)))["rows"]["gfpnet"]
    assert (row["things"], row["refused"]) == (3, 3)
    assert row["each"][0]["refused"] == "TooFewPoints: no"
    assert "class_right" not in row


def test_the_paper_s_rows_are_told_the_class(tree: Path, completed: list[SimpleNamespace]):
    bench_kitti(tree, config=KittiConfig(rows=("told-pcrnet-gfs",)))
    assert [call.category for call in completed] == ["van", "car", "car"]


@pytest.mark.parametrize("row", ["pcn", "pcn-true-box"])
def test_a_peer_is_told_the_label_s_box_if_that_is_its_way(tree: Path, row: str, monkeypatch: pytest.MonkeyPatch):
    """What it is told it fills; what it is not it gives a box of its own that is twice as long."""
    asked = []

    def complete(detection, name, *, box=None):
        asked.append((detection, name, box))
        mesh = trimesh.creation.box(SIZE * (2, 1, 1) if box is None else box.extents)
        place = next(T_of(p) for p in PLACES if np.linalg.norm(detection.cloud.points - p[:3], axis=1).min() < 0.81)
        mesh.apply_transform(place if box is None else box.T_world_box)
        return CompletedShape(mesh, np.zeros(8, dtype=bool), np.full(8, 0.1))

    monkeypatch.setattr("gfp_grasp.peers.complete_by_peer", complete, raising=False)
    monkeypatch.setattr("gfp_grasp.completers.registry.check_trained", lambda name, true_box: None)
    monkeypatch.setattr("gfp_grasp.peers.load_network", lambda name, true_box: None, raising=False)
    found = bench_kitti(tree, config=KittiConfig(rows=(row,)))["rows"][row]
    assert (found["things"], found["refused"]) == (3, 0)
    assert found["size_error"] == pytest.approx(0.0 if row == "pcn-true-box" else 1 / 3, abs=1e-3)
    assert "class_right" not in found  # it says none
    assert found["fidelity_m"] > 0.4
    for detection, name, box in asked:
        assert (name, detection.category, box is None) == ("pcn", "", row == "pcn")
        np.testing.assert_array_equal(detection.cloud.viewpoint, np.zeros(3))


def test_a_peer_without_weights_is_refused_before_anything_is_completed(tree: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("gfp_grasp.peers.catalogue.data_dir", lambda name: tree)
    with pytest.raises(NotTrained, match="gfp-grasp train peer pcn"):
        bench_kitti(tree, config=KittiConfig(rows=("partial", "pcn")))


def test_whole_shapes_of_a_folder_are_matched_with(tree: Path, completed: list[SimpleNamespace], tmp_path: Path):
    """The one shape is a box of 4 x 1.6 x 1.5 m: what is 0.4 m longer is 0.1 or so from it, as far as samples tell."""
    shapes, fewer = tmp_path / "shapes", tmp_path / "fewer"
    for folder, names in ((shapes, ("car", "van")), (fewer, ("car",))):
        folder.mkdir()
        for name in names:
            trimesh.creation.box(SIZE).export(folder / f"{name}__block.ply")
    row = bench_kitti(tree, config=KittiConfig(rows=("gfpnet",), shapes=shapes))["rows"]["gfpnet"]
    own = bench_kitti(tree, config=KittiConfig(rows=("gfpnet",)))["rows"]["gfpnet"]
    assert row["mmd_m"] < 0.2 < own["mmd_m"]
    with pytest.raises(InvalidOption, match="fewer holds no whole shape of van"):
        bench_kitti(tree, config=KittiConfig(rows=("gfpnet",), shapes=fewer))


def test_a_whole_shape_in_the_box_tells_what_can_be_reached(tree: Path, tmp_path: Path):
    """A side was seen; of a block in the box, half as long before it is stretched, most is far from it."""
    shapes = tmp_path / "blocks"
    shapes.mkdir()
    for name in ("car", "van"):
        trimesh.creation.box(SIZE * (0.5, 1, 1)).export(shapes / f"{name}__block.ply")
    row = bench_kitti(tree, config=KittiConfig(rows=("whole-in-box",), shapes=shapes))["rows"]["whole-in-box"]
    assert (row["refused"], row["class_right"]) == (0, 1.0)
    assert row["consistency_m"] == 0.0
    assert 0.4 < row["fidelity_m"] < 0.9
    assert row["seen_m"] == pytest.approx(0.07, abs=0.03)


def test_nonsense_is_refused(tree: Path):
    with pytest.raises(InvalidOption, match="rows are"):
        KittiConfig(rows=("magic",))
    with pytest.raises(InvalidOption, match="frames 1"):
        KittiConfig(frames=1)
    with pytest.raises(InvalidOption, match="no box of a class with at least 200 points"):
        bench_kitti(tree, config=KittiConfig(least_points=200))
