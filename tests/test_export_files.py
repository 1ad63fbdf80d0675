"""Files of an export: their names and bytes, what they leave in place of old ones, and what is refused."""

# MuJoCo's Python stubs leave out what its C module defines.
# pyright: reportAttributeAccessIssue=false

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from exported_bodies import cup

from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.export import SUFFIXES, export_completion, legal_name, needs_parts
from gfp_grasp.types import ConvexPart


@pytest.mark.parametrize(("suffix", "assets"), [(".xml", "embedded"), (".xml", "files"), (".urdf", "embedded")])
def test_the_same_object_gives_the_same_names_and_bytes(tmp_path, suffix, assets):
    mesh, parts = cup()
    written = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        export_completion(mesh, parts, folder / f"cup{suffix}", assets=assets)
        export_completion(mesh, parts, folder / f"cup{suffix}", assets=assets)  # over itself
        written.append({str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()})
    assert written[0] == written[1]
    assert len(written[0]) == (1 if (suffix, assets) == (".xml", "embedded") else 2 + len(parts))


@pytest.mark.parametrize("suffix", [".glb", ".xml", ".urdf"])
def test_relative_paths_are_those_of_the_working_folder(tmp_path, monkeypatch, suffix):
    mesh, parts = cup()
    monkeypatch.chdir(tmp_path)
    path = export_completion(mesh, parts, Path("a") / ".." / "b" / f"cup{suffix}", assets="files")
    assert path.resolve() == tmp_path / "b" / f"cup{suffix}"
    assert path.exists()
    if suffix != ".glb":
        assert mujoco.MjModel.from_xml_path(str(path)).nmesh == 1 + len(parts)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_who_has_an_old_file_open_goes_on_reading_the_old_one(tmp_path, suffix):
    mesh, parts = cup()
    old = export_completion(mesh, parts, tmp_path / f"cup{suffix}").read_bytes()
    with open(tmp_path / f"cup{suffix}", "rb") as reader:
        start = reader.read(100)
        export_completion(mesh.copy().apply_scale(2), parts, tmp_path / f"cup{suffix}", density=500.0)
        assert start + reader.read() == old
    assert (tmp_path / f"cup{suffix}").read_bytes() != old
    assert not list(tmp_path.glob(".*"))


def test_an_export_that_is_refused_leaves_what_was_there(tmp_path):
    mesh, parts = cup()
    export_completion(mesh, parts, tmp_path / "cup.urdf")
    before = {file: file.read_bytes() for file in tmp_path.rglob("*.*")}
    flat = trimesh.creation.box((0.05, 0.05, 1e-9))
    with pytest.raises(InvalidMesh, match="part 2 of 3"):
        export_completion(mesh, [*parts[:2], flat], tmp_path / "cup.urdf")
    assert {file: file.read_bytes() for file in tmp_path.rglob("*.*")} == before


def test_a_place_that_cannot_be_written_to_keeps_no_remains(tmp_path):
    mesh, parts = cup()
    (tmp_path / "cup.xml").mkdir()
    with pytest.raises(OSError, match=r"cup\.xml"):
        export_completion(mesh, parts, tmp_path / "cup.xml")
    assert [file.name for file in tmp_path.iterdir()] == ["cup.xml"]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_suffix_in_capitals_spaces_and_new_folders_are_fine(tmp_path, suffix):
    mesh, parts = cup()
    path = export_completion(mesh, parts, tmp_path / "my föld er" / f"a cup{suffix.upper()}")
    assert path.stat().st_size > 500
    if suffix in (".xml", ".urdf"):
        lower = path.rename(path.with_suffix(suffix))  # MuJoCo goes by the suffix
        assert mujoco.MjModel.from_xml_path(str(lower)).ngeom > len(parts)
    else:
        loaded = trimesh.load_mesh(str(path))
        assert loaded.volume == pytest.approx(mesh.volume, rel=1e-4)


