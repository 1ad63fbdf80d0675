"""What a careless user hands the environment is refused by name, or does no harm."""

import gc
import json
import re
import subprocess
import sys
import weakref
from typing import Any

import gymnasium
import numpy as np
import pytest
import trimesh
from trimesh.exchange.ply import export_ply

from gfp_grasp.detect import DetectConfig, detect_objects
from gfp_grasp.envs import ActionCode, GfpGraspEnv
from gfp_grasp.errors import InvalidAction, InvalidMesh, InvalidOption, InvalidScene, UnreadableFile
from gfp_grasp.scenes import SceneObject, load_objects
from gfp_grasp.score import ScoreConfig, score
from gfp_grasp.transforms import make_T
from gfp_grasp.types import Grasp

pytestmark = pytest.mark.filterwarnings("error")
SMALL: dict[str, Any] = {"num_points": 64, "image_width": 160, "image_height": 120}


def cylinder(scale=1.0):
    mesh = trimesh.creation.cylinder(0.03, 0.14, sections=32)
    mesh.apply_translation((0, 0, 0.07))
    return mesh.apply_scale(scale)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("one")
    cylinder().export(path / "bottle__plain.ply")
    return path


@pytest.fixture(scope="module")
def env(folder):
    return GfpGraspEnv(objects=str(folder), completer="mirror", **SMALL)


@pytest.fixture
def among_good_ones(folder, tmp_path):
    """A folder with one good mesh in it; call it to add a bad one."""
    (tmp_path / "a__good.ply").write_bytes((folder / "bottle__plain.ply").read_bytes())

    def add(name, content):
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return tmp_path

    return add


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"completer": None}, "completer is None; a string"),
        ({"world": ["true"]}, "'true', 'completed'"),
        ({"sensor": None}, "'ideal', 'gaussian'"),
        ({"objects": ""}, "cup, mug, bottle"),
        ({"objects": ["cup", "mug"]}, "a string is expected"),
        ({"num_points": "many"}, "num_points is 'many'; a whole number"),
        ({"num_points": 10.5}, "a whole number"),
        ({"num_points": True}, "a whole number"),
        ({"limit": 1.5}, "limit"),
        ({"noise_m": None}, "noise_m is None; a number"),
        ({"distance_m": float("inf")}, "finite"),
        ({"spread_m": float("nan")}, "finite"),
        ({"fov_deg": 180}, "below 180"),
        ({"elevation_min_deg": "low"}, "elevation_min_deg"),
    ],
)
def test_an_option_of_the_wrong_kind_is_refused_at_once(folder, options, message):
    with pytest.raises(InvalidOption, match=message):
        GfpGraspEnv(**{"objects": str(folder), "completer": "mirror", **options})


def test_paths_and_numpys_numbers_are_taken(folder):
    env = GfpGraspEnv(objects=folder, completer="mirror", num_points=np.int64(64), noise_m=np.float32(0))
    assert env.reset(seed=0)[0]["observed"].shape == (64, 3)


def test_a_file_that_is_no_mesh_is_refused_when_the_env_is_made(tmp_path):
    (tmp_path / "cup.txt").write_text("a cup")
    with pytest.raises(UnreadableFile, match=r"cup\.txt: suffix"):
        GfpGraspEnv(objects=str(tmp_path / "cup.txt"))
    with pytest.raises(UnreadableFile, match="subfolders are not"):
        GfpGraspEnv(objects=str(tmp_path))


