"""The environment in vectors, and before the checkers of the libraries that it is used with."""

import os
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import trimesh
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_match import check_environments_match
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from gfp_grasp.types import REASONS

pytestmark = pytest.mark.filterwarnings("error")
SMALL: dict[str, Any] = {"num_points": 64, "image_width": 120, "image_height": 90}
STEPS = 4


@pytest.fixture(scope="module")
def objects(tmp_path_factory):
    """Three cylinders, which are convex, so that nothing waits for a decomposition."""
    path = tmp_path_factory.mktemp("objects")
    for name, radius_m in (("slim", 0.022), ("middling", 0.028), ("wide", 0.034)):
        mesh = trimesh.creation.cylinder(radius_m, 0.14, sections=32)
        mesh.apply_translation((0, 0, 0.07))
        mesh.export(path / f"bottle__{name}.ply")
    return str(path)


@contextmanager
def vector(objects: str, mode: str, **options: Any) -> Iterator[VectorEnv]:
    with warnings.catch_warnings():
        # From the standard library, where a process that has threads forks; numpy's and pytest's threads are such.
        warnings.filterwarnings("ignore", "This process .* is multi-threaded, use of fork", DeprecationWarning)
        envs = gym.make_vec(
            "gfp_grasp:GfpGrasp-v0",
            num_envs=2,
            vectorization_mode=mode,
            vector_kwargs={"autoreset_mode": AutoresetMode.SAME_STEP},
            objects=objects,
            **{"completer": "mirror", **SMALL, **options},
        )
        try:
            yield envs
        finally:
            envs.close()


def actions(rng):
    """One grasp that comes level at mid-height and holds, where the object stands in the middle; one at random."""
    level = np.array([0, 0, -0.43, 1, 0, 0, 0, 1, 0, 0.3])
    return np.stack([level, rng.uniform(-1, 1, 10)]).astype(np.float32)


def flat(tree, name=""):
    """Leaves of nested dicts and arrays of dicts, by their path."""
    if isinstance(tree, dict):
        return {path: leaf for key, value in tree.items() for path, leaf in flat(value, f"{name}/{key}").items()}
    if isinstance(tree, np.ndarray) and tree.dtype == object and any(isinstance(item, dict) for item in tree):
        return {path: leaf for i, item in enumerate(tree) for path, leaf in flat(item, f"{name}/{i}").items()}
    return {name: tree}


def run(objects, mode):
    rng, seen = np.random.default_rng(0), []
    with vector(objects, mode, spread_m=0.0, sensor="realsense") as envs:
        seen.append(flat(dict(zip(("observation", "info"), envs.reset(seed=3), strict=True))))
        for _ in range(STEPS):
            names = ("observation", "reward", "terminated", "truncated", "info")
            seen.append(flat(dict(zip(names, envs.step(actions(rng)), strict=True))))
    return seen


def test_sync_and_async_vectors_give_equal_results_step_by_step(objects):
    for at_once, apart in zip(run(objects, "sync"), run(objects, "async"), strict=True):
        assert at_once.keys() == apart.keys()
        for path, leaf in at_once.items():
            np.testing.assert_array_equal(leaf, apart[path], err_msg=path)


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_each_step_hands_over_the_end_of_one_episode_and_the_start_of_the_next(objects, mode):
    rng, held = np.random.default_rng(0), []
    with vector(objects, mode, spread_m=0.0) as envs:
        assert envs.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
        assert envs.observation_space == batch_space(envs.single_observation_space, 2)
        before, _ = envs.reset(seed=0)
        before = {key: array.copy() for key, array in before.items()}
        for _ in range(STEPS):
            after, rewards, terminated, truncated, infos = envs.step(actions(rng))
            assert envs.observation_space.contains(after)
            assert terminated.all()
            assert not truncated.any()
            final = infos["final_info"]
            assert set(final["reason"]) <= set(REASONS)
            assert (final["is_success"] == (rewards == 1.0)).all()
            for i, last in enumerate(infos["final_obs"]):
                for key, array in last.items():
                    np.testing.assert_array_equal(array, before[key][i])
                assert not np.array_equal(last["depth"], after["depth"][i])
            assert not any(infos["reason"])  # of the new episodes, in which nothing has been attempted yet
            before = {key: array.copy() for key, array in after.items()}
            held.append(rewards[0])
    assert held == [1.0] * STEPS


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_a_vector_of_one_seed_gives_each_env_its_own(objects, mode):
    with vector(objects, mode) as envs:
        observation, _ = envs.reset(seed=5)
        again, _ = envs.reset(seed=[5, 6])  # pyright: ignore[reportArgumentType]
    assert not np.array_equal(observation["depth"][0], observation["depth"][1])
    np.testing.assert_array_equal(observation["depth"], again["depth"])


