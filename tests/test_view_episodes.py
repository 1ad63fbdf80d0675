"""Episodes in the viewer, with a toy in viser's place: buttons, texts, the gripper, and what a trial shows."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from recorded_calls import Recorder, recorded
from toy_completions import toy_grasps, toy_item, toy_outcome
from toy_server import Handle, ToyServer, put_toy_in_place_of_viser

from gfp_grasp.errors import InvalidOption
from gfp_grasp.transforms import make_T, quat_wxyz, rotation_about
from gfp_grasp.view import EpisodeViewer, view_episodes
from gfp_grasp.view.episodes import Motion, MovingGripper, gripper_meshes, record_trial
from gfp_grasp.view.panels import line
from gfp_grasp.view.scene import ShownScene

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(autouse=True)
def toy_viser(monkeypatch: pytest.MonkeyPatch) -> None:
    put_toy_in_place_of_viser(monkeypatch)


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Recorder:
    """Scenes of all episodes are one with three grasps."""
    item = toy_item(num_grasps=3)
    return recorded(monkeypatch, "gfp_grasp.view.episodes.scene_of_episode", ShownScene("own", (item,), None, UP))


@pytest.fixture
def env() -> Any:
    return SimpleNamespace(reset=Recorder(), episode="episode")


@pytest.fixture
def viewer(env: Any, drawn: Recorder) -> EpisodeViewer:
    made = EpisodeViewer(env, port=0)
    made.reset(4)
    return made


def motion(num: int = 3) -> Motion:
    """The object rises by 1 cm a frame, the gripper by 2 cm, and the jaws close."""
    rising = np.stack([make_T(t=np.array([0.1, 0.0, 0.05 + 0.01 * i])) for i in range(num)])
    gripper = np.stack([make_T(rotation_about(UP, 0.3), (0.0, 0.0, 0.02 * i)) for i in range(num)])
    opening_m = 0.08 - 0.01 * np.arange(num)
    return Motion(toy_outcome(), gripper, opening_m, rising, make_T(t=np.array([0.1, 0.0, 0.05])))


def status(viewer: EpisodeViewer) -> str:
    return viewer._status.content


def handles(viewer: EpisodeViewer, kind: str) -> dict[str, Handle]:
    server: Any = viewer.server
    return server.gui.named(kind)


class FakeWorld:
    """The object rises by 1 cm whenever somebody asks where it is."""

    model, data = "model", "data"

    def __init__(self) -> None:
        self.height_m, self.restored = 0.0, False

    def pose(self, name: str) -> np.ndarray:
        assert name == "object"
        self.height_m += 0.01
        return make_T(t=np.array([0.0, 0.0, self.height_m]))

    def restore(self) -> None:
        self.restored = True


@pytest.mark.parametrize(("world", "floats"), [("completed", True), ("true", False)])
@pytest.mark.parametrize(("control_s", "every"), [(0.01, 4), (0.005, 8), (0.1, 1)])
def test_a_trial_is_recorded_25_times_a_second_and_at_its_end(
    world: str, floats: bool, control_s: float, every: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake, settings, (grasp,) = FakeWorld(), SimpleNamespace(control_s=control_s), toy_grasps(1)
    env: Any = SimpleNamespace(world=fake, trial_settings=settings, config=SimpleNamespace(world=world))
    poses = iter([(make_T(t=np.array([0.0, 0.0, float(i)])), 0.1 * i) for i in range(99)])
    monkeypatch.setattr("gfp_grasp.view.episodes.gripper_pose", lambda model, data: next(poses))
    received: list[Any] = []

    def trial(*arguments: Any, on_step: Any, **named: Any) -> Any:
        received.append((arguments, named))
        for step in range(2 * every + 1):
            on_step(step)
        return toy_outcome()

    monkeypatch.setattr("gfp_grasp.view.episodes.run_trial", trial)
    made = record_trial(env, grasp)
    assert received == [((fake, grasp, settings), {"floats": floats})]
    assert (len(made), made.outcome.reason, fake.restored) == (4, "held", True)
    np.testing.assert_allclose(made.T_world_gripper[:, 2, 3], [0, 1, 2, 3])
    np.testing.assert_allclose(made.opening_m, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_allclose([made.moved(frame)[2, 3] for frame in range(4)], [0.01, 0.02, 0.03, 0.04])
    with pytest.raises(InvalidOption, match="no scene"):
        record_trial(SimpleNamespace(world=None), grasp)  # type: ignore[arg-type]


def test_motion_is_told_in_the_world_s_frame() -> None:
    turned = make_T(rotation_about(UP, 0.5), (0.2, 0.0, 0.0))
    start = make_T(t=np.array([0.1, 0.0, 0.0]))
    made = Motion(toy_outcome(), turned[None], np.zeros(1), (turned @ start)[None], start)
    np.testing.assert_allclose(made.moved(0), turned, atol=1e-12)


def test_gripper_is_hidden_until_it_is_put_and_its_jaws_open_along_y() -> None:
    server = ToyServer()
    gripper = MovingGripper(server)  # type: ignore[arg-type]
    root, *meshes = server.scene.added
    assert (root.kind, root.arguments, root.named) == ("frame", ("/gripper",), {"show_axes": False, "visible": False})
    assert [node.arguments[0] for node in meshes] == ["/gripper/left", "/gripper/right", "/gripper/body"]
    for node in meshes:
        mesh, _ = gripper_meshes()[node.arguments[0].removeprefix("/gripper/")]
        np.testing.assert_array_equal(node.arguments[1], mesh.vertices)
        assert node.named == {"color": (92, 98, 108), "flat_shading": True}
    T = make_T(rotation_about(UP, 0.3), (0.1, 0.2, 0.3))
    gripper.put(T, 0.06)
    np.testing.assert_allclose(root.wxyz, quat_wxyz(T[:3, :3]))
    np.testing.assert_array_equal(root.position, (0.1, 0.2, 0.3))
    assert [getattr(node, "position", None) for node in meshes] == [(0.0, 0.03, 0.0), (0.0, -0.03, 0.0), None]
    assert root.visible
    gripper.hide()
    assert not root.visible


def test_view_of_episodes_hands_on_every_option_and_stops_where_the_first_cannot_be_drawn(
    drawn: Recorder, env: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = recorded(monkeypatch, "gfp_grasp.view.episodes.GfpGraspEnv", env)
    viewer = view_episodes("cup", gps="folder", seed=7, host="localhost", port=0)
    assert made.only == ((), {"objects": "cup", "gps": "folder"})
    assert isinstance(viewer.server, ToyServer)
    assert viewer.server.started_with == {"host": "localhost", "port": 0, "label": "GfpGrasp-v0", "verbose": False}
    assert env.reset.only == ((), {"seed": 7})
    view_episodes(port=0)
    assert made.calls[1] == ((), {"objects": "all", "gps": ""})
    assert env.reset.calls[1] == ((), {"seed": 0})
    stopped: list[EpisodeViewer] = []
    monkeypatch.setattr(EpisodeViewer, "stop", lambda viewer: stopped.append(viewer))

    def refuse(**_: object) -> None:
        raise InvalidOption("broken")

    env.reset = refuse
    with pytest.raises(InvalidOption, match="broken"):
        view_episodes(port=0)
    assert len(stopped) == 1


def test_folder_of_the_episode_is_the_first_and_has_its_buttons(viewer: EpisodeViewer) -> None:
    assert handles(viewer, "folder")["Episode"].named == {"order": -1.0}
    buttons = handles(viewer, "button")
    assert list(buttons) == ["next", "try"]
    assert buttons["try"].named == {"color": "green", "hint": "Approach, close, lift, shake, let go."}
    assert buttons["next"].named == {"hint": "Draw the episode of the next seed."}
    assert handles(viewer, "slider")["grasp to try"].arguments == ("grasp to try", 1, 16, 1, 1)
    assert viewer.headroom_m == 0.25


def test_an_episode_is_shown_under_its_seed_and_its_grasps_can_be_tried(
    viewer: EpisodeViewer, env: Any, drawn: Recorder
) -> None:
    assert env.reset.only == ((), {"seed": 4})
    assert drawn.only == (("episode",), {"title": "Episode 4", "seed": 4})
    assert status(viewer) == line("seed 4: 3 grasps")
    assert (viewer._rank.max, viewer._rank.value, len(viewer.grasps)) == (3, 1, 3)
    assert (viewer._next.disabled, viewer._try.disabled) == (False, False)
    viewer._rank.value = 3
    handles(viewer, "button")["next"].on["click"](None)
    assert (viewer.seed, viewer._rank.value) == (5, 1)
    assert status(viewer) == line("seed 5: 3 grasps")


def test_an_episode_without_grasps_says_so_and_nothing_can_be_tried(viewer: EpisodeViewer, drawn: Recorder) -> None:
    for items in ((), (toy_item(num_grasps=0),)):
        drawn.answer = ShownScene("own", items, None, UP)
        viewer.reset(6)
        assert status(viewer) == line("seed 6: no grasp found")
        assert (viewer.grasps, viewer._rank.max) == ((), 1)
        assert (viewer._next.disabled, viewer._try.disabled) == (False, True)
    bare = EpisodeViewer(SimpleNamespace(), port=0)  # type: ignore[arg-type]
    assert (bare.grasps, bare.seed) == ((), 0)


def test_a_trial_is_played_and_all_is_put_back(viewer: EpisodeViewer, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = recorded(monkeypatch, "gfp_grasp.view.episodes.record_trial", motion())
    waits: list[float] = []
    told: list[str] = []
    seen: list[Any] = []
    assert viewer.layers is not None
    node: Any = viewer.layers.nodes["/objects/0"]

    def wait(seconds: float) -> bool:
        waits.append(seconds)
        gripper: Any = viewer._gripper._root
        best = viewer.layers.nodes["/grasps/0/0"] if viewer.layers else None
        seen.append((gripper.position[2], node.position[2], gripper.visible, best.visible if best else None))
        return False

    monkeypatch.setattr(viewer, "_over", SimpleNamespace(wait=wait))
    monkeypatch.setattr(viewer, "_say", told.append)
    assert viewer.try_grasp(1) is tried.answer
    assert tried.only[0][1] is viewer.grasps[1]
    assert waits == [0.04, 0.04, 0.04, 1.5]
    np.testing.assert_allclose([step[:2] for step in seen[:3]], [(0.0, 0.0), (0.02, 0.01), (0.04, 0.02)], atol=1e-12)
    assert all(step[2:] == (True, False) for step in seen)  # no planned grasp is in the way
    held = "held: lifted by 200 mm, slipped by 1.2 mm, fell when the jaws opened"
    assert told == ["grasp 2: simulating ...", "grasp 2: playing 0.1 s ...", held, f"grasp 2: {held}"]
    np.testing.assert_array_equal(node.position, (0.0, 0.0, 0.0))
    np.testing.assert_array_equal(node.wxyz, (1.0, 0.0, 0.0, 0.0))
    assert not viewer._gripper._root.visible
    assert viewer.layers.nodes["/grasps/0/0"].visible


def test_playing_ends_where_the_viewer_is_stopped(viewer: EpisodeViewer, monkeypatch: pytest.MonkeyPatch) -> None:
    tried = recorded(monkeypatch, "gfp_grasp.view.episodes.record_trial", motion())
    stopped = recorded(monkeypatch, "gfp_grasp.view.episodes.EpisodeViewer._place")
    viewer.stop()
    viewer.try_grasp()
    assert len(stopped.calls) == 1
    assert tried.only[0][1] is viewer.grasps[0]
    assert not viewer.panels.playing


def test_a_trial_that_is_not_played_moves_nothing(viewer: EpisodeViewer, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded(monkeypatch, "gfp_grasp.view.episodes.record_trial", motion())
    place = recorded(monkeypatch, "gfp_grasp.view.episodes.EpisodeViewer._place")
    viewer.try_grasp(2, play=False)
    assert not place.calls
    assert status(viewer).count("grasp 3: held") == 1
    for rank in (-1, 3):
        with pytest.raises(InvalidOption, match=f"no grasp {rank + 1}; 3 were planned"):
            viewer.try_grasp(rank)


def test_the_slider_shows_where_a_grasp_has_the_gripper_unless_something_is_at_work(
    viewer: EpisodeViewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    put = recorded(monkeypatch, "gfp_grasp.view.episodes.MovingGripper.put")
    viewer._rank.value = 2
    slider = handles(viewer, "slider")["grasp to try"].on["update"]
    slider(SimpleNamespace(client="a user"))
    grasp = viewer.grasps[1]
    assert put.only == ((grasp.T_world_gripper, grasp.width_m), {})
    slider(SimpleNamespace(client=None))  # the program moved it
    with viewer._busy:
        slider(SimpleNamespace(client="a user"))
    viewer._rank.value = 4
    slider(SimpleNamespace(client="a user"))
    assert len(put.calls) == 1


def test_buttons_tell_refusals_and_do_nothing_while_something_is_at_work(
    viewer: EpisodeViewer, monkeypatch: pytest.MonkeyPatch
) -> None:
    trial = recorded(monkeypatch, "gfp_grasp.view.episodes.EpisodeViewer.try_grasp")
    button = handles(viewer, "button")["try"].on["click"]
    viewer._rank.value = 3
    button(None)
    assert trial.only == ((2,), {})
    with viewer._busy:
        button(None)
    assert len(trial.calls) == 1

    def refuse(*_: object) -> None:
        raise InvalidOption("<broken>")

    monkeypatch.setattr(EpisodeViewer, "try_grasp", refuse)
    button(None)
    assert status(viewer) == line("InvalidOption: <broken>")


def test_buttons_are_off_while_something_is_at_work_and_on_again_after_an_error(viewer: EpisodeViewer) -> None:
    seen: list[Any] = []

    def work() -> None:
        with viewer._at_work("busy"):
            seen.append((viewer._next.disabled, viewer._try.disabled, status(viewer)))
            raise KeyError

    with pytest.raises(KeyError):
        work()
    assert seen == [(True, True, line("busy"))]
    assert (viewer._next.disabled, viewer._try.disabled) == (False, False)
    assert not viewer._busy.locked()
