"""The server of the viewer, with a toy in viser's place: its start, its camera, its address, its ports."""

import socket
import threading
from typing import Any

import numpy as np
import pytest
from recorded_calls import recorded
from toy_completions import toy_completion, toy_image, toy_item
from toy_server import ToyServer, put_toy_in_place_of_viser
from toy_street import ROAD_M, toy_street

from gfp_grasp.captures import Capture
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.drawing import Item
from gfp_grasp.errors import InvalidOption
from gfp_grasp.transforms import rotation_about
from gfp_grasp.view import Viewer, view_capture
from gfp_grasp.view.scene import ShownScene
from gfp_grasp.view.server import free_port

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(autouse=True)
def toy_viser(monkeypatch: pytest.MonkeyPatch) -> None:
    put_toy_in_place_of_viser(monkeypatch)


def scene(*items: Item, **more: Any) -> ShownScene:
    return ShownScene("own", items, more.pop("image", None), more.pop("up", UP), **more)


def toy_of(viewer: Viewer) -> ToyServer:
    assert isinstance(viewer.server, ToyServer)
    return viewer.server


def test_viewer_starts_quietly_where_it_is_told_and_stops(capsys: pytest.CaptureFixture[str]) -> None:
    with Viewer("title", host="127.0.0.1", port=0) as viewer:
        server = toy_of(viewer)
        assert server.started_with == {"host": "127.0.0.1", "port": 0, "label": "title", "verbose": False}
        assert server.gui.set["configure_theme"] == {"control_width": "large", "show_share_button": False}
        assert (viewer.layers, viewer.headroom_m, server.stopped) == (None, 0.0, False)
    assert server.stopped
    assert capsys.readouterr().out == ""