def test_two_envs_of_one_spec_match_over_many_steps(objects):
    made = [gym.make("gfp_grasp:GfpGrasp-v0", objects=objects, completer="mirror", **SMALL) for _ in range(2)]
    check_environments_match(*made, num_steps=6, seed=0)


def test_a_spec_that_went_through_json_makes_the_same_env(objects):
    env = gym.make("gfp_grasp:GfpGrasp-v0", objects=objects, completer="mirror", **SMALL)
    assert env.spec is not None
    again = gym.make(EnvSpec.from_json(env.spec.to_json()))
    first, second = env.reset(seed=1)[0], again.reset(seed=1)[0]
    assert all(np.array_equal(first[key], second[key]) for key in first)


def test_stable_baselines_finds_nothing_else_to_complain_of(objects):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = gym.make("gfp_grasp:GfpGrasp-v0", objects=objects, completer="mirror", render_mode="rgb_array", **SMALL)
    with warnings.catch_warnings():
        # It takes a two-dimensional array for neither picture nor vector. Clouds and a depth picture are that by
        # nature; the policies of Stable-Baselines3 flatten them.
        said = "Your observation (observed|completed|depth) has an unconventional shape"
        warnings.filterwarnings("ignore", said, UserWarning)
        checker.check_env(env.unwrapped, skip_render_check=False)


def test_workers_that_are_forked_after_a_completion_answer(objects):
    """GNU OpenMP does not survive a fork once its pool has started: no public call may start it."""
    code = """
import multiprocessing, sys, warnings
from concurrent.futures import ProcessPoolExecutor
import gymnasium, trimesh
import gfp_grasp

warnings.simplefilter("ignore")
points = trimesh.creation.cylinder(0.03, 0.12).sample(3000, seed=0)
points = points[points[:, 0] > 0.005] + (0, 0, 0.06)


def complete(seed):
    return gfp_grasp.complete_to_mesh(points, viewpoint=(0.6, 0, 0.3), seed=seed).category


known = complete(0)
context = multiprocessing.get_context("fork")
with context.Pool(1) as pool:
    print(pool.apply(complete, (0,)) == known)
with ProcessPoolExecutor(1, mp_context=context) as executor:
    print(executor.submit(complete, 0).result() == known)
envs = gymnasium.make_vec("gfp_grasp:GfpGrasp-v0", 1, "async", objects=sys.argv[1], completer="gfpnet", num_points=64)
print(not envs.reset(seed=0)[1]["completion_failed"][0])
envs.close()
"""
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code, objects], capture_output=True, text=True, timeout=400, env=free)
    assert done.stdout.split() == ["True"] * 3, done.stderr


@pytest.mark.slow  # an interpreter and a worker each
@pytest.mark.parametrize(("completer", "needed"), [("mirror", False), ("gfpnet", True)])
def test_async_workers_load_torch_only_for_a_network(objects, completer, needed):
    code = """
import sys, gymnasium as gym

class Told(gym.Wrapper):
    def has_torch(self):
        return "torch" in sys.modules

options = {"objects": sys.argv[1], "completer": sys.argv[2], "num_points": 64}
envs = gym.make_vec("gfp_grasp:GfpGrasp-v0", 2, "async", wrappers=[Told], **options)
envs.reset(seed=0)
envs.step(envs.action_space.sample())
print(*envs.call("has_torch"), "torch" in sys.modules)
envs.close()
"""
    done = subprocess.run([sys.executable, "-c", code, objects, completer], capture_output=True, text=True, check=True)
    assert done.stdout.split() == [str(needed), str(needed), "False"]
