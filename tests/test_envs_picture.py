"""Pictures of scenes, colour by colour, and the window's clock."""

from types import SimpleNamespace

import mujoco.viewer
import numpy as np
import pytest
import trimesh

from gfp_grasp.camera import intrinsics
from gfp_grasp.envs import picture, shade
from gfp_grasp.envs.picture import OVERVIEW, HumanView, has_display
from gfp_grasp.scenes import SceneObject, World
from gfp_grasp.transforms import look_at, make_T
from gfp_grasp.types import ConvexPart

LAMP = np.array([0.3, -0.5, 0.8]) / np.sqrt(0.98)
RGBA = np.array([[1.0, 0.5, 0.25, 1.0], [0.2, 0.4, 0.8, 1.0]])


def test_a_picture_has_the_colour_of_each_geom_by_its_angle_to_the_lamp(monkeypatch):
    """A wall that faces the camera, of two geoms and with sky above; one pixel of it has no normal."""
    asked, depth_of = [], []
    geom = np.full((8, 12), -1)
    geom[2:, :6], geom[2:, 6:] = 0, 1
    normals = np.tile([0.0, 0.0, -1.0], (8, 12, 1))
    normals[4:6, 4:6] = np.nan

    def render(model, data, **how):
        asked.append((model, data, how))
        return np.ones((8, 12)), geom

    monkeypatch.setattr(picture, "render_depth", render)
    monkeypatch.setattr(picture, "surface_normals", lambda image: (depth_of.append(image), normals)[1])
    camera = look_at((0.5, -1.0, 0.7), (0.0, 0.0, 0.1))
    model = SimpleNamespace(geom_rgba=RGBA)
    shaded = shade(model, "data", width=6, height=4, T_world_camera=camera, fov_deg=50.0)  # type: ignore[arg-type]
    light = 0.45 + 0.55 * float(-camera[:3, 2] @ LAMP)
    assert light > 0.9
    assert shaded.dtype == np.uint8
    assert shaded[0].tolist() == [[234, 239, 247]] * 6
    for column, colour in ((0, RGBA[0]), (5, RGBA[1])):
        np.testing.assert_allclose(shaded[1:, column], np.tile(255 * light * colour[:3], (3, 1)), atol=1)
    np.testing.assert_allclose(shaded[2, 2], 255 * 0.725 * RGBA[0, :3], atol=1)
    (_, data, how), (image,) = asked[0], depth_of
    np.testing.assert_array_equal(how.pop("K"), intrinsics(12, 8, 50.0))
    np.testing.assert_array_equal(how.pop("T_world_camera"), camera)
    assert (data, how) == ("data", {"width": 12, "height": 8, "backend": "rays", "farthest_m": 10.0})
    np.testing.assert_array_equal(image.T_world_camera, camera)


def test_edges_are_the_mean_of_four_rays_and_what_faces_away_is_dark(monkeypatch):
    geom = np.full((4, 4), -1)
    geom[:, :3] = 0
    normals = np.tile([0.0, 0.0, 1.0], (4, 4, 1))
    monkeypatch.setattr(picture, "render_depth", lambda *_, **__: (np.ones((4, 4)), geom))
    monkeypatch.setattr(picture, "surface_normals", lambda image: normals)
    camera = look_at((0.5, -1.0, 0.7), (0.0, 0.0, 0.1))
    shaded = shade(SimpleNamespace(geom_rgba=RGBA), None, width=2, height=2, T_world_camera=camera)  # type: ignore[arg-type]
    dark, sky = 255 * 0.45 * RGBA[0, :3], np.array([234.6, 239.7, 247.35])
    np.testing.assert_allclose(shaded[0, 0], dark, atol=1)
    np.testing.assert_allclose(shaded[0, 1], (dark + sky) / 2, atol=1)


def test_the_overview_has_table_object_and_lifted_gripper_in_its_middle(monkeypatch):
    asked = []

    def render(model, data, **how):
        asked.append(how)
        return np.ones((480, 640)), np.full((480, 640), -1)

    monkeypatch.setattr(picture, "render_depth", render)
    assert shade(SimpleNamespace(geom_rgba=RGBA), None).shape == (240, 320, 3)  # type: ignore[arg-type]
    np.testing.assert_array_equal(asked[0]["K"], intrinsics(640, 480, 35.0))
    np.testing.assert_array_equal(asked[0]["T_world_camera"], look_at((0.85, -0.65, 0.62), (0.0, 0.0, 0.17)))
    np.testing.assert_array_equal(asked[0]["T_world_camera"], OVERVIEW)