def test_defaults_are_this_machine_and_8080(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = recorded(monkeypatch, "gfp_grasp.view.server.free_port", 8123)
    viewer = Viewer("title")
    assert asked.only == (("127.0.0.1", 8080), {})
    assert viewer.url == "http://127.0.0.1:8123"


@pytest.mark.parametrize(
    ("host", "shown"),
    [("0.0.0.0", "127.0.0.1"), ("", "127.0.0.1"), ("::", "[::1]"), ("fe80::1", "[fe80::1]"), ("10.1.2.3", "10.1.2.3")],
)
def test_address_can_be_opened_in_a_browser(host: str, shown: str) -> None:
    viewer = Viewer("title", port=0)
    toy_of(viewer).started_with |= {"host": host, "port": 81}
    assert viewer.url == f"http://{shown}:81"


def test_recording_is_shown_with_every_option(monkeypatch: pytest.MonkeyPatch) -> None:
    capture = Capture("own", points=np.eye(3))
    read = recorded(monkeypatch, "gfp_grasp.view.server.read_capture", capture)
    complete = recorded(monkeypatch, "gfp_grasp.view.server.scene_of_capture", scene(toy_item()))
    config = CompleteConfig(rival_share=0.5)
    viewer = view_capture(
        "own.npz",
        category="mug",
        detector="own:find",
        sensor="lidar",
        config=config,
        seed=7,
        host="localhost",
        port=0,
    )
    assert read.only == (("own.npz",), {})
    assert complete.only == (
        (capture,),
        {"category": "mug", "detector": "own:find", "sensor": "lidar", "config": config, "seed": 7},
    )
    assert toy_of(viewer).started_with == {"host": "localhost", "port": 0, "label": "own", "verbose": False}
    assert viewer.layers is not None
    assert viewer.panels.layers is viewer.layers
    view_capture(capture, port=0)
    assert len(read.calls) == 1
    assert complete.calls[1] == (
        (capture,),
        {"category": None, "detector": None, "sensor": "tabletop", "config": None, "seed": 0},
    )
    view_capture(port=0)
    assert read.calls[1] == (("sample",), {})


def test_a_street_is_first_looked_at_from_behind_and_above_of_the_sensor() -> None:
    street = toy_street()
    items = tuple(Item(name, completion) for name, completion in zip(street.names, street, strict=True))
    viewer = Viewer("title", port=0)
    viewer.show(scene(*items, street=street))
    camera = toy_of(viewer).initial_camera
    assert camera.position[0] < -20
    assert camera.position[2] > 15
    np.testing.assert_allclose(camera.look_at, (-0.4, 1.0, ROAD_M))
    assert not viewer.panels.slider.visible  # no gripper takes hold of a car


def test_the_next_scene_takes_the_place_of_the_one_before() -> None:
    viewer = Viewer("title", port=0)
    viewer.show(scene(toy_item("red")))
    before = viewer.layers
    assert before is not None
    handles = list(before.nodes.values())
    viewer.show(scene(toy_item("blue")))
    assert all(handle.removed for handle in handles)  # type: ignore[attr-defined]
    assert viewer.layers is not before
    assert [folder.arguments for folder in viewer.panels.folders] == [("blue",)]  # type: ignore[attr-defined]


def test_waiting_ends_when_another_thread_stops_the_viewer() -> None:
    viewer = Viewer("title", port=0)
    waiting = threading.Thread(target=viewer.wait)
    waiting.start()
    viewer.stop()
    waiting.join(timeout=5.0)
    assert not waiting.is_alive()


def camera_of(shown: ShownScene, headroom_m: float = 0.0) -> Any:
    viewer = Viewer("title", port=0)
    viewer.headroom_m = headroom_m
    viewer.show(shown)
    return viewer.server.initial_camera


SIZE = float(np.linalg.norm((0.06, 0.08, 0.10)))


def test_camera_looks_at_the_middle_from_aside_of_where_the_sensor_stood() -> None:
    middle = np.array([0.0, 0.0, 0.05])
    image = toy_image()
    T = image.T_world_camera.copy()
    T[:3, 3] = (0.3, 0.0, 0.05 + 0.3)
    seen = scene(toy_item(), image=type(image)(image.depth_m, image.K, T))
    camera = camera_of(seen)
    np.testing.assert_allclose(camera.look_at, middle)
    np.testing.assert_array_equal(camera.up, UP)
    assert camera.fov == 0.8
    towards = rotation_about(UP, 0.7) @ np.array([0.5**0.5, 0.0, 0.5**0.5])
    np.testing.assert_allclose(camera.position, middle + 0.5 * towards)  # near things are seen from half a metre


def test_camera_is_as_far_as_things_are_large_and_leaves_room_above() -> None:
    wide = scene(toy_item("a"), toy_item("b", completion=toy_completion((0.6, 0.0, 0.05))))
    for headroom_m in (0.0, 0.25):
        camera = camera_of(wide, headroom_m)
        size = np.linalg.norm((0.66, 0.08, 0.10)) + headroom_m
        np.testing.assert_allclose(camera.look_at, (0.3, 0.0, 0.05 + headroom_m / 2))
        assert np.linalg.norm(camera.position - camera.look_at) == pytest.approx(1.8 * size)


def test_camera_takes_the_viewpoint_of_the_first_object_that_has_one() -> None:
    items = [
        toy_item(name, completion=toy_completion(viewpoint=eye))
        for name, eye in (("a", None), ("b", (0.3, 0.0, 0.35)), ("c", (0.0, 0.3, 0.35)))
    ]
    towards = rotation_about(UP, 0.7) @ np.array([0.5**0.5, 0.0, 0.5**0.5])
    camera = camera_of(scene(*items))
    np.testing.assert_allclose(camera.position, camera.look_at + 0.5 * towards)


@pytest.mark.parametrize("height_m", [-0.1, 0.0, 0.1])
def test_camera_looks_down_at_the_support_however_low_the_sensor_stood(height_m: float) -> None:
    item = toy_item(completion=toy_completion(viewpoint=(0.3, 0.0, 0.05 + height_m)))
    camera = camera_of(scene(item))
    sight = (camera.position - camera.look_at) / 0.5
    length = np.hypot(0.3, height_m)
    level = 0.3 / length
    assert sight[2] == pytest.approx(0.45 / np.hypot(0.45, level))
    assert np.arctan2(sight[1], sight[0]) == pytest.approx(0.7)


def test_camera_looks_from_the_front_right_where_nobody_knows_where_the_sensor_stood() -> None:
    camera = camera_of(scene(toy_item(completion=toy_completion(viewpoint=None))))
    way = rotation_about(UP, 0.7) @ (np.array([1.0, -0.8, 0.4]) / np.linalg.norm([1.0, -0.8, 0.4]))
    way[2] = 0.45
    np.testing.assert_allclose(camera.position, camera.look_at + 0.5 * way / np.linalg.norm(way))


def test_camera_sees_truths_as_well_and_20_cm_where_nothing_is_shown() -> None:
    truth = toy_completion((0.6, 0.0, 0.05)).mesh
    np.testing.assert_allclose(camera_of(scene(toy_item(), truths=(truth,))).look_at, (0.3, 0.0, 0.05))
    camera = camera_of(scene())
    np.testing.assert_allclose(camera.look_at, 0.0)
    distance_m = np.linalg.norm(camera.position)
    assert distance_m == pytest.approx(1.8 * 0.2 * 3**0.5)


def test_a_port_that_is_taken_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert free_port("127.0.0.1", port) == port + 1
    assert free_port("127.0.0.1", port) == port


@pytest.mark.parametrize(("port", "tried"), [(2000, 100), (65530, 6)])
def test_a_hundred_ports_are_tried_up_to_the_last_one(port: int, tried: int, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def listen(_: object, host: str, candidate: int) -> None:
        if candidate:
            asked.append(candidate)
            raise OSError("taken")

    monkeypatch.setattr("gfp_grasp.view.server._listen", listen)
    with pytest.raises(InvalidOption, match=f"no port from {port} on is free at localhost"):
        free_port("localhost", port)
    assert asked == list(range(port, port + tried))


@pytest.mark.parametrize("port", [1.5, "80", None])
def test_what_is_no_whole_number_is_no_port(port: Any) -> None:
    with pytest.raises(InvalidOption, match="port is"):
        free_port("127.0.0.1", port)


def test_the_least_and_the_greatest_port_are_legal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gfp_grasp.view.server._listen", lambda *_: None)
    assert [free_port("127.0.0.1", port) for port in (0, 65535)] == [0, 65535]
