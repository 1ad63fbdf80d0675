"""`gfp-grasp decompose`: every option arrives, what is written has the right walls, and the figures are in mm."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from recorded_calls import Recorder, recorded, run

from gfp_grasp.collision import DecomposeConfig
from gfp_grasp.meshes import every_suffix
from gfp_grasp.types import CollisionMesh, ConvexPart


@pytest.fixture
def box() -> trimesh.Trimesh:
    return trimesh.creation.box((0.05, 0.04, 0.03))


@pytest.fixture
def split(box: trimesh.Trimesh, monkeypatch: pytest.MonkeyPatch) -> Recorder:
    """Stands for the decomposition, which finds the box and its shifted copy."""
    parts = (ConvexPart(box.vertices, box.faces), ConvexPart(box.vertices + 1.0, box.faces))
    answer = CollisionMesh(parts, (0.00012, 0.00345, 0.00678), "coacd", 1.26, {"cached": False})
    return recorded(monkeypatch, "gfp_grasp.collision.decompose", answer)


@pytest.fixture
def export(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    return recorded(monkeypatch, "gfp_grasp.export.export_completion")


def test_decompose_hands_on_every_option_and_tells_parts_and_errors(
    box: trimesh.Trimesh, split: Recorder, export: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    box.export(tmp_path / "my box.stl")
    out = tmp_path / "box.xml"
    words = "--engine vhacd --threshold 0.2 --max-parts 7 --time-limit 45 --no-cache --seed 6 --files"
    assert run("decompose", tmp_path / "my box.stl", "-o", out, *words.split()) == 0
    (solid,), named = split.only
    assert named.pop("progress")
    assert named["config"] == DecomposeConfig(
        threshold=0.2, max_convex_hull=7, time_limit_s=45.0, engine="vhacd", cache=False, seed=6
    )
    assert solid.volume == pytest.approx(0.05 * 0.04 * 0.03)
    (written, parts, path), named = export.only
    assert written is solid
    assert path == out
    assert [part.bounds[0, 2] for part in parts] == pytest.approx([-0.015, 0.985])
    assert named == {"name": "my_box", "shell_thickness_m": None, "assets": "files"}
    told = "2 parts in 1.3 s; off the mesh by 0.12 mm on average, 3.45 mm for 95 %, 6.78 mm at most"
    assert " ".join(capsys.readouterr().out.split()) == told


def test_defaults_of_decompose_are_those_of_the_library(
    box: trimesh.Trimesh, split: Recorder, export: Recorder, tmp_path: Path
) -> None:
    box.export(tmp_path / "box.stl")
    assert run("decompose", tmp_path / "box.stl", "-o", tmp_path / "box.urdf") == 0
    assert split.only[1]["config"] == DecomposeConfig(time_limit_s=300.0)
    assert export.only[1]["assets"] == "embedded"


def test_a_mesh_that_is_inside_out_is_turned(
    box: trimesh.Trimesh, split: Recorder, export: Recorder, tmp_path: Path
) -> None:
    box.invert()
    box.export(tmp_path / "box.stl")
    assert run("decompose", tmp_path / "box.stl", "-o", tmp_path / "box.xml") == 0
    assert split.only[0][0].volume == pytest.approx(0.05 * 0.04 * 0.03)
    assert export.only[1]["shell_thickness_m"] is None


def test_any_mesh_that_trimesh_reads_is_taken(split: Recorder, export: Recorder, box: trimesh.Trimesh) -> None:
    read: list[tuple[str, ...]] = []

    def load(path: Path, *, suffixes: tuple[str, ...] = ()) -> trimesh.Trimesh:
        read.append((path.name, *suffixes))
        return box

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gfp_grasp.meshes.load_mesh", load)
        assert run("decompose box.xaml -o box.xml") == 0
    assert read == [("box.xaml", *every_suffix())]


def test_an_open_mesh_has_the_mass_of_a_shell_and_that_is_told(
    box: trimesh.Trimesh, split: Recorder, export: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    box.update_faces(np.arange(12) > 1)
    box.export(tmp_path / "box.off")
    assert run("decompose", tmp_path / "box.off", "-o", tmp_path / "box.xml") == 0
    assert export.only[1]["shell_thickness_m"] == 0.002
    assert "2 mm shell" in capsys.readouterr().err


def test_a_mesh_file_gets_all_parts_as_one_mesh(
    box: trimesh.Trimesh, split: Recorder, export: Recorder, tmp_path: Path
) -> None:
    box.export(tmp_path / "box.stl")
    assert run("decompose", tmp_path / "box.stl", "-o", tmp_path / "parts.ply") == 0
    (joined, parts, path), named = export.only
    assert len(joined.vertices) == 16
    assert len(parts) == 2
    assert (path, named) == (tmp_path / "parts.ply", {})
