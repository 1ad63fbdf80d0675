"""Mesh files of several parts, with units of their own, and of programs whose files are not read."""

import json
import sys

import numpy as np
import pytest
import trimesh
from bodies import l_shape

from gfp_grasp.errors import UnreadableFile
from gfp_grasp.meshes import every_suffix, load_mesh

BODY = l_shape()


def gltf(folder, name: str = "body") -> str:
    """A .gltf beside its .bin; returns the name of that."""
    files: dict[str, bytes] = trimesh.Scene([BODY]).export(file_type="gltf")  # pyright: ignore[reportAssignmentType]
    buffers = [key for key in files if key.endswith(".bin")]
    tree = json.loads(files["model.gltf"])
    (folder / "data").mkdir(exist_ok=True)
    for buffer in tree["buffers"]:
        buffer["uri"] = f"data/{buffer['uri']} 1".replace(" ", "%20")
    for key in buffers:
        (folder / "data" / f"{key} 1").write_bytes(files[key])
    (folder / f"{name}.gltf").write_text(json.dumps(tree), encoding="utf-8")
    return buffers[0]


def test_a_gltf_is_read_with_the_buffers_beside_it(tmp_path) -> None:
    gltf(tmp_path)
    mesh = load_mesh(tmp_path / "body.gltf", suffixes=every_suffix())
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(BODY.volume, rel=1e-5)
    np.testing.assert_allclose(mesh.bounds, BODY.bounds, atol=1e-7)


def test_a_gltf_without_its_buffer_names_it(tmp_path) -> None:
    name = gltf(tmp_path)
    (tmp_path / "data" / f"{name} 1").unlink()
    with pytest.raises(UnreadableFile, match=rf"body\.gltf: .*{name}.* cannot be read"):
        load_mesh(tmp_path / "body.gltf", suffixes=every_suffix())


@pytest.mark.parametrize("uri", ["../out.bin", "%2e%2e/out.bin", "/etc/hostname", "data/../../out.bin"])
def test_a_gltf_opens_nothing_outside_of_its_folder(tmp_path, uri: str) -> None:
    inner = tmp_path / "inner"
    inner.mkdir()
    gltf(inner)
    tree = json.loads((inner / "body.gltf").read_text(encoding="utf-8"))
    (tmp_path / "out.bin").write_bytes(next((inner / "data").iterdir()).read_bytes())
    tree["buffers"][0]["uri"] = uri
    (inner / "body.gltf").write_text(json.dumps(tree), encoding="utf-8")
    with pytest.raises(UnreadableFile, match="only files in its own folder are opened"):
        load_mesh(inner / "body.gltf", suffixes=every_suffix())


DAE = """<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>
<unit name="inch" meter="{unit}"/><up_axis>Z_UP</up_axis></asset><library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="a" count="{count}">{places}</float_array><technique_common>
<accessor source="#a" count="{num}" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source><vertices id="v">
<input semantic="POSITION" source="#p"/></vertices><triangles count="{faces}"><input semantic="VERTEX" source="#v"
offset="0"/><p>{corners}</p></triangles></mesh></geometry></library_geometries><library_visual_scenes>
<visual_scene id="s"><node><instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
<scene><instance_visual_scene url="#s"/></scene></COLLADA>"""


@pytest.mark.parametrize("unit_m", [1.0, 0.0254, 0.001])
def test_the_unit_that_a_dae_states_is_heeded(tmp_path, unit_m: float) -> None:
    pytest.importorskip("collada")
    text = DAE.format(
        unit=unit_m,
        count=BODY.vertices.size,
        num=len(BODY.vertices),
        places=" ".join(f"{value / unit_m:.9g}" for value in BODY.vertices.ravel()),
        faces=len(BODY.faces),
        corners=" ".join(map(str, BODY.faces.ravel())),
    )
    (tmp_path / "body.dae").write_text(text, encoding="utf-8")
    mesh = load_mesh(tmp_path / "body.dae", suffixes=every_suffix())
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(BODY.volume, rel=1e-5)


def test_a_3mf_is_in_millimetres_and_a_scale_comes_on_top(tmp_path) -> None:
    pytest.importorskip("lxml")
    BODY.copy().apply_scale(1000).export(tmp_path / "body.3mf")
    mesh = load_mesh(tmp_path / "body.3mf", suffixes=every_suffix())
    np.testing.assert_allclose(mesh.extents, BODY.extents, rtol=1e-5)
    twice = load_mesh(tmp_path / "body.3mf", suffixes=every_suffix(), scale=2.0)
    np.testing.assert_allclose(twice.extents, 2 * BODY.extents, rtol=1e-5)


def test_a_scale_makes_metres_of_millimetres_before_vertices_are_joined(tmp_path) -> None:
    BODY.copy().apply_scale(1000).export(tmp_path / "body.stl")
    mesh = load_mesh(tmp_path / "body.stl", scale=0.001)
    assert mesh.is_volume
    np.testing.assert_allclose(mesh.bounds, BODY.bounds, atol=1e-7)


@pytest.mark.parametrize(
    ("suffix", "way"),
    [(".step", "export triangles"), (".fbx", r"as \.glb or \.obj"), (".dae", r"pip install 'gfp-grasp\[formats\]'")],
)
def test_a_file_that_is_not_read_says_what_to_do(tmp_path, suffix: str, way: str) -> None:
    (tmp_path / f"part{suffix}").write_bytes(b"anything")
    with pytest.raises(UnreadableFile, match=rf"part\{suffix}: suffix .* is not among .*{way}"):
        load_mesh(tmp_path / f"part{suffix}")


def test_trimesh_reads_what_the_extra_brings() -> None:
    if "collada" in sys.modules or pytest.importorskip("collada"):
        assert ".dae" in every_suffix()