@pytest.mark.parametrize(
    ("platform", "variables", "there"),
    [
        ("linux", {}, False),
        ("linux", {"DISPLAY": ":0"}, True),
        ("linux", {"WAYLAND_DISPLAY": "wayland-0"}, True),
        ("linux", {"DISPLAY": ""}, False),
        ("darwin", {}, True),
        ("win32", {}, True),
    ],
)
def test_a_display_is_named_on_linux_and_there_elsewhere(monkeypatch, platform, variables, there):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("sys.platform", platform)
    assert has_display() == there


class Window:
    """A window that counts how often it was brought up to date."""

    def __init__(self) -> None:
        self.running, self.synced, self.closed = True, 0, 0

    def is_running(self):
        return self.running

    def sync(self):
        self.synced += 1

    def close(self):
        self.closed += 1


@pytest.fixture
def windows(monkeypatch):
    """Windows that were opened, and a clock that stands at 50 s; what was slept is added to it."""
    opened: list[Window] = []
    clock = SimpleNamespace(now=50.0, slept=[])

    def launch(model, data):
        opened.append(Window())
        return opened[-1]

    def sleep(seconds):
        clock.slept.append(round(seconds, 6))

    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(mujoco.viewer, "launch_passive", launch)
    monkeypatch.setattr(picture, "time", SimpleNamespace(monotonic=lambda: clock.now, sleep=sleep))
    return opened, clock


def test_a_window_waits_until_it_is_time_for_a_state(windows):
    opened, clock = windows
    view, data = HumanView(), SimpleNamespace(time=2.0)
    view.follow(data)  # type: ignore[arg-type]
    assert clock.slept == []
    view.show("model", data)  # type: ignore[arg-type]
    assert [window.synced for window in opened] == [1]
    data.time, clock.now = 2.3, 50.1
    view.follow(data)  # type: ignore[arg-type]
    data.time, clock.now = 2.4, 51.0
    view.follow(data)  # type: ignore[arg-type]
    assert clock.slept == [0.2, 0.0]
    assert opened[0].synced == 3
    opened[0].running = False
    view.show("model", data)  # type: ignore[arg-type]
    view.follow(data)  # type: ignore[arg-type]
    assert (len(opened), opened[0].synced, len(clock.slept)) == (1, 3, 2)


def test_another_model_has_another_window_and_the_last_is_closed_once(windows):
    opened, _ = windows
    view, data = HumanView(), SimpleNamespace(time=0.0)
    view.close()
    for model in ("one", "one", "other"):
        view.show(model, data)  # type: ignore[arg-type]
    assert [(window.synced, window.closed) for window in opened] == [(2, 1), (1, 0)]
    view.close()
    view.close()
    assert [window.closed for window in opened] == [1, 1]
    view.show("other", data)  # type: ignore[arg-type]
    assert len(opened) == 3


def test_a_picture_is_brighter_where_the_lamp_shines_and_sky_where_nothing_is():
    ball = trimesh.creation.icosphere(3, radius=0.1)
    part = ConvexPart(ball.vertices, ball.faces)
    world = World([SceneObject("ball", (part,), None, make_T(t=(0, 0, 0.3)), 0.2, 0.5, fixed=True)])
    camera = look_at((0.0, -0.6, 0.3), (0.0, 0.0, 0.3))
    picture = shade(world.model, world.data, width=80, height=60, T_world_camera=camera, fov_deg=40.0)
    assert picture.shape == (60, 80, 3)
    top, left, middle, foot = picture[18, 40], picture[30, 26], picture[30, 40], picture[41, 40]
    assert tuple(picture[0, 0]) == (int(255 * 0.92), int(255 * 0.94), int(255 * 0.97))
    assert top.sum() > middle.sum() > foot.sum()  # the lamp is above, to the front right
    assert picture[30, 54].sum() > left.sum()
    full, dark = 255 * np.array([0x4F, 0x7C, 0xAC]) / 255, 0.45 * np.array([0x4F, 0x7C, 0xAC])
    assert (picture[15:45, 25:55].max(axis=(0, 1)) <= 255).all()
    np.testing.assert_allclose(foot, dark, atol=3)
    ball_pixels = picture[20:40, 30:50].reshape(-1, 3).astype(float)
    assert (ball_pixels <= full + 1).all()
    assert ball_pixels.max() > 0.9 * full.max()
