"""After a fault the environment goes on as if it had not been: the same step, the same reset, the same bits."""

from typing import Any

import numpy as np
import pytest
import trimesh

from gfp_grasp.envs import GfpGraspEnv
from gfp_grasp.errors import (
    DecompositionFailed,
    GfpGraspError,
    InvalidAction,
    InvalidMesh,
    InvalidScene,
    UnreadableFile,
)
from gfp_grasp.types import REASONS

pytestmark = pytest.mark.filterwarnings("error")
SMALL: dict[str, Any] = {"completer": "mirror", "num_points": 64, "image_width": 120, "image_height": 90}
# Level, at mid-height, at the middle of the table.
LEVEL = np.array([0, 0, -0.43, 1, 0, 0, 0, 1, 0, 0.3])


def cylinder():
    mesh = trimesh.creation.cylinder(0.03, 0.14, sections=32)
    mesh.apply_translation((0, 0, 0.07))
    return mesh


@pytest.fixture
def folder(tmp_path):
    cylinder().export(tmp_path / "bottle__good.ply")
    return tmp_path


def same(a, b):
    return all(np.array_equal(a[0][key], b[0][key]) for key in a[0]) and a[-1] == b[-1]


def level_with(value, at=0):
    action = LEVEL.copy()
    action[at] = value
    return action


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (level_with(np.nan, at=9), "1 entries that are not finite"),
        (level_with(np.inf), "1 entries that are not finite"),
        (np.full(10, -np.inf), "10 entries that are not finite"),
        (LEVEL[:9], r"shape \(9,\); \(10,\)"),
        (LEVEL[:, None], r"shape \(10, 1\)"),
        (np.stack([LEVEL, LEVEL]), r"shape \(2, 10\)"),
        (0.5, r"shape \(\)"),
        ([], r"shape \(0,\)"),
        (level_with(1.01), "reaches 1.01; every entry must lie between -1 and 1"),
        (level_with(-1e300), r"reaches 1e\+300"),
    ],
)
def test_a_bad_action_is_refused_and_the_episode_stands_as_it_was(folder, action, message):
    env = GfpGraspEnv(objects=folder, spread_m=0.0, **SMALL)
    start = env.reset(seed=3)
    before = env.step(LEVEL)
    assert before[4]["is_success"]
    with pytest.raises(InvalidAction, match=message):
        env.step(action)
    assert same(before, env.step(LEVEL))
    assert same(start, env.reset(seed=3))


def test_what_rounding_leaves_outside_of_the_box_is_taken(folder):
    env = GfpGraspEnv(objects=folder, **SMALL)
    env.reset(seed=0)
    edge = np.nextafter(np.ones(10, dtype=np.float32), np.float32(2))
    assert same(env.step(edge), env.step(np.ones(10)))


@pytest.mark.parametrize("corner", [-1.0, 1.0])
@pytest.mark.parametrize("world", ["true", "completed"])
def test_the_corners_of_the_box_end_in_a_named_outcome(folder, world, corner):
    env = GfpGraspEnv(objects=folder, world=world, **SMALL)
    env.reset(seed=0)
    for action in (np.full(10, corner), level_with(corner, at=2), level_with(corner, at=9)):
        _, reward, terminated, _, info = env.step(action)
        assert terminated
        assert info["reason"] in REASONS
        assert np.isfinite([reward, info["lift_m"], info["slip_m"]]).all()


SLIVERS = {
    "sheet": trimesh.creation.box((0.1, 0.1, 1e-5)),
    "needle": trimesh.creation.box((1e-5, 1e-5, 0.1)),
    "crumb": trimesh.creation.icosphere(radius=1e-5),
}
FILES = {"text.stl": b"no mesh at all", "noise.glb": bytes(range(256)) * 20, "marks.obj": b"\xff\xfe\x00"}


@pytest.mark.parametrize("name", [*SLIVERS, *FILES])
def test_a_mesh_that_cannot_be_simulated_is_named_at_each_reset_and_the_others_go_on(folder, name):
    if name in SLIVERS:
        SLIVERS[name].export(folder / f"cup__{name}.ply")
    else:
        (folder / f"cup__{name}").write_bytes(FILES[name])
    env = GfpGraspEnv(objects=folder, spread_m=0.0, **SMALL)
    start = env.reset(seed=3, options={"object": 0})
    bad = rf"object '{name.partition('.')[0]}' cannot be simulated, repair it or take it out of"
    for _ in range(2):
        with pytest.raises((DecompositionFailed, InvalidMesh, UnreadableFile), match=bad):
            env.reset(seed=3, options={"object": 1})
    assert same(start, env.reset(seed=3, options={"object": 0}))
    assert env.step(LEVEL)[4]["is_success"]


def test_a_mesh_that_mujoco_itself_refuses_is_named_and_the_same_env_takes_it_once_it_is_repaired(folder, monkeypatch):
    said = "MuJoCo does not compile the scene: mesh volume is too small: object_part_000"

    def refuse(*_):
        raise InvalidScene(said)

    env = GfpGraspEnv(objects=folder, **SMALL)
    with monkeypatch.context() as patch:
        patch.setattr("gfp_grasp.envs.task.World", refuse)
        with pytest.raises(InvalidScene, match=f"object 'good' cannot be simulated.*{said}"):
            env.reset(seed=0)
    assert same(env.reset(seed=0), GfpGraspEnv(objects=folder, **SMALL).reset(seed=0))


def test_a_reset_that_failed_leaves_the_episode_before_it_to_be_stepped_in(folder):
    (folder / "cup__text.stl").write_bytes(b"no mesh at all")
    env = GfpGraspEnv(objects=folder, spread_m=0.0, **SMALL)
    env.reset(seed=3, options={"object": 0})
    before = env.step(LEVEL)
    with pytest.raises(GfpGraspError):
        env.reset(seed=4, options={"object": 1})
    assert same(before, env.step(LEVEL))


def test_a_simulation_that_breaks_ends_as_unstable_and_the_next_attempt_is_sound(folder):
    env = GfpGraspEnv(objects=folder, spread_m=0.0, **SMALL)
    env.reset(seed=3)
    before = env.step(LEVEL)
    world = env.world
    assert world is not None
    restore = world.restore

    def broken():
        restore()
        world.data.qvel[:] = np.nan

    world.restore = broken
    _, reward, _, _, info = env.step(LEVEL)
    assert (reward, info["reason"]) == (0.0, "unstable")
    world.restore = restore
    assert same(before, env.step(LEVEL))
