"""A scene of the demonstration: its objects, its figures and its files."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from PIL import Image
from toy_completions import toy_completion, toy_errors, toy_fit, toy_image, toy_item, toy_outcome

from gfp_grasp.demo.demo_scene import (
    CLUTTER,
    HEADINGS,
    SINGLE,
    figures_row,
    load_asset,
    pick_objects,
    read_parts,
    write_parts,
    write_scene,
)
from gfp_grasp.scenes import SceneObject, World, load_objects
from gfp_grasp.types import TrueObject


def test_objects_are_at_their_places_of_the_held_out_split_and_another_seed_moves_on() -> None:
    splits = {family: load_objects(family, split="test") for family in ("mug", "bottle", "box", "wine_glass")}
    names = [source.name for source in pick_objects(CLUTTER)]
    assert CLUTTER == (("mug", 7), ("bottle", 8), ("box", 3), ("wine_glass", 6))
    assert names == [splits[family][place].name for family, place in CLUTTER]
    assert [source.name for source in pick_objects(SINGLE)] == [splits["mug"][4].name]
    (moved,) = pick_objects(SINGLE, seed=3)
    assert moved.name == splits["mug"][7].name
    (around,) = pick_objects(SINGLE, seed=len(splits["mug"]))
    assert around.name == splits["mug"][4].name


def test_an_object_whose_parts_do_not_ship_is_decomposed(monkeypatch: pytest.MonkeyPatch) -> None:
    class Source:
        def load_mesh(self) -> trimesh.Trimesh:
            return trimesh.creation.box()

        def load(self, decompose: object) -> object:
            return decompose

    assert load_asset(Source()) is None  # type: ignore[arg-type]


def test_parts_of_several_objects_are_told_apart(tmp_path: Path) -> None:
    assert read_parts(tmp_path / "none.npz") == {}
    things = []
    for scale in (1.0, 2.0):
        completion = toy_completion()
        mesh = completion.mesh.copy()
        mesh.apply_scale(scale)
        things.append(TrueObject("box", "", mesh, completion.collision, 0.1, 0.5))
    write_parts(things, tmp_path / "parts.npz")
    found = list(read_parts(tmp_path / "parts.npz").values())
    assert [(len(known.parts), known.made_by, known.seconds) for known in found] == [(2, "cuts", 0.0)] * 2
    assert found[0].error_m == (0.00012, 0.00345, 0.00678)


def test_a_row_has_the_figures_of_its_headings() -> None:
    completion = toy_completion(fit=toy_fit(), scores={"mug": 0.876, "cup": 0.1})
    item = toy_item("red", completion=completion, errors=toy_errors())
    assert dict(zip(HEADINGS, figures_row(item), strict=True)) == {
        "object": "red",
        "class": "mug 0.88",
        "fit, mm": "2.3",
        "CD, mm": "4.2",
        "F": "0.88",
        "parts": "2",
        "grasps": "3",
        "best grasp": "not tried",
        "complete, s": "1.2",
        "plan, s": "0.1",
    }
    slipped = toy_item(outcome=toy_outcome(False, "slipped_on_lift"))
    assert figures_row(slipped)[1:5] == ("mug", "", "?", "?")
    assert figures_row(slipped)[7] == "slipped on lift"
    assert figures_row(toy_item(num_grasps=0))[7] == "none found"


@pytest.fixture
def stage() -> World:
    completion = toy_completion((0.0, 0.0, 0.0))
    parts = completion.collision.parts
    T = np.eye(4)
    T[2, 3] = 0.05
    return World([SceneObject("mug", parts, completion.mesh, T, 0.2, 0.5)])


def test_a_scene_s_folder_holds_pictures_meshes_simulator_scenes_and_figures(tmp_path: Path, stage: World) -> None:
    frames = [np.full((6, 8, 3), 40 * k, np.uint8) for k in range(3)]
    items = (toy_item("a", num_grasps=0), toy_item("b", outcome=toy_outcome(), world="true object"))
    folder = tmp_path / "deep" / "scene"
    made = write_scene("T", "text", items, folder, image=toy_image(), frames=frames, stages={"true": stage})
    assert (made.title, made.text, made.items, made.folder) == ("T", "text", items, folder)
    assert list(made.pictures) == ["depth.png", "grasp.gif"]
    assert made.pictures["grasp.gif"] == "The best grasp on b, tried on the true object: held."
    files = [f"{name}_{kind}" for name in "ab" for kind in ("cloud.ply", "completed.glb", "completed.xml")]
    names = {path.name for path in folder.iterdir()}
    assert names == {*files, "depth.png", "grasp.gif", "scene_true.xml", "figures.json"}
    cloud = trimesh.load(folder / "a_cloud.ply")
    np.testing.assert_allclose(cloud.vertices, items[0].completion.detection.cloud.points, atol=1e-6)  # type: ignore[union-attr]
    assert Image.open(folder / "depth.png").size == (32, 24)
    figures = json.loads((folder / "figures.json").read_text())
    assert [row["object"] for row in figures] == ["a", "b"]
    assert (folder / "figures.json").read_text().startswith('[\n {\n  "object": "a",')
    mujoco.MjModel.from_xml_path(str(folder / "scene_true.xml"))  # pyright: ignore[reportAttributeAccessIssue]


def test_a_bare_cloud_without_a_film_has_no_pictures_and_may_be_written_twice(tmp_path: Path) -> None:
    for _ in range(2):
        made = write_scene("T", "", (toy_item(),), tmp_path, image=None, frames=[], stages={})
    assert made.pictures == {}
    assert not list(tmp_path.glob("*.png")) + list(tmp_path.glob("*.gif")) + list(tmp_path.glob("scene_*"))
