"""`gfp-grasp complete`, `check`, `demo` and `view`: every option arrives, and what was done is told."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from bodies import WEDGE
from recorded_calls import Recorder, recorded, rows_of, run
from toy_completions import toy_image

from gfp_grasp.captures import Capture
from gfp_grasp.collision import CollisionConfig
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.completion import CompletedScene
from gfp_grasp.overlap import GaveWay
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes import BodyCheck

CAPTURE = Capture("own", np.eye(3), viewpoint=np.array([1.0, 2.0, 3.0]), up=np.eye(3)[1], support_height=0.5)


def completion(category: str, scores: dict[str, float], num_parts: int, note: str = "") -> Any:
    """What the command reads of a completion, a wedge on its side, and a recorder of its files."""
    return SimpleNamespace(
        category=category,
        scores=scores,
        note=note,
        parts=[None] * num_parts,
        mesh=SimpleNamespace(vertices=WEDGE),
        detection=SimpleNamespace(up=np.array([0.0, 1.0, 0.0]), support=None),
        observed=np.array([True, False, False]),
        timings_s={"detect": 0.1, "register": 0.0321},
        export=Recorder(Path("written by it")),
    )


def scene_of(patch: pytest.MonkeyPatch, *completions: Any, gave_way: tuple[GaveWay, ...] = ()) -> Recorder:
    """The completions as the answer of the command's work, a scene; and a recorder of the scene's files."""
    export = recorded(patch, "gfp_grasp.completion.CompletedScene.export", Path("the scene.xml"))
    scene = CompletedScene(completions, toy_image(), None, gave_way)
    recorded(patch, "gfp_grasp.captures.read_capture", CAPTURE)
    recorded(patch, "gfp_grasp.captures.complete_capture", scene)
    return export


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
    budget = "--bare --max-parts 7 --max-vertices 16 --tolerance-mm 2.5 --seed 9 --gps"
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
    assert mug.export.only == ((out,), {"assets": "files", "contact": False})
    printed = capsys.readouterr()
    # Up is y: the footprint is that of the wedge's triangle.
    assert rows_of(printed.out) == ["mug    │  0.88 │ 67 x 27 x 40 │  33% │     3 │      132"]
    assert printed.out.splitlines()[-1] == "wrote written by it"


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
    assert all(call[1] == {"assets": "embedded", "contact": True} for call in cup.export.calls)


def test_an_up_that_is_auto_is_estimated_whatever_the_recording_says(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    complete = completed_as(monkeypatch, completion("cup", {}, 2))
    monkeypatch.setattr("gfp_grasp.captures.read_capture", lambda _: Capture("own", np.eye(3), up=np.ones(3)))
    assert run("complete own.ply --up auto -o", tmp_path / "a.glb") == 0
    assert complete.only[0][0].up is None


@pytest.mark.parametrize(
    ("words", "capture", "note"),
    [
        ("", Capture("own", np.eye(3), up=np.eye(3)[2], up_is_assumed=True), "up is taken to be z, (0, 0, 1), of the"),
        (
            "--up auto",
            Capture("own", np.eye(3), up=np.eye(3)[2]),
            "up is estimated to be (0, 1, 0), a guess; --up x,y,z",
        ),
        ("", Capture("own", np.eye(3)), "up is estimated to be (0, 1, 0), a guess; --up x,y,z"),
        ("--up 0,1,0", Capture("own", np.eye(3), up_is_assumed=True), None),
        ("", Capture("own", np.eye(3), up=np.ones(3), notes=("the frame is a camera's",)), "the frame is a camera's"),
    ],
)
def test_the_frame_and_the_up_that_were_taken_are_told(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    words: str,
    capture: Capture,
    note: str | None,
) -> None:
    completed_as(monkeypatch, completion("cup", {"cup": 1.0}, 2))
    recorded(monkeypatch, "gfp_grasp.captures.read_capture", capture)
    assert run(f"complete own.ply {words} -o", tmp_path / "a.glb") == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines == [] if note is None else [line.startswith(f"note: {note}") for line in lines] == [True]


def test_a_depth_picture_is_read_with_its_camera_and_its_unit(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    complete = completed_as(monkeypatch, completion("cup", {}, 2))
    capture = Capture("depth.png", np.eye(3))
    read = recorded(monkeypatch, "gfp_grasp.captures.read_depth", capture)
    words = "complete --depth depth.png --intrinsics k.json --depth-scale 0.00025 -o"
    assert run(words, tmp_path / "a.glb") == 0
    assert read.only == ((Path("depth.png"), Path("k.json")), {"depth_scale": 0.00025})
    assert complete.only[0][0].points is capture.points


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("", "one recording is expected"),
        ("a.ply --depth d.png --intrinsics k.json", "one recording is expected"),
        ("--depth d.png", "go together"),
        ("a.ply --intrinsics k.json", "go together"),
        ("a.ply --depth-scale 1000", "goes with them"),
    ],
)
def test_a_recording_and_a_depth_picture_are_not_mixed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: str, said: str
) -> None:
    assert run(f"complete {words} -o", tmp_path / "a.glb") == 2
    assert said in capsys.readouterr().err


def test_the_objects_of_a_picture_are_written_as_one_scene_and_warnings_become_notes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    objects = (completion("mug", {"mug": 0.5}, 3), completion("mug", {}, 12), completion("cup", {"cup": 1.0}, 1))
    export = scene_of(monkeypatch, *objects)
    scene = CompletedScene(objects, toy_image(), None)

    def warn(*_: object, **__: object) -> Sequence[Any]:
        for kind in (UserWarning, RuntimeWarning):
            warnings.warn(f"[a] {kind.__name__}", kind, stacklevel=2)
        return scene

    monkeypatch.setattr("gfp_grasp.captures.complete_capture", warn)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert run("complete own.npz --files -o", tmp_path / "it.xml", "-o", tmp_path / "it.stl") == 0
    how = {"assets": "files", "contact": True}
    assert export.calls == [((tmp_path / "it.xml",), how), ((tmp_path / "it.stl",), how)]
    assert not any(thing.export.calls for thing in objects)
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-2:] == ["note: [a] UserWarning", "note: [a] RuntimeWarning"]
    assert rows_of(printed.out) == [
        "mug    │  0.50 │ 67 x 27 x 40 │  33% │     3 │      132",
        "mug_2  │     - │ 67 x 27 x 40 │  33% │    12 │      132",
        "cup    │  1.00 │ 67 x 27 x 40 │  33% │     1 │      132",
    ]
    assert printed.out.splitlines()[-1] == "wrote the scene.xml, the scene.xml"


def test_each_object_has_files_of_its_own_by_its_name_where_that_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    objects = (completion("mug", {}, 3), completion("mug", {}, 12))
    export = scene_of(monkeypatch, *objects)
    assert run("complete own.npz --each -o", tmp_path / "it.stl", "-o", tmp_path / "b.xml") == 0
    names = [[call[0][0].name for call in thing.export.calls] for thing in objects]
    assert names == [["it_mug.stl", "b_mug.xml"], ["it_mug_2.stl", "b_mug_2.xml"]]
    assert not export.calls
    assert capsys.readouterr().out.splitlines()[-1] == "wrote " + ", ".join(["written by it"] * 4)


def test_the_only_object_of_a_picture_has_the_name_that_was_given(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    mug = completion("mug", {}, 3)
    export = scene_of(monkeypatch, mug)
    assert run("complete own.npz --each -o", tmp_path / "it.stl") == 0
    assert mug.export.only[0] == (tmp_path / "it.stl",)
    assert run("complete own.npz -o", tmp_path / "it.stl") == 0
    assert export.only[0] == (tmp_path / "it.stl",)


def test_what_a_user_may_not_expect_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    objects = (
        completion("mug", {"mug": 0.3, "cup": 0.704, "bottle": 0.1}, 3),
        completion("mug", {"mug": 0.6, "cup": 0.4}, 3),
        completion("bottle", {}, 3),
        completion("unknown", {"mug": 0.2, "cup": 0.8}, 3, note="it is of no class"),
    )
    ways = (GaveWay(2, 1, 0.0036, 0.0, moved=True), GaveWay(0, 2, 0.0124, 0.0, moved=False))
    scene_of(monkeypatch, *objects, gave_way=ways)
    assert run("complete own.npz -o", tmp_path / "it.xml") == 0
    assert capsys.readouterr().err.splitlines() == [
        "note: mug is named by what fits best; the classifier says cup (0.70)",
        "note: unknown: it is of no class",
        "note: bottle was cut back by 4 mm where it reached into mug_2",
        "note: mug and bottle overlap by 12 mm",
    ]


STILL = BodyCheck("mug", tilt_deg=4.96, travel_m=0.00494, overlap_m=0.00123)


@pytest.mark.parametrize(
    ("other", "row", "code"),
    [
        (BodyCheck("cup", 0.0, 0.001, 0.0), "cup    │       0.0 │        1.0 │         0.0 │ yes", 0),
        (BodyCheck("cup", 5.0, 0.001, 0.0), "cup    │       5.0 │        1.0 │         0.0 │ no", 1),
        (BodyCheck("cup", 0.0, 0.005, 0.0), "cup    │       0.0 │        5.0 │         0.0 │ no", 1),
        (BodyCheck("cup", np.inf, np.inf, 0.0), "cup    │       inf │        inf │         0.0 │ no", 1),
    ],
)
def test_check_says_what_stands_and_its_exit_code_whether_all_does(
    other: BodyCheck, row: str, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    check = recorded(monkeypatch, "gfp_grasp.scenes.check_file", (STILL, other))
    assert run("check own.urdf --seconds 0.5") == code
    assert check.only == ((Path("own.urdf"),), {"seconds": 0.5})
    rows = [line.rstrip() for line in rows_of(capsys.readouterr().out)]
    assert [" ".join(line.split()) for line in rows] == [
        " ".join(line.split()) for line in ("mug │ 5.0 │ 4.9 │ 1.2 │ yes", row)
    ]


def test_check_simulates_two_seconds_and_refuses_less_than_ten_milliseconds(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    check = recorded(monkeypatch, "gfp_grasp.scenes.check_file", (STILL,))
    assert run("check own.xml") == 0
    assert check.only == ((Path("own.xml"),), {"seconds": 2.0})
    assert run("check own.xml --seconds 0.009") == 2
    assert "seconds" in capsys.readouterr().err


def test_check_refuses_what_is_no_file_in_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run("check", tmp_path / "none.xml") == 2
    assert capsys.readouterr().err.splitlines() == [f"UnreadableFile: {tmp_path / 'none.xml'} is no file"]


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
    assert named == {"recordings": recordings, "street": False, "category": "mug", "config": config, "seed": 4}
    assert defaults == {"recordings": (), "street": False, "category": None, "config": CompleteConfig(), "seed": 0}


def test_demo_of_a_street_takes_scans_and_no_class(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    demo = recorded(monkeypatch, "gfp_grasp.demo.run_demo")
    assert run("demo --street --capture a.bin") == 0
    assert demo.only[1]["street"]
    assert demo.only[1]["recordings"] == (Path("a.bin"),)
    assert run("demo --street --category car") == 2
    assert "--category" in capsys.readouterr().err
    assert len(demo.calls) == 1


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
    assert (
        run("view own.npz --category mug --sensor lidar --host 0.0.0.0 --port 81 --browser --seed 4 --gps", tmp_path)
        == 0
    )
    config = CompleteConfig(library=PrimitiveLibrary.with_shipped(tmp_path))
    received = {"category": "mug", "sensor": "lidar", "config": config, "seed": 4, "host": "0.0.0.0", "port": 81}
    assert view.only == ((Path("own.npz"),), received)
    assert viewer.done == ["waited", "stopped"]
    assert browser.only == ((viewer.url,), {})
    assert "http://[a]:1 shows it" in capsys.readouterr().out


def test_view_shows_the_sample_and_opens_no_browser_where_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    view = recorded(monkeypatch, "gfp_grasp.view.view_capture", FakeViewer())
    browser = recorded(monkeypatch, "webbrowser.open")
    assert run("view") == 0
    received = {"category": None, "sensor": "tabletop", "config": CompleteConfig(), "seed": 0}
    received |= {"host": "127.0.0.1", "port": 8080}
    assert view.only == (("sample",), received)
    assert not browser.calls


def test_view_of_objects_hands_on_every_option(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    view = recorded(monkeypatch, "gfp_grasp.view.view_episodes", FakeViewer())
    assert run("view --objects cup --host ::1 --port 0 --seed 4 --gps", tmp_path) == 0
    assert view.only == (("cup",), {"gps": str(tmp_path), "seed": 4, "host": "::1", "port": 0})


@pytest.mark.parametrize("other", ["own.npz", "--category mug", "--sensor lidar"])
def test_view_takes_objects_or_a_capture(
    other: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded(monkeypatch, "gfp_grasp.view.view_episodes", FakeViewer())
    assert run(f"view --objects cup {other}") == 2
    assert "--objects" in capsys.readouterr().err
