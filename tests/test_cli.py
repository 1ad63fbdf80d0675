"""The command line: what it writes, what it refuses, and how."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from gfp_grasp.cli import main
from gfp_grasp.export import SUFFIXES


def run(*arguments: object) -> int:
    """Exit code of the program, run in this process."""
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    return int(stop.value.code or 0)


def test_help_names_every_command_and_loads_no_heavy_library() -> None:
    code = (
        "import sys\nfrom gfp_grasp.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as stop:\n    assert not stop.code\n"
        "assert not {'torch', 'mujoco', 'coacd'} & set(sys.modules), 'heavy'\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    for command in ("demo", "complete", "decompose", "score", "gps", "train", "bench"):
        assert command in done.stdout


def test_module_is_the_program() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "gfp_grasp.cli", "gps", "list"], capture_output=True, text=True, check=True
    )
    for name in ("bottle", "cup", "mug"):
        assert name in done.stdout


def test_a_function_of_the_users_own_is_found_in_the_working_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "parts_of_mine.py").write_text("def find(image, *, up):\n    return []\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    assert run("complete", "sample", "--detector", "parts_of_mine:find", "-o", "a.glb") == 2
    assert "detector 'parts_of_mine:find' found no object" in " ".join(capsys.readouterr().err.split())


@pytest.mark.slow
def test_sample_capture_is_completed_into_every_format(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outputs = [tmp_path / f"mug{suffix}" for suffix in SUFFIXES]
    assert run("complete", "sample", *(word for path in outputs for word in ("-o", path))) == 0
    assert all(path.is_file() for path in outputs)
    mesh = trimesh.load_mesh(tmp_path / "mug.ply")
    assert mesh.is_volume
    assert "mug" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("complete", "nowhere.npz", "-o", "a.glb"), "nowhere.npz cannot be read"),
        (("complete", "sample", "-o", "a.docx"), ".docx"),
        (("complete", "sample", "-o", "a.glb", "--viewpoint", "1,2"), "three numbers"),
        (("complete", "sample", "-o", "a.glb", "--category", "spaceship"), "spaceship"),
        (("decompose", "nowhere.stl", "-o", "a.xml"), "nowhere.stl"),
        (("decompose", "nowhere.docx", "-o", "a.xml"), ".docx"),
        (("decompose", "a.stl", "-o", "a.xml", "--engine", "magic"), "coacd, vhacd"),
        (("decompose", "a.stl", "-o", "a.xml", "--threshold", "2"), "threshold"),
        (("decompose", "a.stl", "-o", "a.xml", "--max-parts", "0"), "max_convex_hull"),
        (("decompose", "a.stl", "-o", "a.xml", "--time-limit", "0"), "time_limit_s"),
        (("score", "--objects", "nowhere"), "nowhere"),
        (("score", "--objects", "cup", "--completers", "magic"), "magic"),
        (("gps", "show", "spaceship"), "spaceship"),
        (("train", "gfpnet", "--variant", "other"), "other"),
        (("demo", "--cloud", "nowhere.ply"), "nowhere.ply"),
        (("demo", "--capture", "nowhere.npz"), "nowhere.npz"),
        (("complete", "sample", "-o", "a.glb", "--viewpoint", "nan,0,0"), "finite"),
        (("complete", "sample", "-o", "a.glb", "--up", "0,0,0"), "no length"),
        (("complete", "sample", "-o", "a.glb", "--support-height", "nan"), "support_height"),
        (("complete", "sample"), "--output"),
        (("complete", "sample", "-o"), "-o"),
        (("complete", "sample", "-o", "a.glb", "--viewpoint"), "--viewpoint"),
        (("complete", "sample", "-o", "a.glb", "--seed", "x"), "--seed"),
        (("complete", "sample", "-o", "a.glb", "--seed", "-1"), "--seed"),
        (("complete", "sample", "-o", "/dev/null/a.glb"), "cannot be written"),
        (("complete", ".", "-o", "a.glb"), "suffix"),
        (("complete", "a\0b.npy", "-o", "a.glb"), "null"),
        (("decompose", "a\0b.stl", "-o", "a.xml"), "null"),
        (("score", "--objects", "."), ""),
        (("bench", "completion", "--objects", "."), ""),
        (("bench", "completion", "--objects", "cup", "--methods", "magic"), "magic"),
        (("bench", "detection", "--data", "nowhere"), "nowhere"),
        (("bench", "registration", "--starts", "magic"), "magic"),
        (("gps", "build", "teapot", "--meshes", "."), ""),
        (("gps", "build", "boat"), "boat"),
        (("gps", "build", "teapot", "--meshes", ".", "--orientation", "sideways"), "sideways"),
        (("gps", "dance"), "dance"),
        (("dance",), "dance"),
    ],
)
def test_refusal_is_one_line_on_stderr_and_exit_code_two(
    arguments: tuple[str, ...],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    lines = capsys.readouterr().err.strip().split("\n")
    assert len(lines) == 1
    assert words in lines[0]
    assert not list(tmp_path.iterdir())


def test_empty_cloud_is_refused_without_a_traceback(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.save(tmp_path / "empty.npy", np.zeros((0, 3)))
    assert run("complete", tmp_path / "empty.npy", "-o", tmp_path / "a.glb") == 2
    assert "Traceback" not in capsys.readouterr().err


def test_file_that_cannot_be_written_is_one_line_and_exit_code_two(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(_: object) -> None:
        raise PermissionError(13, "Permission denied", "mug.glb")

    monkeypatch.setattr("gfp_grasp.captures.read_capture", refuse)
    assert run("complete", "sample", "-o", "mug.glb") == 2
    assert capsys.readouterr().err.strip() == "Permission denied: mug.glb"


@pytest.mark.parametrize("words", [(), ("gps",), ("bench",)])
def test_a_command_without_words_shows_its_help(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert run(*words) == 2
    assert "Usage" in capsys.readouterr().out


@pytest.mark.slow
def test_decompose_takes_an_open_mesh_a_name_with_spaces_and_a_suffix_in_capitals(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.05, 0.04, 0.03))
    box.update_faces(box.face_normals[:, 2] < 0.5)
    box.export(tmp_path / "open bøx.ply")
    assert run("decompose", tmp_path / "open bøx.ply", "-o", tmp_path / "my bøx.XML") == 0
    assert 'body name="open_b_x"' in (tmp_path / "my bøx.XML").read_text(encoding="utf-8")


@pytest.mark.slow
def test_decompose_writes_parts_that_are_convex(tmp_path: Path) -> None:
    trimesh.creation.box((0.05, 0.04, 0.03)).export(tmp_path / "box.stl")
    assert run("decompose", tmp_path / "box.stl", "-o", tmp_path / "parts.ply") == 0
    parts = trimesh.load_mesh(tmp_path / "parts.ply")
    np.testing.assert_allclose(parts.volume, 0.05 * 0.04 * 0.03, rtol=1e-2)


@pytest.mark.slow
def test_meshes_go_into_files_where_that_is_asked_for(tmp_path: Path) -> None:
    trimesh.creation.box((0.05, 0.04, 0.03)).export(tmp_path / "box.stl")
    assert run("decompose", tmp_path / "box.stl", "-o", tmp_path / "box.xml", "--files") == 0
    assert sorted(file.name for file in (tmp_path / "box_meshes").iterdir()) == ["hull_000.obj", "visual.obj"]
    assert run("complete", "sample", "-o", tmp_path / "mug.xml", "--files") == 0
    hulls = list((tmp_path / "mug_meshes").glob("hull_*.obj"))
    assert (tmp_path / "mug.xml").read_text(encoding="utf-8").count('file="mug_meshes/hull_') == len(hulls) > 10


def test_decompose_heeds_its_options_tells_its_stages_and_says_when_the_cache_answered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("GFP_GRASP_CACHE", str(tmp_path / "cache"))
    ring = trimesh.creation.annulus(0.02, 0.05, 0.02, sections=12)
    file = tmp_path / "ring.off"
    ring.export(file)
    words = ("decompose", file, "-o", tmp_path / "ring.xml", "--threshold", 0.3, "--max-parts", 3, "--time-limit", 90)
    said = []
    for more in ((), (), ("--no-cache",)):
        assert run(*words, *more) == 0
        said.append(capsys.readouterr())
    assert ["from the cache" in outputs.out for outputs in said] == [False, True, False]
    assert "of 90 s" in said[0].err
    assert len(list(tmp_path.glob("cache/*.npz"))) == 1
    assert (tmp_path / "ring.xml").read_text(encoding="utf-8").count('type="mesh"') <= 4


@pytest.mark.slow
def test_score_writes_all_trials_of_all_completers(tmp_path: Path) -> None:
    trimesh.creation.cylinder(0.025, 0.12, sections=48).export(tmp_path / "bottle__rod.ply")
    options = ("--views", 1, "--completers", "observed,oracle", "--json", tmp_path / "score.json")
    assert run("score", "--objects", tmp_path / "bottle__rod.ply", *options) == 0
    report = json.loads((tmp_path / "score.json").read_text(encoding="utf-8"))
    assert set(report["completers"]) == {"observed", "oracle"}
    assert len(report["trials"]) == 2
    assert str(tmp_path) not in json.dumps(report)
    for figures in report["completers"].values():
        assert {"attempts", "successes", "success_rate", "ci95", "reasons", "cd_m"} <= set(figures)


@pytest.mark.slow
def test_primitive_is_built_from_a_folder_and_says_how(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    folder, out = tmp_path / "rods", tmp_path / "gps"
    folder.mkdir()
    for number in range(6):
        rod = trimesh.creation.cylinder(rng.uniform(0.02, 0.03), rng.uniform(0.1, 0.14), sections=24)
        rod.subdivide().export(folder / f"rod__{number}.ply")
    assert run("gps", "build", "rod", "--meshes", folder, "--out", out, "--orientation", "upright") == 0
    card = json.loads((out / "rod.json").read_text(encoding="utf-8"))
    assert card["category"] == "rod"
    assert "gps build rod" in card["command"]
    assert str(tmp_path) not in json.dumps(card)
