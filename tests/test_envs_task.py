"""Trials of a task without gymnasium's interface: both its worlds, their clutter, its settings, and what it keeps."""

import numpy as np
import pytest
import trimesh
from grasp_tasks import LEVEL, SMALL, TINY, task_of, written_objects

from gfp_grasp.envs import ActionCode, EnvConfig, GfpGraspEnv, GraspTask, TrialSettings
from gfp_grasp.errors import InvalidOption, InvalidScene
from gfp_grasp.grasps import plan_grasps
from gfp_grasp.scenes import TARGET, SceneObject


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return written_objects(tmp_path_factory.mktemp("objects"))


def test_the_task_draws_what_the_environment_does(folder):
    env, task = GfpGraspEnv(objects=folder, **SMALL), task_of(folder)
    for seed in (3, 4):
        env.reset(seed=seed)
        mine = task.draw(np.random.default_rng(seed))
        assert task.episode is mine
        theirs = env.episode
        assert mine.truth.name == theirs.truth.name
        np.testing.assert_array_equal(mine.image.depth_m, theirs.image.depth_m)
        np.testing.assert_array_equal(mine.T_world_object, theirs.T_world_object)
        assert mine.randomisation == theirs.randomisation
        assert mine.completion is not None
        action = ActionCode().encode(plan_grasps(mine.completion, 1)[0])
        outcome, info = task.run_trial(ActionCode().decode(action)), env.step(action)[4]
        assert (outcome.reason, outcome.slip_m) == (info["reason"], info["slip_m"])
        assert outcome.settings["grip_n"] == mine.randomisation.grip_n


def test_both_worlds_of_an_episode_take_the_same_grasp(folder):
    task = task_of(folder, spread_m=0.0)
    task.draw(np.random.default_rng(1), number=1)
    true, completed = (task.run_trial(LEVEL, world=world) for world in ("true", "completed"))
    assert (true.reason, completed.reason) == ("held", "held")
    assert true != completed
    assert task.run_trial(LEVEL) == true
    parts, whole = task.world("completed"), task.world()
    assert parts is not None
    assert whole is not None
    assert parts is task.world("completed")  # compiled once
    assert parts is not whole
    assert task.episode is not None
    drawn = task.episode.randomisation
    for world in (parts, whole):
        assert world.model.body(TARGET).mass[0] == pytest.approx(drawn.mass_kg)
        assert set(world.model.geom_friction[world.geoms(TARGET), 0]) == {drawn.friction}
    task.draw(np.random.default_rng(2), number=1)
    assert task.world("completed") is not parts


def test_a_completed_world_stands_among_the_same_clutter(folder):
    task = task_of(folder, clutter=2)
    task.draw(np.random.default_rng(0))
    true, completed = task.world(), task.world("completed")
    assert true is not None
    assert completed is not None
    assert true.names == completed.names == (TARGET, "clutter_0", "clutter_1")
    for name in true.names[1:]:
        np.testing.assert_array_equal(true.pose(name), completed.pose(name))
    assert all(thing.fixed for thing in true.objects[1:])
    assert not true.objects[0].fixed


def test_the_widest_of_the_clutter_are_taken_out_where_all_find_no_place(tmp_path):
    for name, radius_m in (("plain", 0.03), ("slim", 0.02), ("wide", 0.43)):
        mesh = trimesh.creation.cylinder(radius_m, 0.1, sections=24)
        mesh.apply_translation((0, 0, 0.05))
        mesh.export(tmp_path / f"can__{name}.ply")
    task = task_of(str(tmp_path), clutter=3)
    names = set()
    for seed in range(6):
        task.draw(np.random.default_rng(seed), number=0)
        world = task.world()
        assert world is not None
        widest = max(float(np.ptp(part.vertices[:, 0])) for thing in world.objects for part in thing.parts)
        assert widest == pytest.approx(0.06)  # what is 0.86 m wide leaves no place for any other
        names.add(world.names)
    assert names == {(TARGET, "clutter_0"), (TARGET, *(f"clutter_{i}" for i in range(3)))}


def test_no_completion_or_none_that_can_be_simulated_is_no_grasp(folder, monkeypatch):
    task = task_of(folder, completer="own_completers:gives_up", **TINY)
    assert task.world() is None
    assert task.run_trial(LEVEL).reason == "no_grasp_found"
    task.draw(np.random.default_rng(0))
    assert task.world("completed") is None
    assert task.run_trial(LEVEL, world="completed").reason == "no_grasp_found"
    assert task.run_trial(LEVEL).reason != "no_grasp_found"

    def refuse(*_, **__):
        raise InvalidScene("a sliver")

    task = task_of(folder)
    task.draw(np.random.default_rng(0))
    monkeypatch.setattr(SceneObject, "of_parts", refuse)
    with pytest.raises(InvalidScene):
        task.world("completed")
    assert task.run_trial(LEVEL, world="completed").reason == "no_grasp_found"


def test_a_task_has_settings_of_its_own_but_for_the_grip(folder):
    task = GraspTask(EnvConfig(objects=folder, **SMALL), settings=TrialSettings(lift_m=0.1, grip_n=3.0))
    assert task.trial_settings.grip_n == 3.0
    episode = task.draw(np.random.default_rng(0))
    assert task.trial_settings == TrialSettings(lift_m=0.1, grip_n=episode.randomisation.grip_n)


def test_scenes_of_so_many_objects_are_kept_those_used_last(folder):
    task = GraspTask(EnvConfig(objects=folder, **SMALL), num_kept=2)
    for number in (0, 1, 0, 2):
        task.draw(np.random.default_rng(0), number=number)
    assert list(task._true_worlds) == [0, 2]
    with pytest.raises(InvalidOption, match="there is no object 3; there are 0 to 2"):
        task.draw(np.random.default_rng(0), number=3)
    task.close()
    assert task.episode is task.world() is None
    assert not task._true_worlds
