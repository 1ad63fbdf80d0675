"""The demonstration: its files open, its page is whole and asks nothing of a network, its pictures are true."""

import base64
import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import real_data
import trimesh

from gfp_grasp.assets import data_dir
from gfp_grasp.captures import complete_capture, read_capture
from gfp_grasp.demo import run_demo
from gfp_grasp.demo.demo_scene import (
    CLUTTER,
    FILE,
    HEADINGS,
    ROOM,
    SINGLE,
    DemoScene,
    figures_row,
    load_asset,
    pick_objects,
    read_parts,
    write_parts,
)
from gfp_grasp.demo.jobs import table_frame
from gfp_grasp.demo.page import write_page
from gfp_grasp.drawing import Item
from gfp_grasp.metrics import completion_errors
from gfp_grasp.scenes import mesh_sha256
from gfp_grasp.transforms import apply_T
from gfp_grasp.types import CollisionMesh, ConvexPart, TrueObject


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tuple[DemoScene, ...]]:
    """The shipped capture through the demonstration."""
    out = tmp_path_factory.mktemp("demo")
    return out, run_demo(out, recordings=(Path("sample"),))


@pytest.mark.slow
def test_sample_is_completed_near_its_truth_and_every_file_opens(shown: tuple[Path, tuple[DemoScene, ...]]) -> None:
    out, (scene,) = shown
    (item,) = scene.items
    assert item.completion.mesh.is_volume
    assert item.errors is not None
    assert item.errors.cd_m < 0.012
    assert {path.suffix for path in scene.folder.iterdir()} >= {".png", ".ply", ".glb", ".xml", ".json"}
    for path in scene.folder.glob("*.xml"):
        assert mujoco.MjModel.from_xml_path(str(path)).nbody > 1  # pyright: ignore[reportAttributeAccessIssue]
    for path in scene.folder.glob("*.glb"):
        assert trimesh.load_mesh(path).is_volume
    assert (out / "index.html").is_file()


@pytest.mark.slow
def test_page_holds_all_shapes_and_asks_nothing_of_a_network(shown: tuple[Path, tuple[DemoScene, ...]]) -> None:
    out, (scene,) = shown
    page = (out / "index.html").read_text(encoding="utf-8")
    assert not re.findall(r"(?:https?:)?//[a-z0-9.-]+\.[a-z]{2,}", page)
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    found = re.search(r'<script type="application/json" id="scenes">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    (shapes,) = json.loads(found.group(1))
    (item,) = shapes["items"]
    vertices = np.frombuffer(base64.b64decode(item["completed"]["v"]), dtype="<f4").reshape(-1, 3)
    whole = np.asarray(scene.items[0].completion.mesh.vertices)  # the page turns it so that up is z
    np.testing.assert_allclose(_reach(vertices.astype(float)), _reach(whole), atol=1e-6)
    seen = np.frombuffer(base64.b64decode(item["completed"]["seen"]), dtype="u1")
    np.testing.assert_array_equal(seen.astype(bool), scene.items[0].completion.observed)
    parts = np.frombuffer(base64.b64decode(item["parts"]["part"]), dtype="<u2")
    assert len(np.unique(parts)) == len(scene.items[0].completion.parts)


@pytest.mark.slow
def test_names_cannot_break_out_of_the_page(shown: tuple[Path, tuple[DemoScene, ...]]) -> None:
    _, (scene,) = shown
    hostile = "</script><script>alert(1)</script>"
    item = Item(hostile, scene.items[0].completion)
    page = write_page([DemoScene(hostile, hostile, (item,), scene.folder)], command=hostile, notes=[hostile])
    assert "<script>alert" not in page


@pytest.mark.slow
def test_demo_of_its_own_scenes_completes_all_objects(tmp_path: Path) -> None:
    scenes = clutter, single, room = run_demo(tmp_path)
    assert len(clutter.items) >= len(CLUTTER)
    assert (len(single.items), len(room.items)) == (len(SINGLE), len(ROOM))
    assert "5 of 5 objects stand" in room.pictures["standing.png"]
    assert all(item.completion.mesh.is_volume for scene in scenes for item in scene.items)
    for scene in scenes:
        assert "depth.png" in scene.pictures
        for path in scene.folder.glob("*.xml"):
            mujoco.MjModel.from_xml_path(str(path))  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "right"), [("mug_red", {"mug"}), ("bottle_mustard", {"bottle", "spray_bottle"})])
def test_demo_runs_on_real_captures(tmp_path: Path, name: str, right: set[str]) -> None:
    (scene,) = run_demo(tmp_path, recordings=(real_data.folder() / "captures" / f"{name}.npz",))
    (item,) = scene.items
    assert item.completion.category in right
    assert item.completion.mesh.is_volume
    if item.truth is not None:
        assert completion_errors(item.completion.mesh, item.truth, rng=np.random.default_rng(0)).cd_m < 0.02


def test_shipped_parts_belong_to_the_demo_s_objects() -> None:
    shipped = read_parts(data_dir("sim_scenes") / FILE)
    for source in pick_objects((*CLUTTER, *SINGLE)):
        assert mesh_sha256(source.load_mesh()) in shipped, f"{source.name} has changed: run `make quickstart`"


def test_asset_with_shipped_parts_needs_no_decomposition(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(*args: object, **kwargs: object) -> None:
        raise AssertionError("decomposed")

    monkeypatch.setattr("gfp_grasp.scenes.objects._decompose", never)
    (source,) = pick_objects(SINGLE)
    assert len(load_asset(source).collision.parts) > 1


def test_parts_come_back_from_their_file(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    part = ConvexPart(box.vertices, box.faces)
    thing = TrueObject("box", "", box, CollisionMesh((part, part), (0.1, 0.2, 0.3), "coacd", 1.0), 0.1, 0.5)
    write_parts([thing], tmp_path / "parts.npz")
    (found,) = read_parts(tmp_path / "parts.npz").values()
    assert found.error_m == (0.1, 0.2, 0.3)
    for back in found.parts:
        np.testing.assert_allclose(back.vertices, part.vertices, atol=1e-7)
        np.testing.assert_array_equal(back.faces, part.faces)


@pytest.mark.slow
def test_table_frame_stands_the_recording_on_the_table() -> None:
    completions = complete_capture(read_capture("sample"))
    T = table_frame(completions)
    vertices = apply_T(T, completions[0].mesh.vertices)
    np.testing.assert_allclose(T[:3, :3] @ completions[0].detection.up, [0, 0, 1], atol=1e-9)
    assert abs(vertices[:, 2].min()) < 0.01
    np.testing.assert_allclose(vertices.min(axis=0)[:2], -vertices.max(axis=0)[:2], atol=1e-9)
    assert len(figures_row(Item("mug", completions[0]))) == len(HEADINGS)


def _reach(vertices: np.ndarray) -> np.ndarray:
    """Distances (v,) to the first vertex, which no motion changes."""
    return np.linalg.norm(vertices - vertices[0], axis=1)
