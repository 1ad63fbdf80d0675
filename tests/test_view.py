"""The viewer: what it draws is true to its source, and its page is served; it is refused by name without viser."""

import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest

from gfp_grasp.captures import read_capture
from gfp_grasp.cli.complete import view
from gfp_grasp.drawing import apart
from gfp_grasp.envs import Episode, GfpGraspEnv
from gfp_grasp.errors import InvalidOption
from gfp_grasp.grasps import Gripper
from gfp_grasp.view import Viewer, view_capture, view_episodes
from gfp_grasp.view.episodes import FRAMES_PER_S, gripper_meshes, record_trial
from gfp_grasp.view.layers import (
    GUESSED,
    SEEN,
    Switches,
    grasp_colour,
    scale_colours,
    scale_end_mm,
    seen_colours,
)
from gfp_grasp.view.panels import item_rows, scale_legend, table
from gfp_grasp.view.scene import OTHER, SUPPORT, ShownScene, scene_cloud, scene_of_capture, scene_of_episode
from gfp_grasp.view.server import free_port


@pytest.fixture(scope="module")
def shown() -> ShownScene:
    """The shipped capture, completed."""
    return scene_of_capture(read_capture("sample"))


@pytest.fixture(scope="module")
def env() -> GfpGraspEnv:
    """An episode whose best grasp holds."""
    env = GfpGraspEnv(objects="cup,mug,bottle")
    env.reset(seed=0)
    return env


def test_without_viser_the_viewer_is_refused_before_any_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    for start in (lambda: view_capture("no-such-file.npz"), lambda: view_episodes("no-such-family")):
        with pytest.raises(InvalidOption, match=r'viser.*pip install "gfp-grasp\[view\]"'):
            start()


def test_importing_package_command_line_and_viewer_loads_no_viser() -> None:
    code = "import gfp_grasp, gfp_grasp.cli, gfp_grasp.cli.complete, gfp_grasp.view, sys; print('viser' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_command_takes_a_capture_or_objects_but_not_both() -> None:
    with pytest.raises(InvalidOption, match="--objects"):
        view(Path("sample"), objects="cup")


@pytest.mark.parametrize("host", ["203.0.113.7", "no such host"])
def test_host_that_is_not_this_machine_is_refused(host: str) -> None:
    with pytest.raises(InvalidOption, match="host is"):
        free_port(host, 0)


@pytest.mark.parametrize("port", [-1, 65536, True])
def test_port_that_is_none_is_refused(port: int) -> None:
    with pytest.raises(InvalidOption, match="0 to 65535"):
        free_port("127.0.0.1", port)


@pytest.mark.parametrize("opening_m", [0.0, 0.03, 0.08])
def test_moving_gripper_has_the_planner_s_boxes_at_every_opening(opening_m: float) -> None:
    meshes = gripper_meshes()
    corners = []
    for name in ("left", "right", "body"):
        mesh, sense = meshes[name]
        boxes = mesh.vertices.reshape(-1, 8, 3) + sense * np.array([0.0, opening_m / 2, 0.0])
        corners.append(np.stack([boxes.min(axis=1), boxes.max(axis=1)], axis=1))
        assert mesh.volume > 0
    solids = Gripper().solids(np.array([opening_m]))[0]
    np.testing.assert_allclose(np.concatenate(corners), solids, atol=1e-12)


def test_scale_runs_from_violet_to_yellow_and_stays_there() -> None:
    colours = scale_colours(np.array([0.0, 0.001, 0.002, 0.5]), 2.0)
    np.testing.assert_array_equal(colours[[0, 2, 3]], [(68, 1, 84), (253, 231, 37), (253, 231, 37)])
    brightness = scale_colours(np.linspace(0.0, 0.002, 101), 2.0) @ np.array([0.2126, 0.7152, 0.0722])
    assert (np.diff(brightness) > 0).all()


def test_scale_ends_at_a_round_number_that_covers_nearly_all() -> None:
    sigma = np.linspace(0.0, 0.0038, 1000)
    assert scale_end_mm([sigma, sigma]) == 4.0
    assert scale_end_mm([]) == 1.0
    assert scale_end_mm([np.array([9.0])]) == 500.0
    for word in ("0 mm", "2 mm", "4 mm and more"):
        assert f">{word}<" in scale_legend(4.0)


