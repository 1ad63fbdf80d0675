"""Data sets on disk load as the same samples whatever their layout."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from toy_primitive import toy_cup_primitive

from gfp_grasp.datasets import LAYOUTS, layout_of, read_dataset
from gfp_grasp.errors import InvalidOption, UnreadableFile
from gfp_grasp.primitives import PrimitiveLibrary, save_primitive
from gfp_grasp.scenes import label_of, load_objects, shipped_families
from gfp_grasp.shapes import HOUSEHOLD, MIXTURES, TRAFFIC, make_mixture, make_shape, split_seeds
from gfp_grasp.train.labels import make_labels
from gfp_grasp.train.views import cached_views
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import CategorySpec

SEEDS = split_seeds("mug", "train")[:4]


def _mug(number: int) -> trimesh.Trimesh:
    return make_shape("mug", SEEDS[number]).mesh


def _write(layout: str, root: Path) -> Path:
    """Four mugs and a chair, as the data set would hold them."""
    chair = trimesh.creation.box((0.4, 0.4, 0.8))
    for number in range(4):
        mesh = _mug(number).copy()
        if layout == "modelnet":
            mesh.apply_scale(300.0)  # no unit
            path = root / "mug" / ("test" if number == 3 else "train") / f"mug_{number:04d}.off"
            other = root / "chair" / "train" / "chair_0001.off"
        elif layout == "shapenet":
            mesh.apply_transform(make_T(rotation_about((1, 0, 0), -np.pi / 2), (0, 0, 0)))  # y up
            mesh.apply_scale(1.0 / np.linalg.norm(mesh.extents))
            path = root / "03797390" / f"{number:032x}" / "models" / "model_normalized.obj"
            other = root / "03001627" / f"{9:032x}" / "models" / "model_normalized.obj"
        else:
            path, other = root / f"mug__{number}.ply", root / "chair" / "one.ply"
        for file, content in ((path, mesh), (other, chair)):
            file.parent.mkdir(parents=True, exist_ok=True)
            content.export(file)
    return root


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_is_recognised_and_loads_upright_solids_in_metres(layout: str, tmp_path: Path):
    root = _write(layout, tmp_path)
    assert layout_of(root) == layout
    splits = [read_dataset(root, split, classes=["mug"]) for split in ("train", "val", "test")]
    sources = [source for split in splits for source in split]
    assert len(sources) == len({source.name for source in sources}) == 4
    for source in sources:
        mesh = source.load_mesh()
        number = int(source.name.split("-")[-1].split("_")[-1], 16)
        assert mesh.is_volume
        assert mesh.bounds[0, 2] == pytest.approx(0.0, abs=1e-9)
        assert 0.04 < mesh.extents[2] < 0.2
        if layout == "folder":
            assert mesh.extents == pytest.approx(_mug(number).extents, abs=1e-5)
        # The same mug but for its size: y up has been turned, and nothing is stretched.
        assert mesh.extents / mesh.extents[2] == pytest.approx(_mug(number).extents / _mug(number).extents[2], rel=1e-3)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_gives_views_and_labels_as_procedural_shapes_do(layout: str, tmp_path: Path):
    root = _write(layout, tmp_path / "data")
    views = cached_views("mug", "train", num_views=2, limit=2, folder=tmp_path / "views", data=root)
    again = cached_views("mug", "train", num_views=2, limit=2, folder=tmp_path / "views", data=root)
    assert len(views) == len(again) == 4
    for view, stored in zip(views, again, strict=True):
        assert np.allclose(view.points, stored.points, atol=1e-6)  # the cache is float32
        assert view.family == "mug"
    labels, counts = make_labels("mug", "train", num_views=2, limit=2, runs=tmp_path, data=root)
    assert sum(counts.values()) == 4
    for label in labels:
        assert label.vertices.shape == label.target.shape
        assert np.abs(label.target - label.vertices).max() < 0.05


def test_a_split_holds_and_modelnets_own_test_stays_the_test(tmp_path: Path):
    root = _write("modelnet", tmp_path)
    assert [source.name for source in read_dataset(root, "test")] == ["mug_0003"]
    names = [s.name for split in ("train", "val") for s in read_dataset(root, split)]
    assert sorted(names) == ["chair_0001", "mug_0000", "mug_0001", "mug_0002"]


def test_what_is_no_data_set_is_refused_with_what_is_legal(tmp_path: Path):
    with pytest.raises(UnreadableFile, match="no folder"):
        layout_of(tmp_path / "nowhere")
    with pytest.raises(UnreadableFile, match="ModelNet40"):
        layout_of(tmp_path)
    with pytest.raises(InvalidOption, match="train, val, test"):
        read_dataset(tmp_path, "dev")
    with pytest.raises(InvalidOption, match="modelnet"):
        read_dataset(tmp_path, layout="kitti")
    with pytest.raises(UnreadableFile, match="shapenet"):
        read_dataset(tmp_path, layout="shapenet")


def test_a_mesh_that_cannot_be_made_solid_is_left_out_with_a_warning(tmp_path: Path):
    root = _write("folder", tmp_path / "data")
    trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]]).export(root / "mug__flat.ply")
    with pytest.warns(UserWarning, match="flat is left out"):
        views = [
            view
            for split in ("train", "val", "test")
            for view in cached_views("mug", split, num_views=1, folder=tmp_path / "views", data=root)
        ]
    assert len(views) == 4


def test_a_data_set_calls_a_class_by_what_its_card_says(tmp_path: Path):
    pot = replace(toy_cup_primitive(), category="pot", spec=CategorySpec("pot", names={"shapenet": ("03991062",)}))
    save_primitive(pot, tmp_path / "gps")
    mesh = tmp_path / "data" / "03991062" / "a" / "models" / "model_normalized.obj"
    mesh.parent.mkdir(parents=True)
    _mug(0).export(mesh)
    library = PrimitiveLibrary.with_shipped(tmp_path / "gps")
    split = next(s for s in ("train", "val", "test") if read_dataset(tmp_path / "data", s))
    assert [s.category for s in read_dataset(tmp_path / "data", split, library=library)] == ["pot"]
    assert [s.category for s in read_dataset(tmp_path / "data", split)] == ["03991062"]


def test_names_of_files_say_class_and_name_the_same_way_everywhere(tmp_path: Path):
    for name in ("mug__a.ply", "plain.ply", "mug__.ply", "__b.ply"):
        _mug(0).export(tmp_path / name)
    found = {source.name: source.category for source in load_objects(tmp_path)}
    assert found == {"a": "mug", "plain": "", "mug__": "", "__b": ""}
    splits = [read_dataset(tmp_path, split, layout="folder") for split in ("train", "val", "test")]
    assert [source.name for sources in splits for source in sources] == ["mug-a"]


def test_all_objects_are_those_of_the_classes_that_ship():
    assert shipped_families() == HOUSEHOLD
    assert load_objects("all", "val", limit=25) == load_objects(",".join(HOUSEHOLD), "val", limit=25)
    assert label_of("all") == label_of("household") == ",".join(HOUSEHOLD)


def test_groups_of_families_have_names():
    assert [source.family for source in load_objects("traffic", "test", limit=3)] == list(TRAFFIC[:3])
    assert {source.family for source in load_objects("household", "val")} == set(HOUSEHOLD)
    assert label_of("household") == ",".join(HOUSEHOLD)


def test_things_of_no_class_are_objects_too():
    """They take turns like families, have no class, and each split has others."""
    found = load_objects("apple-like,mug,toy-like", "test", limit=5)
    assert [source.name for source in found] == ["apple-like-0", "mug-7", "toy-like-0", "apple-like-1", "mug-10"]
    assert [source.category for source in found] == ["", "mug", "", "", "mug"]
    np.testing.assert_array_equal(found[2].load_mesh().vertices, make_mixture("toy-like", 0, split="test").vertices)
    others = load_objects("toy-like", "val", limit=1)[0].load_mesh()
    assert not np.allclose(others.extents, found[2].load_mesh().extents, rtol=0.01)
    assert label_of("unknown") == ",".join(MIXTURES)
