"""The demonstration from beginning to end: its scenes, what it prints, and its page."""

import re
import warnings
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_calls import Recorder, recorded
from rich.console import Console
from toy_completions import toy_item, toy_outcome

from gfp_grasp.assets import data_dir
from gfp_grasp.captures import SAMPLE_FILE, Capture
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.demo import quickstart, run_demo
from gfp_grasp.demo.demo_scene import CLUTTER, FILE, ROOM, SINGLE, DemoScene, pick_objects
from gfp_grasp.scenes import ObjectSource

CONFIG = CompleteConfig(rival_share=0.5)


@pytest.fixture
def console() -> Console:
    return Console(file=StringIO(), width=160, force_terminal=False)


@pytest.fixture
def scene(tmp_path: Path) -> DemoScene:
    items = (toy_item("held", outcome=toy_outcome()), toy_item("lost", outcome=toy_outcome(False, "no_contact")))
    return DemoScene("A scene", "text", (*items, toy_item("last")), tmp_path)


@pytest.fixture
def chosen(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    return recorded(monkeypatch, "gfp_grasp.demo.run.pick_objects", "objects")


def test_its_own_scenes_are_a_clutter_a_single_object_and_a_room(
    scene: DemoScene,
    chosen: Recorder,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    simulated = recorded(monkeypatch, "gfp_grasp.demo.run.simulated_scene", scene)
    room = recorded(monkeypatch, "gfp_grasp.demo.run.room_scene", scene)
    out = tmp_path / "deep" / "out"
    assert run_demo(out, config=CONFIG, seed=7) == (scene, scene, scene)
    assert chosen.calls == [((places,), {"seed": 7}) for places in (CLUTTER, SINGLE, ROOM)]
    named = [call[1] for call in simulated.calls]
    shared = {"config": CONFIG, "seed": 7}
    assert named == [
        {"eye": (0.46, -0.36, 0.56), "folder": out / "clutter", **shared},
        {"eye": (0.40, -0.30, 0.32), "folder": out / "single", **shared},
    ]
    assert [call[0][0] for call in simulated.calls] == ["A clutter of four", "A single mug"]
    assert all(call[0][2] == "objects" for call in simulated.calls)
    assert (room.only[0][0], room.only[0][2], room.only[1]) == ("A room", "objects", {"folder": out / "room", **shared})
    page = (out / "index.html").read_text(encoding="utf-8")
    assert "<code>gfp-grasp demo --seed 7</code>" in page
    assert page.count('<section class="scene"') == 3
    assert capsys.readouterr().out == ""  # without a console
    run_demo(out)
    assert [(call[1]["config"], call[1]["seed"]) for call in simulated.calls[2:]] == [(None, 0)] * 2


def test_recordings_are_shown_in_place_of_them_and_their_warnings_are_told(
    scene: DemoScene, console: Console, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    captures = {Path("far/a.npz"): Capture("a", points=np.eye(3)), Path("b.ply"): Capture("b", points=np.eye(3))}
    monkeypatch.setattr("gfp_grasp.demo.run.read_capture", captures.__getitem__)
    calls: list[Any] = []

    def recorded_scene(capture: Capture, **named: Any) -> DemoScene:
        calls.append((capture, named))
        warnings.warn(f"[of] {capture.name}", UserWarning, stacklevel=2)
        warnings.warn("not for the user", DeprecationWarning, stacklevel=2)
        return scene

    monkeypatch.setattr("gfp_grasp.demo.run.recorded_scene", recorded_scene)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run_demo(tmp_path, recordings=tuple(captures), category="mug", config=CONFIG, seed=3, console=console)
    shared = {"category": "mug", "config": CONFIG, "seed": 3}
    assert calls == [
        (captures[Path("far/a.npz")], {"folder": tmp_path / "a", **shared}),
        (captures[Path("b.ply")], {"folder": tmp_path / "b", **shared}),
    ]
    printed = console.file.getvalue()  # type: ignore[attr-defined]
    notes = [line.strip() for line in printed.splitlines() if line.startswith("note: ")]
    assert notes == ["note: a: [of] a", "note: b: [of] b"]
    assert f"0 s; open {tmp_path / 'index.html'}" in " ".join(printed.split())
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "<code>gfp-grasp demo --capture a.npz --capture b.ply --seed 3</code>" in page
    assert "<p>a: [of] a</p><p>b: [of] b</p>" in page
    assert "not for the user" not in page + printed


def test_figures_are_printed_under_the_title_with_words_at_the_left_and_outcomes_in_colour(
    scene: DemoScene, chosen: Recorder, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    recorded(monkeypatch, "gfp_grasp.demo.run.simulated_scene", scene)
    recorded(monkeypatch, "gfp_grasp.demo.run.room_scene", scene)
    console = Console(file=StringIO(), width=160, force_terminal=True, color_system="standard", _environ={})
    run_demo(tmp_path, console=console)
    printed = console.file.getvalue()  # type: ignore[attr-defined]
    assert "\x1b[32mheld" in printed
    assert "\x1b[31mno contact" in printed
    lines = [re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", line).rstrip() for line in printed.splitlines()]
    at = lines.index("A scene")
    told = [
        " object  class  fit, mm  CD, mm  F  parts  grasps  best grasp  complete, s  plan, s",
        " held    mug                  ?  ?      2       3  held                1.2      0.1",
        " lost    mug                  ?  ?      2       3  no contact          1.2      0.1",
        " last    mug                  ?  ?      2       3  not tried           1.2      0.1",
    ]
    assert [lines[at + 2], *lines[at + 4 : at + 7]] == told
    assert set(lines[at + 3].strip()) == {"─"}


def test_quick_start_makes_the_capture_that_ships_and_the_parts_of_all_objects(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("gfp_grasp.demo.quickstart.data_dir", lambda name: tmp_path / name)
    (tmp_path / "sim_scenes").mkdir()
    written = recorded(monkeypatch, "gfp_grasp.demo.quickstart.write_parts")
    load = ObjectSource.load

    def load_shipped(source: ObjectSource, *, decompose: Any = None) -> Any:
        return source.name if decompose is None else load(source, decompose=decompose)

    monkeypatch.setattr(ObjectSource, "load", load_shipped)
    quickstart.main()
    names = [source.name for source in (*pick_objects(CLUTTER), *pick_objects(SINGLE))]
    assert written.only == ((names, tmp_path / "sim_scenes" / FILE), {})
    with np.load(tmp_path / "sim_scenes" / SAMPLE_FILE) as made, np.load(data_dir("sim_scenes") / SAMPLE_FILE) as ships:
        assert set(made) == set(ships)
        for name in ("K", "T_world_camera", "mesh_faces"):
            np.testing.assert_array_equal(made[name], ships[name])
        np.testing.assert_allclose(made["mesh_vertices_cam"], ships["mesh_vertices_cam"], atol=1e-4)
        # Renderers differ at a few edges.
        assert (made["mask"] != ships["mask"]).mean() < 1e-3
        assert (made["depth_m"] != ships["depth_m"]).mean() < 1e-2