def test_urdf_names_its_meshes_by_relative_paths_and_drops_those_of_an_earlier_export(tmp_path):
    mesh, parts = cup()
    export_completion(mesh, parts, tmp_path / "a.urdf")
    (tmp_path / "a_meshes" / "hull_1000.obj").touch()  # as of more than a thousand parts
    path = export_completion(mesh, parts[:2], tmp_path / "a.urdf")
    files = [element.attrib["filename"] for element in ElementTree.parse(path).iter("mesh")]
    assert files == ["a_meshes/visual.obj", "a_meshes/hull_000.obj", "a_meshes/hull_001.obj"]
    assert sorted(f"a_meshes/{file.name}" for file in (tmp_path / "a_meshes").iterdir()) == sorted(files)


def test_up_without_length_is_refused(tmp_path):
    mesh, parts = cup()
    with pytest.raises(InvalidOption, match="up"):
        export_completion(mesh, parts, tmp_path / "cup.xml", up=(0, 0, 0))


def test_formats_say_whether_they_need_parts():
    assert [needs_parts(f"a{suffix}") for suffix in SUFFIXES] == [False, False, False, False, True, True]
    with pytest.raises(InvalidOption, match="no suffix"):
        needs_parts("a")


def test_unknown_suffix_is_refused_with_the_legal_ones(tmp_path):
    mesh, parts = cup()
    with pytest.raises(InvalidOption) as refusal:
        export_completion(mesh, parts, tmp_path / "cup.dae")
    assert all(suffix in str(refusal.value) for suffix in SUFFIXES)


def test_an_open_mesh_needs_a_shell_thickness(tmp_path):
    mesh, parts = cup()
    mesh.update_faces(np.arange(len(mesh.faces)) > 0)
    with pytest.raises(InvalidMesh, match="shell_thickness_m"):
        export_completion(mesh, parts, tmp_path / "cup.xml")
    path = export_completion(mesh, parts, tmp_path / "cup.xml", shell_thickness_m=0.002)
    mujoco.MjModel.from_xml_path(str(path))


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"name": "a/../b"}, InvalidOption),
        ({"name": "tasse_à_café"}, InvalidOption),
        ({"name": ""}, InvalidOption),
        ({"name": "world"}, InvalidOption),
        ({"density": 0.0}, InvalidOption),
        ({"density": 1e-12}, InvalidOption),
        ({"density": 1e6}, InvalidOption),
        ({"assets": "cloud"}, InvalidOption),
        ({"density": float("nan")}, InvalidOption),
        ({"shell_thickness_m": -1.0}, InvalidOption),
        ({"colors": np.zeros((3, 3), np.uint8)}, InvalidOption),
    ],
)
def test_illegal_options_are_refused(tmp_path, options, error):
    mesh, parts = cup()
    with pytest.raises(error):
        export_completion(mesh, parts, tmp_path / "cup.xml", **options)


def test_no_parts_are_refused_where_they_are_needed(tmp_path):
    mesh, _ = cup()
    with pytest.raises(InvalidMesh, match="parts"):
        export_completion(mesh, (), tmp_path / "cup.urdf")


@pytest.mark.parametrize("suffix", [".xml", ".urdf"])
@pytest.mark.parametrize("z", [1e-9, np.nan])
def test_a_part_that_mujoco_would_not_compile_is_refused_by_its_number(tmp_path, suffix, z):
    mesh, parts = cup()
    box = trimesh.creation.box((0.05, 0.05, 1.0))
    bad = ConvexPart(box.vertices * [1, 1, z], box.faces)
    with pytest.raises(InvalidMesh, match="part 5 of 6"):
        export_completion(mesh, [*parts, bad], tmp_path / f"cup{suffix}")


@pytest.mark.parametrize(
    ("text", "name"), [("mug.v2", "mug.v2"), ("tasse à café", "tasse_caf_"), ("world", "world_"), ("", "object")]
)
def test_any_text_makes_a_name_that_compiles(tmp_path, text, name):
    mesh, parts = cup()
    assert legal_name(text) == legal_name(name) == name
    model = mujoco.MjModel.from_xml_path(str(export_completion(mesh, parts, tmp_path / "a.xml", name=legal_name(text))))
    assert model.body(name).mass[0] == pytest.approx(1000 * mesh.volume)