def test_colours_tell_seen_from_guessed_parts_apart_and_the_best_grasp() -> None:
    np.testing.assert_array_equal(seen_colours(np.array([True, False])), [SEEN, GUESSED])
    assert len(np.unique(apart(80), axis=0)) == 80
    assert apart(0).shape == (0, 3)
    (best, _), *others = [grasp_colour(rank) for rank in range(16)]
    assert best[1] > 1.5 * max(best[0], best[2])
    opacities = [opacity for _, opacity in others]
    assert opacities == sorted(opacities, reverse=True)
    assert opacities[-1] > 0


def test_switches_show_one_surface_at_a_time_and_the_best_grasps() -> None:
    surfaces = ("mesh", "sigma", "parts")
    for switches, shown in (
        (Switches(), {"mesh"}),
        (Switches(sigma=True), {"sigma"}),
        (Switches(sigma=True, parts=True), {"parts"}),
        (Switches(mesh=False), set()),
    ):
        assert {layer for layer in surfaces if switches.shows(f"/objects/0/{layer}")} == shown
    few = Switches(num_grasps=2, hidden=frozenset({1}))
    assert [few.shows(f"/grasps/0/{rank}") for rank in range(4)] == [True, True, False, False]
    assert few.shows("/objects/0")
    assert not any(few.shows(name) for name in ("/objects/1", "/objects/1/mesh", "/grasps/1/0"))
    assert few.shows("/scene/points")
    assert not Switches(scene=False).shows("/scene/points")


def test_texts_cannot_break_out_of_the_page() -> None:
    hostile = "</div><script>alert(1)</script>"
    assert "<script" not in table(((hostile, hostile),), (hostile,))


def test_scene_s_points_belong_to_cluster_or_support(shown: ShownScene) -> None:
    assert shown.image is not None
    completion = shown.items[0].completion
    points, labels = scene_cloud(shown.image, [completion], max_points=10**6)
    assert completion.detection.mask is not None
    assert completion.detection.support is not None
    own = shown.image.points()[completion.detection.mask]
    own = own[np.isfinite(own).all(axis=1)]
    np.testing.assert_array_equal(points[labels == 0], own)
    assert np.abs(completion.detection.support.distances(points[labels == SUPPORT])).max() < 0.02
    assert (labels == SUPPORT).sum() > (labels == OTHER).sum()
    few, _ = scene_cloud(shown.image, [completion], max_points=5000)
    assert 2500 < len(few) <= 5000


def test_panel_tells_class_size_residual_and_error_of_the_parts(shown: ShownScene) -> None:
    rows = dict(item_rows(shown.items[0]))
    assert rows["class"] == "mug"
    assert float(rows["confidence"].split()[0]) > 0.5
    size_mm = [int(word) for word in rows["size"].removesuffix(" mm").split(" x ")]
    assert all(40 < extent < 200 for extent in size_mm)
    assert rows["residual"].endswith("mm, upright")
    mean, high, largest = (1000 * error for error in shown.items[0].completion.collision.error_m)
    assert rows["parts off by"] == f"{mean:.2f} mm, 95 % below {high:.2f}, all {largest:.2f}"


def test_recorded_attempt_is_the_environment_s_own(env: GfpGraspEnv) -> None:
    shown = scene_of_episode(env.episode, title="")
    assert env.world is not None
    before = env.world.pose("object")
    motion = record_trial(env, shown.items[0].grasps[0])
    np.testing.assert_array_equal(env.world.pose("object"), before)
    np.testing.assert_allclose(motion.moved(0), np.eye(4), atol=1e-3)
    _, reward, _, _, info = env.step(env.action_code.encode(shown.items[0].grasps[0]))
    assert (float(motion.outcome.success), motion.outcome.reason) == (reward, info["reason"])
    assert motion.outcome.reason == "held"
    s = env.trial_settings
    swings = 2 * (s.shake_cycles / s.shake_hz + 1 / s.turn_hz)
    seconds = s.approach_s + s.close_s + s.lift_s + s.hold_s + swings + s.release_s
    assert len(motion) == pytest.approx(seconds * FRAMES_PER_S, abs=2)
    raised = [motion.moved(frame)[2, 3] for frame in range(len(motion))]
    hanging = round((s.approach_s + s.close_s + s.lift_s + s.hold_s) * FRAMES_PER_S) - 1  # turns come after it
    assert raised[hanging] == pytest.approx(s.lift_m, abs=0.01)
    assert motion.opening_m.min() < motion.opening_m[0] - 0.005


