"""The environment on a plain cylinder, and on the user's own completers."""

import inspect
import pickle
import pydoc
import time
import warnings
from dataclasses import fields
from typing import Any

import gymnasium
import numpy as np
import pytest
import trimesh
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import gfp_grasp
from gfp_grasp.envs import EnvConfig, GfpGraspEnv
from gfp_grasp.errors import InvalidAction, InvalidOption, UnknownCompleter
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.transforms import make_T
from gfp_grasp.types import REASONS, Grasp

pytestmark = pytest.mark.filterwarnings("error")
SMALL: dict[str, Any] = {"num_points": 256, "image_width": 160, "image_height": 120}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two objects that are convex, so that nothing waits for a decomposition."""
    path = tmp_path_factory.mktemp("objects")
    for name, radius_m in (("slim", 0.025), ("wide", 0.034)):
        mesh = trimesh.creation.cylinder(radius_m, 0.14, sections=32)
        mesh.apply_translation((0, 0, 0.07))
        mesh.export(path / f"bottle__{name}.ply")
    return str(path)


@pytest.fixture
def make(folder):
    def make(**options):
        return GfpGraspEnv(**{"objects": folder, "completer": "mirror", **SMALL, **options})

    return make


def same(a, b):
    return a.keys() == b.keys() and all(np.array_equal(a[key], b[key]) for key in a)


def best_action(env, number=0):
    return env.action_code.encode(plan_grasps(env.completion)[number])


def test_gymnasium_finds_nothing_to_complain_of(folder):
    env = gymnasium.make("gfp_grasp:GfpGrasp-v0", objects=folder, completer="mirror", render_mode="rgb_array", **SMALL)
    check_env(env.unwrapped)


@pytest.mark.parametrize("world", ["true", "completed"])
@pytest.mark.parametrize("completer", ["oracle", "mirror"])
def test_the_planned_grasp_of_a_cylinder_is_held(make, completer, world):
    env = make(completer=completer, world=world)
    env.reset(seed=1)
    _, reward, terminated, truncated, info = env.step(best_action(env))
    assert (reward, terminated, truncated) == (1.0, True, False)
    assert info["is_success"]
    assert info["reason"] == "held"
    assert info["world"] == world


def test_a_random_action_fails_with_a_reason_from_the_list(make):
    env = make()
    env.reset(seed=0)
    env.action_space.seed(0)
    _, reward, _, _, info = env.step(env.action_space.sample())
    assert reward == 0.0
    assert info["reason"] in REASONS


def test_observation_holds_the_object_and_its_completion(make):
    env = make(spread_m=0.0)
    observation, _ = env.reset(seed=0)
    mask = observation["observed_mask"].astype(bool)
    assert mask.sum() > 100
    assert not observation["observed"][~mask].any()
    for cloud in (observation["observed"][mask], observation["completed"]):
        assert np.linalg.norm(cloud[:, :2], axis=1).max() < 0.05
        assert cloud[:, 2].min() > -0.005
        assert cloud[:, 2].max() < 0.15
    assert observation["depth"].max() == pytest.approx(0.9, abs=0.4)


def test_equal_seeds_give_equal_episodes_and_outcomes(make):
    runs = []
    for _ in range(2):
        env = make(sensor="realsense")
        observation, info = env.reset(seed=7)
        runs.append((observation, info, env.step(best_action(env))))
    assert same(runs[0][0], runs[1][0])
    assert runs[0][1] == runs[1][1]
    assert runs[0][2][4] == runs[1][2][4]
    other, _ = make(sensor="realsense").reset(seed=8)
    assert not same(runs[0][0], other)


def test_a_later_episode_depends_on_the_seed_alone(make):
    env, fresh = make(), make()
    env.reset(seed=3)
    env.step(best_action(env))
    first, _ = env.reset(seed=5)
    second, _ = fresh.reset(seed=5)
    assert same(first, second)


def test_mass_friction_and_grip_are_drawn_from_the_seed_within_their_ranges(make):
    env = make(mass_spread=0.1, friction_min=0.5, friction_max=0.6, grip_min_n=20.0, grip_max_n=20.0)
    infos = [env.reset(seed=seed, options={"object": 0})[1] for seed in (0, 1, 0)]
    own = env.episode.truth.mass_kg
    for info in infos:
        assert abs(info["mass_kg"] / own - 1) <= 0.1
        assert 0.5 <= info["friction"] <= 0.6
        assert info["grip_n"] == 20.0
    assert infos[0] == infos[2]
    assert infos[0]["mass_kg"] != infos[1]["mass_kg"]
    body = env.world.model.body("object")
    assert body.mass[0] == pytest.approx(infos[2]["mass_kg"])


def test_among_clutter_the_object_that_was_asked_for_is_seen_completed_and_grasped(make):
    env = make(clutter=2, completer="oracle")
    infos = []
    for seed in (0, 0):
        env.reset(seed=seed, options={"object": 1})
        infos.append(env.step(best_action(env))[4])
    assert infos[0] == infos[1]
    assert infos[0]["object"] == "wide"
    assert infos[0]["reason"] == "held"
    bodies = {env.world.model.body(i).name for i in range(env.world.model.nbody)}
    assert {"object", "clutter_0", "clutter_1"} <= bodies
    truth, seen = env.episode.T_world_object[:2, 3], env.episode.detection.cloud.points[:, :2]
    assert np.linalg.norm(seen - truth, axis=1).max() < 0.05
    alone = make(completer="oracle")
    alone.reset(seed=0, options={"object": 1})
    assert "clutter_0" not in {alone.world.model.body(i).name for i in range(alone.world.model.nbody)}


def test_a_grasp_keeps_clear_of_what_stands_beside_the_object(make):
    env = make(clutter=1, completer="oracle", world="completed")
    env.reset(seed=3)
    neighbour = env.world.model.body("clutter_0")
    for grasp in plan_grasps(env.completion, 4):
        reach = grasp.T_world_gripper[:2, 3] + np.outer([-0.5, 0.5], grasp.T_world_gripper[:2, 1]) * grasp.width_m
        assert np.linalg.norm(reach - neighbour.pos[:2], axis=1).min() > 0.02


def test_without_a_display_a_window_is_refused_by_name(make, monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for variable in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(InvalidOption, match="no display"):
        make(render_mode="human")


def test_a_window_follows_the_attempt_as_fast_as_the_clock(make, monkeypatch):
    import mujoco.viewer

    class Window:
        open, synced = True, 0

        def is_running(self):
            return self.open

        def sync(self):
            self.synced += 1

        def close(self):
            self.open = False

    windows = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(mujoco.viewer, "launch_passive", lambda model, data: windows.append(Window()) or windows[-1])
    env = make(render_mode="human")
    env.reset(seed=1, options={"object": 0})
    assert env.render() is None
    before, start = windows[0].synced, time.monotonic()
    env.step(env.action_code.encode(Grasp(make_T(t=(0.3, 0.3, 0.3)), 0.05)))  # beside the object
    assert time.monotonic() - start > 0.5  # the approach alone takes 0.6 s
    assert windows[0].synced > before + 50
    env.reset(seed=1, options={"object": 1})  # of another model: another window
    assert [window.open for window in windows] == [False, True]
    env.close()
    assert not windows[1].open


def test_info_is_flat_and_has_the_same_keys_after_reset_and_step(make):
    env = make()
    _, at_reset = env.reset(seed=0)
    at_step = env.step(env.action_space.sample())[4]
    assert at_reset.keys() == at_step.keys()
    assert all(isinstance(value, (bool, int, float, str)) for value in {**at_reset, **at_step}.values())


def test_a_failed_completion_leaves_zeros_and_says_so(make):
    env = make(completer="own_completers:gives_up")
    observation, info = env.reset(seed=0)
    assert info["completion_failed"]
    assert info["completion_error"].startswith("FitDiverged: nothing fits")
    assert not observation["completed"].any()
    assert observation["observed_mask"].any()
    assert env.step(env.action_space.sample())[4]["reason"] in REASONS


def test_without_a_completion_there_is_no_completed_world_to_grasp_in(make):
    env = make(completer="own_completers:gives_up", world="completed")
    env.reset(seed=0)
    _, reward, _, _, info = env.step(env.action_space.sample())
    assert (reward, info["reason"]) == (0.0, "no_grasp_found")


def test_the_users_own_completer_is_called_by_name(make):
    env = make(completer="own_completers:upright_box")
    env.reset(seed=0)
    assert len(env.completion.mesh.faces) == 12


def test_reset_takes_an_object_and_a_completion(make):
    env = make()
    _, info = env.reset(seed=0, options={"object": 1})
    assert info["object"] == "wide"
    other = make(world="completed")
    other.reset(seed=0, options={"object": 1, "completion": env.completion})
    assert other.completion is env.completion


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"colour": "red"}, InvalidOption, "unknown option 'colour'; legal are objects"),
        ({"render_mode": "ansi"}, InvalidOption, "render_mode is 'ansi'"),
        ({"world": "flat"}, InvalidOption, "'true', 'completed'"),
        ({"sensor": "lidar"}, InvalidOption, "sensor"),
        ({"num_points": 0}, InvalidOption, "num_points"),
        ({"elevation_min_deg": 70.0}, InvalidOption, "elevations"),
        ({"objects": "boat"}, InvalidOption, "boat"),
        ({"completer": "magic"}, UnknownCompleter, "oracle, observed, mirror"),
    ],
)
def test_options_that_are_not_legal_are_refused_by_name(make, options, error, message):
    with pytest.raises(error, match=message):
        make(**options)


@pytest.mark.parametrize("options", [{"colour": 1}, {"object": 9}])
def test_reset_options_that_are_not_legal_are_refused(make, options):
    with pytest.raises(InvalidOption):
        make().reset(seed=0, options=options)


def test_an_action_of_nan_is_refused_and_the_env_lives_on(make):
    env = make()
    env.reset(seed=0)
    with pytest.raises(InvalidAction, match="not finite"):
        env.step(np.full(env.action_space.shape, np.nan))
    assert env.step(best_action(env))[4]["is_success"]


def test_a_step_before_reset_is_refused(make):
    with pytest.raises(gymnasium.error.ResetNeeded):
        make().step(np.zeros(10, dtype=np.float32))


def test_a_used_env_pickles_after_a_render(make):
    env = make(render_mode="rgb_array")
    first, _ = env.reset(seed=2)
    picture = env.render()
    assert picture.shape == (240, 320, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 10
    again, _ = pickle.loads(pickle.dumps(env)).reset(seed=2)
    assert same(first, again)


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_vectors_step_and_reset_in_the_same_step(folder, mode):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of fork under threads, from the standard library
        vector = gymnasium.make_vec(
            "GfpGrasp-v0",
            num_envs=2,
            vectorization_mode=mode,
            vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
            objects=folder,
            completer="mirror",
            **SMALL,
        )
        try:
            observation, _ = vector.reset(seed=0)
            assert vector.observation_space.contains(observation)
            _, rewards, terminated, _, infos = vector.step(np.zeros((2, 10), dtype=np.float32))
        finally:
            vector.close()
    assert terminated.all()
    assert not rewards.any()
    assert set(infos["final_info"]["reason"]) <= set(REASONS)


def test_the_package_registers_the_environment():
    assert gfp_grasp.__name__ == "gfp_grasp"
    assert gymnasium.spec("GfpGrasp-v0").max_episode_steps is None


def test_the_constructor_shows_its_options_with_types_and_defaults():
    shown = inspect.signature(GfpGraspEnv).parameters
    assert list(shown) == [option.name for option in fields(EnvConfig)]
    assert shown["clutter"].default == 0
    assert shown["clutter"].annotation == "int"
    assert all(option.kind is inspect.Parameter.KEYWORD_ONLY for option in shown.values())
    assert "clutter: 'int' = 0" in pydoc.plain(pydoc.render_doc(GfpGraspEnv))
