"""ModelNet40's classes of the paper from a small tree, and whole shapes in metres."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfp_grasp.datasets import read_modelnet, whole_shapes
from gfp_grasp.errors import InvalidMesh, InvalidOption, UnreadableFile
from gfp_grasp.primitives import PrimitiveLibrary

# A wedge, 4 long, 2 wide and 1.5 high: no two of its sides are alike.
CORNERS = np.array([[0, 0, 0], [4, 0, 0], [4, 2, 0], [0, 2, 0], [0, 0, 1.5], [0, 2, 1.5]], dtype=float)
FACES = [(0, 2, 1), (0, 3, 2), (0, 1, 4), (3, 5, 2), (0, 4, 5), (0, 5, 3), (1, 2, 5), (1, 5, 4)]
# As it stands where its longest side is 1.
RESTED = (CORNERS - (2, 1, 0)) / 4


def write_off(path: Path, corners: np.ndarray, *, one_line: bool) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [" ".join(f"{value:.9g}" for value in corner) for corner in corners]
    rows += [f"3 {a} {b} {c}" for a, b, c in FACES]
    path.write_text(f"OFF{'' if one_line else chr(10)}{len(corners)} {len(FACES)} 0\n" + "\n".join(rows) + "\n")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Two cars and a person, each in a unit and a place of its own, and a chair."""
    root = tmp_path / "ModelNet40"
    write_off(root / "car" / "train" / "car_0001.off", 300 * CORNERS + (7, -5, 90), one_line=True)
    write_off(root / "car" / "test" / "car_0198.off", CORNERS, one_line=False)
    write_off(root / "car" / "test" / "car_0199.off", CORNERS[:, [1, 0, 2]] * (1, -1, 1), one_line=True)
    write_off(root / "person" / "test" / "person_0089.off", 0.01 * CORNERS, one_line=True)
    write_off(root / "chair" / "train" / "chair_0001.off", CORNERS, one_line=False)
    return root


def places(mesh: trimesh.Trimesh) -> np.ndarray:
    vertices = np.asarray(mesh.vertices)
    return vertices[np.lexsort(vertices.round(6).T)]


def sorted_places(corners: np.ndarray) -> np.ndarray:
    return corners[np.lexsort(corners.round(6).T)]


def test_longest_sides_are_one_whatever_unit_place_and_header_a_file_has(tree: Path) -> None:
    found = read_modelnet(tree)
    assert {category: len(meshes) for category, meshes in found.items()} == {"car": 1}
    (car,) = found["car"]
    np.testing.assert_allclose(places(car), sorted_places(RESTED), atol=1e-7)
    assert car.is_volume


def test_the_data_sets_own_split_is_kept_and_a_person_is_a_pedestrian(tree: Path) -> None:
    found = read_modelnet(tree, "test")
    assert {category: len(meshes) for category, meshes in found.items()} == {"car": 2, "pedestrian": 1}
    np.testing.assert_allclose(places(found["car"][0]), sorted_places(RESTED), atol=1e-7)
    np.testing.assert_allclose(found["car"][1].extents, (0.5, 1.0, 0.375), atol=1e-7)
    assert list(read_modelnet(tree, "test", classes=["pedestrian"])) == ["pedestrian"]
    assert [len(meshes) for meshes in read_modelnet(tree, "test", limit=1).values()] == [1, 1]


def test_a_stated_length_of_the_class_is_that_of_the_longest_side(tree: Path) -> None:
    (car,) = read_modelnet(tree, classes=["car"], lengths_m={"car": 4.4})["car"]
    np.testing.assert_allclose(places(car), sorted_places(4.4 * RESTED), atol=1e-6)


def test_whole_shapes_of_modelnet_are_as_long_as_the_mean_of_their_class(tree: Path) -> None:
    found = whole_shapes(tree)
    assert {category: len(meshes) for category, meshes in found.items()} == {"car": 2, "pedestrian": 1}
    for category, meshes in found.items():
        mean = np.ptp(PrimitiveLibrary.shipped().primitive(category).vertices, axis=0).max()
        assert [mesh.extents.max() for mesh in meshes] == pytest.approx([mean] * len(meshes))


def test_whole_shapes_of_a_plain_folder_keep_their_metres(tmp_path: Path) -> None:
    for number in range(12):  # of which some would be in each split
        write_off(tmp_path / f"van__{number:02d}.off", (1 + 0.1 * number) * CORNERS + (3, 4, 5), one_line=False)
    write_off(tmp_path / "bus" / "one.off", 3 * CORNERS, one_line=True)
    found = whole_shapes(tmp_path)
    assert [len(found[category]) for category in ("bus", "van")] == [1, 12]
    np.testing.assert_allclose(places(found["bus"][0]), sorted_places(12 * RESTED), atol=1e-6)
    assert [mesh.extents[0] for mesh in found["van"]] == pytest.approx(4 + 0.4 * np.arange(12))
    assert len(whole_shapes(tmp_path, limit=5)["van"]) == 5


def test_what_is_no_modelnet_is_refused(tree: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidOption, match="split is 'val'; one of train, test"):
        read_modelnet(tree, "val")
    with pytest.raises(InvalidOption, match="classes are chair; some of bottle, car, cup, pedestrian"):
        read_modelnet(tree, classes=["chair"])
    with pytest.raises(InvalidOption, match="lengths_m has None for pedestrian"):
        read_modelnet(tree, classes=["car", "pedestrian"], lengths_m={"car": 4.4})
    with pytest.raises(InvalidOption, match="limit is 0"):
        read_modelnet(tree, limit=0)
    with pytest.raises(UnreadableFile, match=r"holds none of ModelNet40's cup/train/\*\.off, bottle/train"):
        read_modelnet(tmp_path / "nowhere")
    (tree / "car" / "train" / "car_0002.off").write_text("OFF8 0 0\n")
    with pytest.raises((UnreadableFile, InvalidMesh), match=r"car_0002\.off"):
        read_modelnet(tree)


def test_what_holds_no_whole_shapes_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFile, match="is no folder"):
        whole_shapes(tmp_path / "nowhere")
    with pytest.raises(InvalidOption, match="limit is 0"):
        whole_shapes(tmp_path, limit=0)
    shapenet = tmp_path / "02958343" / "a1" / "models" / "model_normalized.obj"
    shapenet.parent.mkdir(parents=True)
    shapenet.touch()
    with pytest.raises(UnreadableFile, match="has the layout of shapenet"):
        whole_shapes(tmp_path)