def test_page_of_a_capture_is_served_with_its_scene_and_its_switches(shown: ShownScene) -> None:
    pytest.importorskip("viser")
    capture = read_capture("sample")
    with view_capture(capture, port=0) as viewer:
        with urllib.request.urlopen(viewer.url, timeout=10) as answer:
            assert answer.status == 200
            assert b"<html" in answer.read()
        assert viewer.layers is not None
        nodes, switches = viewer.layers.nodes, viewer.panels.switches
        layers = ("cluster", "observed", "mesh", "sigma", "parts", "primitive")
        assert set(nodes) >= {"/scene/points", "/truth/0", *(f"/objects/0/{name}" for name in layers)}
        assert sum(name.startswith("/grasps/0/") for name in nodes) == len(shown.items[0].grasps) == 16
        assert set(switches) == {"scene", "observed", "mesh", "sigma", "parts", "primitive", "truth"}
        assert _visible(viewer) == {"observed", "mesh", "cluster"}
        assert sum(nodes[f"/grasps/0/{rank}"].visible for rank in range(16)) == viewer.panels.slider.value
        switches["sigma"].value = True
        viewer.panels.slider.value = 2
        viewer.panels.refresh()
        assert _visible(viewer) == {"observed", "sigma", "cluster"}
        assert "mm and more" in viewer.panels.legend.content
        assert [rank for rank in range(16) if nodes[f"/grasps/0/{rank}"].visible] == [0, 1]
        switches["parts"].value = switches["primitive"].value = switches["truth"].value = True
        switches["observed"].value = switches["scene"].value = False
        viewer.panels.refresh()
        assert _visible(viewer) == {"parts", "primitive"}
        assert nodes["/truth/0"].visible
        assert not nodes["/scene/points"].visible
        url, start = viewer.url, time.perf_counter()
    assert time.perf_counter() - start < 5
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(url, timeout=5)


def test_viewer_says_nothing_on_stdout_and_goes_on_to_a_free_port(capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    with Viewer("one", port=0) as one, Viewer("two", port=one.server.get_port()) as two:
        assert two.server.get_port() > one.server.get_port()
    assert capsys.readouterr().out == ""


def test_episodes_go_on_and_their_grasps_are_tried() -> None:
    pytest.importorskip("viser")
    with view_episodes("cup,mug,bottle", seed=0, port=0) as viewer:
        motion = viewer.try_grasp(0, play=False)
        assert motion.outcome.reason.replace("_", " ") in viewer._status.content
        assert not viewer._next.disabled
        assert not viewer._try.disabled
        with pytest.raises(InvalidOption, match="no grasp 99"):
            viewer.try_grasp(98)
        before = viewer.layers
        viewer.reset(viewer.seed + 1)
        assert viewer.seed == 1
        assert viewer.layers is not before
        assert before is not None
        assert not before.nodes
        np.testing.assert_array_equal(
            viewer.env.episode.image.depth_m, _episode_of(1).image.depth_m, err_msg="the seed alone decides"
        )


def _visible(viewer: Viewer) -> set[str]:
    """Layers of the first object that are shown."""
    assert viewer.layers is not None
    nodes = viewer.layers.nodes
    return {name.split("/")[3] for name, node in nodes.items() if name.startswith("/objects/0/") and node.visible}


def _episode_of(seed: int) -> Episode:
    env = GfpGraspEnv(objects="cup,mug,bottle")
    env.reset(seed=seed)
    return env.episode
