"""Which files are meshes of which class, split and size: nothing is loaded here, so empty files do."""

import zlib
from pathlib import Path

import numpy as np
import pytest

from gfp_grasp.datasets import layout_of, read_dataset
from gfp_grasp.errors import UnreadableFile
from gfp_grasp.primitives import PrimitiveLibrary

SPLITS = ("train", "val", "test")


def _touch(root: Path, *names: str) -> Path:
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()
    return root


def _everything(root: Path, **options) -> dict[str, list]:
    return {split: list(read_dataset(root, split, **options)) for split in SPLITS}


def _names(root: Path, **options) -> list[str]:
    return sorted(source.name for sources in _everything(root, **options).values() for source in sources)


def test_a_folder_holds_classes_in_folders_and_in_names(tmp_path: Path) -> None:
    root = _touch(
        tmp_path, "mug__a.ply", "Mug__b.OBJ", "jar/c.stl", "jar/d__e.off", "jar/deep/f.ply", "mug__.ply", "plain.ply",
        "notes.txt", "jar/notes.md", "box__a__b.glb",
    )  # fmt: skip
    assert layout_of(root) == "folder"
    assert _names(root) == ["Mug-b", "box-a__b", "jar-c", "jar-d__e", "mug-a"]
    sources = [source for found in _everything(root).values() for source in found]
    categories = {source.name: source.category for source in sources}
    assert categories == {"Mug-b": "Mug", "box-a__b": "box", "jar-c": "jar", "jar-d__e": "jar", "mug-a": "mug"}
    assert {source.up for source in sources} == {"z"}
    assert {source.height_m for source in sources} == {None}
    assert {source.path for source in sources if source.name == "jar-c"} == {root / "jar" / "c.stl"}


def test_modelnet_is_known_by_its_two_folders_and_shares_its_training_folder(tmp_path: Path) -> None:
    names = [f"pot_{number:04d}" for number in range(40)]
    root = _touch(
        tmp_path, "pot/test/pot_0999.off", "pot/other/pot_1.off", *(f"pot/train/{name}.off" for name in names)
    )
    assert layout_of(root) == "modelnet"
    found = _everything(root)
    val = [name for name in names if zlib.crc32(name.encode()) % 10 == 0]
    assert val
    assert [source.name for source in found["val"]] == val
    assert [source.name for source in found["test"]] == ["pot_0999"]
    assert [source.name for source in found["train"]] == [name for name in names if name not in val]
    assert {source.up for source in found["train"]} == {"z"}


def test_one_in_ten_of_a_folder_is_for_validation_and_one_for_tests(tmp_path: Path) -> None:
    names = [f"m{number}" for number in range(60)]
    found = _everything(_touch(tmp_path, *(f"pot/{name}.ply" for name in names)))
    for split, rests in (("val", {0}), ("test", {1}), ("train", set(range(2, 10)))):
        assert found[split]
        assert {zlib.crc32(source.name.encode()) % 10 for source in found[split]} <= rests
    assert sum(map(len, found.values())) == 60


def test_shapenet_is_known_by_either_of_its_forms_and_lies_on_its_back(tmp_path: Path) -> None:
    root = _touch(
        tmp_path, "03797390/aaa/models/model_normalized.obj", "02880940/bbb/model.obj", "99999999/ccc/model.obj",
        "03797390/aaa/models/other.obj",
    )  # fmt: skip
    assert layout_of(root) == "shapenet"
    sources = [source for found in _everything(root).values() for source in found]
    assert {source.name: source.category for source in sources} == {
        "03797390-aaa": "mug", "02880940-bbb": "bowl", "99999999-ccc": "99999999",
    }  # fmt: skip
    assert {source.up for source in sources} == {"y"}


@pytest.mark.parametrize(
    ("synset", "category"),
    [("02876657", "bottle"), ("02946921", "can"), ("03147509", "cup"), ("03593526", "jar"), ("03797390", "mug")],
)
def test_classes_of_shapenet_have_their_names(tmp_path: Path, synset: str, category: str) -> None:
    root = _touch(tmp_path, f"{synset}/a/model.obj")
    assert [s.category for found in _everything(root).values() for s in found] == [category]


def test_heights_are_drawn_from_the_class_by_the_name_of_the_file(tmp_path: Path) -> None:
    names = [f"stool_{number:04d}" for number in range(60)]
    root = _touch(tmp_path, *(f"stool/train/{name}.off" for name in names))
    heights = {source.name: source.height_m for found in _everything(root).values() for source in found}
    for name, height in heights.items():
        draw = np.clip(np.random.default_rng(zlib.crc32(name.encode())).normal(), -2, 2)
        assert height == pytest.approx(0.15 * np.exp(0.15 * draw))  # a class without a primitive
    assert np.ptp(list(heights.values())) > 0.04


def test_heights_of_a_class_that_has_a_primitive_spread_as_its_members_do(tmp_path: Path) -> None:
    primitive = PrimitiveLibrary.shipped().primitive("mug")
    tall, spread = np.ptp(primitive.vertices[:, 2]), np.sqrt(primitive.log_scale_cov[2, 2])
    root = _touch(tmp_path, *(f"mug/train/mug_{number:04d}.off" for number in range(40)))
    for source in (source for found in _everything(root).values() for source in found):
        draw = np.clip(np.random.default_rng(zlib.crc32(source.name.encode())).normal(), -2, 2)
        assert source.height_m == pytest.approx(tall * np.exp(spread * draw), rel=1e-6)


def test_only_the_classes_that_are_asked_for_come_in_the_order_of_their_names(tmp_path: Path) -> None:
    root = _touch(tmp_path, *(f"{c}/train/{c}_{n:02d}.off" for c in ("pot", "jar", "cup") for n in (3, 1, 2)))
    found = [s for split in SPLITS for s in read_dataset(root, split, classes=["cup", "pot"], layout="modelnet")]
    assert {source.category for source in found} == {"cup", "pot"}
    assert len(found) == 6
    train = [source.name for source in read_dataset(root, "train")]
    assert train == sorted(train)


def test_a_file_or_an_empty_folder_is_no_data_set(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFile, match="no folder"):
        layout_of(_touch(tmp_path, "a.ply") / "a.ply")
    with pytest.raises(UnreadableFile, match="holds no mesh"):
        layout_of(tmp_path)
