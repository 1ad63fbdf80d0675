"""`gfp-grasp complete`, `demo` and `view`: every option arrives, and what was done is told."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recorded_calls import Recorder, recorded, rows_of, run

from gfp_grasp.captures import Capture
from gfp_grasp.collision import CollisionConfig
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.primitives import PrimitiveLibrary

CAPTURE = Capture("own", points=np.eye(3), viewpoint=np.array([1.0, 2.0, 3.0]), support_height=0.5)


def completion(category: str, scores: dict[str, float], num_parts: int) -> SimpleNamespace:
    """What the command reads of a completion, and a recorder of its files."""
    return SimpleNamespace(
        category=category,
        scores=scores,
        parts=[None] * num_parts,
        mesh=SimpleNamespace(extents=np.array([0.0812, 0.0927, 0.1234])),
        observed=np.array([True, False, False]),
        timings_s={"detect": 0.1, "register": 0.0321},
        export=Recorder(),
    )


def completed_as(patch: pytest.MonkeyPatch, *completions: object) -> Recorder:
    recorded(patch, "gfp_grasp.captures.read_capture", CAPTURE)
    return recorded(patch, "gfp_grasp.captures.complete_capture", completions)


def test_complete_hands_on_every_option(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    mug = completion("mug", {"mug": 0.876, "cup": 0.1}, 3)
    complete = completed_as(monkeypatch, mug)
    place = "--viewpoint 0.1,-0.2,0.5 --up 0,1,0 --support-height 0.25 --category mug --files"
    place += " --detector own:find --sensor lidar"
    budget = "--max-parts 7 --max-vertices 16 --tolerance-mm 2.5 --seed 9 --gps"
    out = tmp_path / "mug.xml"
    assert run(f"complete own.ply {place} {budget}", tmp_path, "-o", out) == 0
    (capture,), named = complete.only
    assert capture.points is CAPTURE.points
    np.testing.assert_array_equal(capture.viewpoint, [0.1, -0.2, 0.5])
    np.testing.assert_array_equal(capture.up, [0.0, 1.0, 0.0])
    assert capture.support_height == 0.25
    config = CompleteConfig(
        library=PrimitiveLibrary.with_shipped(tmp_path),
        collision=CollisionConfig(max_parts=7, max_vertices_per_part=16, tolerance_m=0.0025),
    )
    assert named == {"category": "mug", "detector": "own:find", "sensor": "lidar", "config": config, "seed": 9}
    assert mug.export.only == ((out,), {"assets": "files"})
    assert rows_of(capsys.readouterr().out) == ["mug   │  0.88 │ 81 x 93 x 123 │  33% │     3 │      132"]


def test_complete_leaves_a_recording_as_it_is_where_nothing_is_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    cup = completion("cup", {"cup": 1.0}, 2)
    complete = completed_as(monkeypatch, cup)
    assert run("complete own.ply -o", tmp_path / "a.xml", "-o", tmp_path / "b.glb") == 0
    (capture,), named = complete.only
    np.testing.assert_array_equal(capture.viewpoint, [1.0, 2.0, 3.0])
    assert capture.support_height == 0.5
    assert named["config"] == CompleteConfig(collision=CollisionConfig(max_parts=80))
    assert (named["category"], named["detector"], named["sensor"], named["seed"]) == (None, None, "tabletop", 0)
    assert [call[0][0].name for call in cup.export.calls] == ["a.xml", "b.glb"]
    assert all(call[1] == {"assets": "embedded"} for call in cup.export.calls)


def test_an_up_that_is_auto_is_estimated_whatever_the_recording_says(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    complete = completed_as(monkeypatch, completion("cup", {}, 2))
    monkeypatch.setattr("gfp_grasp.captures.read_capture", lambda _: Capture("own", np.eye(3), up=np.ones(3)))
    assert run("complete own.ply --up auto -o", tmp_path / "a.glb") == 0
    assert complete.only[0][0].up is None


def test_several_objects_get_numbered_files_and_warnings_become_notes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    objects = (completion("mug", {"mug": 0.5}, 3), completion("cup", {}, 12))
    completed_as(monkeypatch, *objects)

    def warn(*_: object, **__: object) -> Sequence[Any]:
        for kind in (UserWarning, RuntimeWarning):
            warnings.warn(f"[a] {kind.__name__}", kind, stacklevel=2)
        return objects

    monkeypatch.setattr("gfp_grasp.captures.complete_capture", warn)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert run("complete own.ply -o", tmp_path / "it.stl") == 0
    names = [call[0][0].name for thing in objects for call in thing.export.calls]
    assert names == ["it_0.stl", "it_1.stl"]
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-2:] == ["note: [a] UserWarning", "note: [a] RuntimeWarning"]
    assert rows_of(printed.out) == [
        "mug   │  0.50 │ 81 x 93 x 123 │  33% │     3 │      132",
        "cup   │   nan │ 81 x 93 x 123 │  33% │    12 │      132",
    ]


def test_demo_hands_on_every_option(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    demo = recorded(monkeypatch, "gfp_grasp.demo.run_demo")
    words = "demo --out elsewhere --cloud a.ply --cloud b.ply --capture c.npz --category mug --seed 4 --gps"
    assert run(words, tmp_path) == 0
    assert run("demo") == 0
    ((folder,), named), ((default_folder,), defaults) = demo.calls
    assert (folder, default_folder) == (Path("elsewhere"), Path("out"))
    assert named.pop("console") is defaults.pop("console")
    config = CompleteConfig(library=PrimitiveLibrary.with_shipped(tmp_path))
    recordings = (Path("a.ply"), Path("b.ply"), Path("c.npz"))
    assert named == {"recordings": recordings, "category": "mug", "config": config, "seed": 4}
    assert defaults == {"recordings": (), "category": None, "config": CompleteConfig(), "seed": 0}


class FakeViewer:
    """Tells what was done with it; waiting for it is interrupted."""

    url = "http://[a]:1"

    def __init__(self) -> None:
        self.done: list[str] = []

    def __enter__(self) -> "FakeViewer":
        return self

    def __exit__(self, *_: object) -> None:
        self.done.append("stopped")

    def wait(self) -> None:
        self.done.append("waited")
        raise KeyboardInterrupt


def test_view_of_a_capture_hands_on_every_option_and_ends_without_an_error(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    viewer = FakeViewer()
    view = recorded(monkeypatch, "gfp_grasp.view.view_capture", viewer)
    browser = recorded(monkeypatch, "webbrowser.open")
    assert run("view own.npz --category mug --host 0.0.0.0 --port 81 --browser --seed 4 --gps", tmp_path) == 0
    config = CompleteConfig(library=PrimitiveLibrary.with_shipped(tmp_path))
    received = {"category": "mug", "config": config, "seed": 4, "host": "0.0.0.0", "port": 81}
    assert view.only == ((Path("own.npz"),), received)
    assert viewer.done == ["waited", "stopped"]
    assert browser.only == ((viewer.url,), {})
    assert "http://[a]:1 shows it" in capsys.readouterr().out


def test_view_shows_the_sample_and_opens_no_browser_where_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    view = recorded(monkeypatch, "gfp_grasp.view.view_capture", FakeViewer())
    browser = recorded(monkeypatch, "webbrowser.open")
    assert run("view") == 0
    received = {"category": None, "config": CompleteConfig(), "seed": 0, "host": "127.0.0.1", "port": 8080}
    assert view.only == (("sample",), received)
    assert not browser.calls


def test_view_of_objects_hands_on_every_option(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    view = recorded(monkeypatch, "gfp_grasp.view.view_episodes", FakeViewer())
    assert run("view --objects cup --host ::1 --port 0 --seed 4 --gps", tmp_path) == 0
    assert view.only == (("cup",), {"gps": str(tmp_path), "seed": 4, "host": "::1", "port": 0})


@pytest.mark.parametrize("other", ["own.npz", "--category mug"])
def test_view_takes_objects_or_a_capture(
    other: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded(monkeypatch, "gfp_grasp.view.view_episodes", FakeViewer())
    assert run(f"view --objects cup {other}") == 2
    assert "--objects" in capsys.readouterr().err
