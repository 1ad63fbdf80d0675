"""What a primitive is like, how near it comes to whole meshes, and its pictures."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from PIL import Image
from toy_primitive import toy_cup_primitive

from gfp_grasp.bench import bench_primitives
from gfp_grasp.drawing import draw_modes, draw_primitives
from gfp_grasp.primitives import PrimitiveLibrary, save_primitive, with_parts
from gfp_grasp.types import GenericPrimitive


@pytest.fixture(scope="module")
def toy() -> GenericPrimitive:
    return replace(toy_cup_primitive(), card={"modes": 5, "generalization_mm": 0.7, "build_s": 9})


@pytest.fixture
def library(toy, tmp_path: Path) -> PrimitiveLibrary:
    """Cups of the toy's proportions, and a subcategory that is twice as tall and may hardly change its height."""
    (tmp_path / "gps").mkdir()
    tall = toy.vertices * [1, 1, 2]
    stiff = {"modes": 0 * toy.modes, "log_scale_cov": 1e-8 * np.eye(3)}
    save_primitive(toy, tmp_path / "gps")
    save_primitive(replace(toy, vertices=tall, subcategory="tall", spec=None, **stiff), tmp_path / "gps")
    return PrimitiveLibrary(tmp_path / "gps")


def _write(mesh: trimesh.Trimesh, path: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    mesh.export(path)


def test_each_mesh_gets_the_best_fit_of_its_class_and_figures_come_from_the_cards(toy, library, tmp_path: Path):
    member = trimesh.Trimesh(toy.shape(np.array([0.5, 0, 0, 0, 0]), np.ones(3)), toy.faces, process=False)
    _write(member, tmp_path / "meshes" / "cup__own.ply")
    _write(trimesh.creation.box((0.1, 0.1, 0.1)), tmp_path / "meshes" / "crate__other.ply")
    report = bench_primitives([tmp_path / "meshes"], library=library)
    (fit,) = report["fits"]
    assert (fit["mesh"], fit["category"], fit["primitive"]) == ("own", "cup", "cup")
    assert fit["error_mm"] < 0.3
    assert fit["length_m"] == pytest.approx(member.extents.max(), abs=1e-4)
    assert fit["error_percent"] == pytest.approx(0.1 * fit["error_mm"] / fit["length_m"], rel=0.05)
    assert list(report["rows"]) == ["cup", "cup.tall"]
    assert report["rows"]["cup"]["generalization_mm"] == 0.7
    assert report["rows"]["cup"]["parts"] is None
    files = [path for path in (tmp_path / "gps").iterdir()]
    assert len(files) == 6
    assert report["bytes"] == sum(path.stat().st_size for path in files)


def test_every_class_has_a_panel_and_modes_swing_both_ways(library, tmp_path: Path):
    draw_primitives(library, tmp_path / "all.png")
    draw_modes(library, tmp_path / "modes.png")
    everything = np.asarray(Image.open(tmp_path / "all.png").convert("RGB"))
    assert everything.shape == (300, 6 * 300, 3)
    drawn = [(everything[:, 300 * i : 300 * (i + 1)] < 230).any(axis=2).mean() for i in range(6)]
    assert drawn[0] > 0.2
    assert max(drawn[1:]) == 0
    swings = np.asarray(Image.open(tmp_path / "modes.png").convert("RGB")).astype(int)
    assert swings.shape == (300, 7 * 300, 3)
    down, up = swings[40:, 300:600], swings[40:, 600:900]
    assert np.abs(down - up).max(axis=2).mean() > 5


def test_the_card_of_a_build_has_its_parts_and_their_error(toy, monkeypatch):
    levels = SimpleNamespace(
        parts=toy.parts, merges=np.zeros((0, 2)), errors_m=np.array([[0.004, 0.009], [0.0012345, 0.003]])
    )
    monkeypatch.setattr("gfp_grasp.collision.part_levels", lambda mesh: levels)
    card = with_parts(toy).card
    assert card["parts_error_mm"] == [1.234, 3.0]
    assert card["modes"] == 5
