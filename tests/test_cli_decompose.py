"""`gfp-grasp decompose`: every option arrives, what is written has the right walls, and the figures are in mm."""

import re
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
    words = "--engine vhacd --threshold 0.2 --max-parts 7 --time-limit 45 --no-cache --seed 6 --files --density 400"
    assert run("decompose", tmp_path / "my box.stl", "-o", out, *words.split()) == 0
    (solid,), named = split.only
    assert named.pop("progress")
    left_s = named["config"].time_limit_s
    assert 30 < left_s < 45  # what reading and repairing has left of it
    assert named["config"] == DecomposeConfig(
        threshold=0.2, max_convex_hull=7, time_limit_s=left_s, engine="vhacd", cache=False, seed=6
    )
    assert solid.volume == pytest.approx(0.05 * 0.04 * 0.03)
    (written, parts, path), named = export.only
    assert written is solid
    assert solid.is_volume
    assert path == out
    assert [part.bounds[0, 2] for part in parts] == pytest.approx([-0.015, 0.985])
    assert named == {"name": "my_box", "density": 400.0, "shell_thickness_m": None, "assets": "files"}
    told = "2 parts in 1.3 s; off the mesh by 0.12 mm on average, 3.45 mm for 95 %, 6.78 mm at most; 0.024 kg"
    assert " ".join(capsys.readouterr().out.split()) == told


def test_defaults_of_decompose_are_those_of_the_library(
    box: trimesh.Trimesh, split: Recorder, export: Recorder, tmp_path: Path
) -> None:
    box.export(tmp_path / "box.stl")
    assert run("decompose", tmp_path / "box.stl", "-o", tmp_path / "box.urdf") == 0
    used = split.only[1]["config"]
    assert used == DecomposeConfig(time_limit_s=used.time_limit_s)
    assert 250 < used.time_limit_s < 300
    assert export.only[1]["assets"] == "embedded"
    assert export.only[1]["density"] == 1000.0


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

    def load(path: Path, *, suffixes: tuple[str, ...] = (), scale: float) -> trimesh.Trimesh:
        read.append((path.name, *suffixes))
        assert scale == 1.0
        return box

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gfp_grasp.meshes.load_mesh", load)
        assert run("decompose box.xaml -o box.xml") == 0
    assert read == [("box.xaml", *every_suffix())]


def test_an_open_mesh_has_the_mass_of_a_shell_and_that_is_told(
    split: Recorder, export: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cup = trimesh.creation.cylinder(0.03, 0.05, sections=24)
    cup.update_faces(cup.face_normals[:, 2] < 0.5)
    cup.export(tmp_path / "box.off")
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


@pytest.mark.parametrize(
    ("extents", "advice"),
    [
        ((80, 60, 40), "the mesh is 80 m long, 0.01 to 1 m are expected: .* by --scale 0.001 if it is in millimetres"),
        ((4, 2, 3), "by --scale 0.0254 if it is in inches, by --scale 0.01 if it is in centimetres"),
        ((8e-5, 6e-5, 4e-5), "by --scale 1000 if it was divided by 1000 once too often"),
    ],
)
def test_a_mesh_that_is_not_in_metres_is_refused_and_a_scale_takes_it(
    split: Recorder, export: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str], extents: tuple, advice: str
) -> None:
    trimesh.creation.box(extents).export(tmp_path / "part.ply")
    words = ("decompose", tmp_path / "part.ply", "-o", tmp_path / "part.urdf")
    assert run(*words) == 2
    assert re.search(advice, capsys.readouterr().err)
    assert not split.calls
    for scale in (1.0, 0.08 / extents[0]):
        assert run(*words, "--scale", scale) == 0
        np.testing.assert_allclose(split.calls[-1][0][0].extents, np.array(extents) * scale, rtol=1e-6)


def test_the_mass_of_bodies_that_touch_and_overlap_is_that_of_the_solid(
    split: Recorder, export: Recorder, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = [trimesh.creation.box(bounds=[[x, 0, 0], [x + 0.2, 0.2, 0.2]]) for x in (0.0, 0.2)]
    third = trimesh.creation.box(bounds=[[0.05, 0.05, 0.15], [0.1, 0.1, 0.32]])  # 5 cm of it lie in the first block
    trimesh.util.concatenate(blocks).export(tmp_path / "two.obj")
    trimesh.util.concatenate(blocks).export(tmp_path / "two.stl")
    trimesh.Scene([*blocks, third]).export(tmp_path / "three.glb")
    expected = {"two.obj": 16.0, "two.stl": 16.0, "three.glb": 16.3}
    for name, mass_kg in expected.items():
        assert run("decompose", tmp_path / name, "-o", tmp_path / "out.urdf") == 0
        (shown, *_), named = export.calls[-1]
        assert named["shell_thickness_m"] is None, name
        assert 1000 * shown.volume == pytest.approx(mass_kg, rel=1e-4), name
        printed = capsys.readouterr()
        assert f"{mass_kg:.3g} kg" in printed.out
        assert "shell" not in printed.err
    shown = export.calls[0][0][0]
    np.testing.assert_allclose(shown.center_mass, (0.2, 0.1, 0.1), atol=1e-9)
    np.testing.assert_allclose(np.diag(shown.moment_inertia), np.array([0.08, 0.2, 0.2]) * 0.016 * 1 / 12 * [1, 1, 1])
