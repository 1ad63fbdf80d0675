"""Meshes come back from files of every format, and what is no mesh is refused by name."""

import time

import numpy as np
import pytest
import trimesh
from bodies import TILTED, TURN

from gfp_grasp.errors import InvalidMesh, UnreadableFile
from gfp_grasp.meshes import SUFFIXES, check_mesh, every_suffix, load, load_mesh


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb", "off"])
def test_a_mesh_comes_back_from_every_format_as_the_volume_it_was(suffix, tmp_path):
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    box.export(tmp_path / f"box.{suffix}")
    back = load_mesh(tmp_path / f"box.{suffix}")
    assert back.is_volume
    assert back.volume == pytest.approx(0.006, rel=1e-6)
    assert len(back.vertices) == 8


def test_the_pieces_of_a_scene_are_placed_and_merged(tmp_path):
    scene = trimesh.Scene()
    for x in (0.0, 1.0):
        scene.add_geometry(
            trimesh.creation.box((0.1, 0.1, 0.1)), transform=trimesh.transformations.translation_matrix([x, 0, 0])
        )
    scene.export(tmp_path / "two.glb")
    np.testing.assert_allclose(
        load_mesh(tmp_path / "two.glb").bounds, [[-0.05, -0.05, -0.05], [1.05, 0.05, 0.05]], atol=1e-7
    )


def test_an_off_file_with_its_counts_on_the_first_line_is_read(tmp_path):
    text = str(trimesh.creation.box((1, 1, 1)).export(file_type="off"))
    assert text.startswith("OFF\n")
    (tmp_path / "box.off").write_text(text.replace("OFF\n", "OFF", 1))
    assert load_mesh(tmp_path / "box.off").volume == pytest.approx(1.0)


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply", "glb", "off"])
@pytest.mark.parametrize(
    "content", [b"", b"nonsense", bytes(range(256)) * 8, b"ply\nformat binary_little_endian 1.0\n", b"OFF\n9 9 9\n"]
)
def test_a_broken_file_is_refused_by_name_within_a_second(suffix, content, tmp_path):
    path = tmp_path / f"broken.{suffix}"
    path.write_bytes(content)
    started = time.perf_counter()
    with pytest.raises((UnreadableFile, InvalidMesh), match="broken"):
        load_mesh(path)
    assert time.perf_counter() - started < 1.0


def test_a_truncated_file_is_refused(tmp_path):
    content = trimesh.creation.icosphere(3).export(file_type="ply")
    (tmp_path / "cut.ply").write_bytes(content[: len(content) // 2])
    with pytest.raises((UnreadableFile, InvalidMesh), match=r"cut\.ply"):
        load_mesh(tmp_path / "cut.ply")


def test_a_missing_file_and_an_unknown_suffix_are_refused(tmp_path):
    with pytest.raises(UnreadableFile, match="cannot be read"):
        load_mesh(tmp_path / "none.ply")
    with pytest.raises(UnreadableFile, match=r"\.obj, \.stl"):
        load_mesh(tmp_path / "mesh.step")


@pytest.mark.parametrize(
    ("vertices", "faces", "word"),
    [
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.zeros((0, 3), int), "0 faces"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]], "flat"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, np.nan]], [[0, 1, 2], [0, 1, 3]], "finite"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 1, 9]], "9"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 1, 4]], "0 to 3 are legal"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 1, -1]], "from -1"),
    ],
)
def test_what_is_not_a_mesh_is_refused(vertices, faces, word):
    with pytest.raises(InvalidMesh, match=word):
        check_mesh(trimesh.Trimesh(vertices, faces, process=False, validate=False))
    with pytest.raises(InvalidMesh, match="ndarray"):
        check_mesh(np.zeros((3, 3)))  # pyright: ignore[reportArgumentType]


def test_a_file_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(load, "LARGEST_BYTES", 1000)
    trimesh.creation.icosphere(3).export(tmp_path / "large.ply")
    with pytest.raises(UnreadableFile, match=r"large\.ply has \d{5,} bytes; 1 to 1000 are read"):
        load_mesh(tmp_path / "large.ply")


def test_suffixes_are_those_of_files_with_faces():
    assert set(SUFFIXES) < set(every_suffix())
    assert not {".xyz", ".stl_ascii"} & set(every_suffix())
    assert list(every_suffix()) == sorted(every_suffix())


@pytest.mark.parametrize(("extent_m", "is_legal"), [(9e5, True), (1.1e6, False)])
def test_a_mesh_of_a_thousand_kilometres_has_stray_vertices_or_no_unit(extent_m: float, is_legal: bool):
    mesh = trimesh.creation.box((1, 2, extent_m))
    if is_legal:
        assert check_mesh(mesh) is mesh
    else:
        with pytest.raises(InvalidMesh, match="stray"):
            check_mesh(mesh)


def test_a_thin_plate_is_not_flat_and_a_plane_is():
    plate = trimesh.creation.box((0.1, 0.1, 1e-6)).apply_transform(TILTED)
    assert check_mesh(plate) is plate
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0], [0.1, 0.2, 0]]) @ TURN.T + TILTED[:3, 3]
    plane = trimesh.Trimesh(corners, [[0, 1, 2], [1, 3, 2]], process=False)
    with pytest.raises(InvalidMesh, match="flat"):
        check_mesh(plane)