HOSTILE = [
    ("cup__nan.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\nf 2 3 4\n", "not finite"),
    ("cup__faceless.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "at least one triangle"),
    ("cup__empty.stl", b"", "0 bytes"),
    ("cup__flat.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "flat"),
    ("cup__cut.ply", export_ply(cylinder())[:500], "PLY"),
    ("cup__mm.ply", export_ply(cylinder(1000.0)), "140 m long.*by 0.001"),
    ("cup__km.ply", export_ply(cylinder(0.001)), "scale it to metres"),
]


@pytest.mark.parametrize(("name", "content", "message"), HOSTILE)
def test_a_bad_file_among_good_ones_is_named_with_what_to_do(among_good_ones, name, content, message):
    path = among_good_ones(name, content)
    env = GfpGraspEnv(objects=str(path), completer="mirror", **SMALL)
    advice = f"{name.removeprefix('cup__').partition('.')[0]}.*repair it or take it out"
    with pytest.raises((InvalidMesh, UnreadableFile), match=f"{advice}.*{message}"):
        env.reset(seed=0, options={"object": 1})
    assert env.reset(seed=0, options={"object": 0})[1]["object"] == "good"


def test_a_score_refuses_all_bad_files_before_it_begins(among_good_ones):
    for name, content, _ in HOSTILE[1:3]:
        path = among_good_ones(name, content)
    with pytest.raises(InvalidMesh, match=r"2 of 3 files.*cup__empty\.stl.*cup__faceless\.obj"):
        score(path, ["mirror"], config=ScoreConfig(views=1, classes=("*",)))


def test_a_file_whose_name_is_all_mark_keeps_it(tmp_path):
    cylinder().export(tmp_path / "cup__.ply")
    assert [source.name for source in load_objects(tmp_path)] == ["cup__"]


@pytest.mark.parametrize(
    "options",
    [
        *(5, "object", [1], {1: 2, "a": 3}),
        *({"object": "x"}, {"object": 0.0}, {"object": np.arange(2)}, {"object": -1}),
        *({"completion": 3}, {"completion": cylinder()}),
    ],
)
def test_nonsense_as_reset_options_is_refused_by_name(env, options):
    with pytest.raises(InvalidOption):
        env.reset(seed=0, options=options)


@pytest.mark.parametrize("action", ["x", None, {"a": 1}, [[1, 2], [3]], np.zeros(10, complex), ["a"] * 10])
def test_an_action_that_is_no_numbers_is_refused_by_name(env, action):
    env.reset(seed=0)
    with pytest.raises(InvalidAction, match="numbers"):
        env.step(action)


def test_before_reset_any_action_is_told_to_reset_first(folder):
    with pytest.raises(gymnasium.error.ResetNeeded):
        GfpGraspEnv(objects=folder, completer="mirror").step("x")  # pyright: ignore[reportArgumentType]


def test_a_pose_that_is_not_rigid_is_refused_not_bent():
    mirrored = make_T(np.diag([-1.0, 1.0, 1.0]), (0, 0, 0.2))
    stretched = make_T(np.diag([1.0, 1.0, 0.9]), (0, 0, 0.2))
    for T in (mirrored, stretched):
        with pytest.raises(InvalidAction, match="no rotation"):
            ActionCode().encode(Grasp(T, 0.05))


def test_closing_twice_and_resetting_after_it_work(folder):
    env = GfpGraspEnv(objects=folder, completer="mirror", **SMALL)
    first, _ = env.reset(seed=4)
    env.close()
    env.close()
    again, _ = env.reset(seed=4)
    assert all(np.array_equal(first[key], again[key]) for key in first)


def test_a_view_that_sees_nothing_at_all_is_a_failed_completion(folder):
    env = GfpGraspEnv(objects=folder, completer="mirror", distance_m=1e6, **SMALL)
    observation, info = env.reset(seed=0)
    assert info["completion_error"].startswith("NothingDetected")
    assert not observation["depth"].any()


def test_a_completion_that_cannot_be_simulated_fails_its_attempts_not_the_env(folder, monkeypatch):
    def refuse(*_):
        raise InvalidScene("part 0 is a sliver")

    env = GfpGraspEnv(objects=folder, completer="observed", world="completed", **SMALL)
    monkeypatch.setattr(SceneObject, "of_parts", refuse)
    _, info = env.reset(seed=0)
    assert info["completion_error"] == "InvalidScene: part 0 is a sliver"
    assert not info["completion_failed"]
    assert env.step(np.zeros(10))[4]["reason"] == "no_grasp_found"


def test_the_docstring_tells_every_key_of_info_and_observation(env):
    observation, info = env.reset(seed=0)
    text = GfpGraspEnv.__doc__ or ""
    keys = {name for row in re.findall(r"^    \| ([a-z_, ]+?) \| ", text, re.MULTILINE) for name in row.split(", ")}
    assert keys - {"key", "entries"} == {*observation, *info}


def test_without_classes_a_detection_is_the_same_but_for_the_class(env):
    env.reset(seed=0)
    image = env.episode.image
    named, blind = detect_objects(image)[0], detect_objects(image, config=DetectConfig(classify=False))[0]
    np.testing.assert_array_equal(named.cloud.points, blind.cloud.points)
    assert named.category
    assert (blind.category, blind.scores) == ("", {})


def test_completers_that_need_no_class_load_no_torch(folder):
    code = """
import sys, gymnasium, numpy as np
for completer in ("mirror", "observed", "oracle"):
    env = gymnasium.make("gfp_grasp:GfpGrasp-v0", objects=sys.argv[1], completer=completer)
    info = env.reset(seed=0)[1]
    env.step(np.zeros(10, dtype=np.float32))
    print(completer, info["completion_failed"], "torch" in sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [f"{name} False False" for name in ("mirror", "observed", "oracle")]


@pytest.mark.slow  # a process each
def test_another_process_with_another_past_gives_the_same_bits(folder):
    code = """
import json, sys, zlib, numpy as np
from gfp_grasp.envs import GfpGraspEnv
env = GfpGraspEnv(objects=sys.argv[1], completer="mirror", sensor="realsense")
for seed in json.loads(sys.argv[2]):
    observation, info = env.reset(seed=seed)
    low = np.array([0, 0, -0.7, 0, 0, -1, 0, 1, 0, 0.3])
    info = env.step(low)[4]
print(json.dumps([{key: zlib.crc32(array.tobytes()) for key, array in observation.items()}, info]))
"""
    answers = [
        subprocess.run(
            [sys.executable, "-c", code, str(folder), json.dumps(seeds)], capture_output=True, text=True, check=True
        ).stdout
        for seeds in ([9], [1, 2, 9])
    ]
    assert answers[0] == answers[1]
    assert json.loads(answers[0])[1]["reason"]


def test_nothing_of_an_episode_outlives_it(folder):
    env = GfpGraspEnv(objects=folder, completer="observed", world="completed", **SMALL)
    traces = []
    for seed in range(4):
        env.reset(seed=seed)
        env.step(np.zeros(10))
        traces.append([weakref.ref(thing) for thing in (env.episode, env.completion, env.world)])
    gc.collect()
    assert [[trace() is not None for trace in row] for row in traces] == [[False] * 3] * 3 + [[True] * 3]


def test_few_compiled_scenes_are_kept(tmp_path):
    for number in range(20):
        cylinder().export(tmp_path / f"bottle__{number}.ply")
    env = GfpGraspEnv(objects=tmp_path, completer="observed", **SMALL)
    for number in range(20):
        env.reset(seed=0, options={"object": number})
    assert len(env.task._true_worlds) <= 16
