"""Infos, rewards and worlds of the environment, for a task whose episodes and trials are known."""

from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
import trimesh
from bodies import box_part, l_shape

from gfp_grasp.camera import intrinsics
from gfp_grasp.completion import Completion
from gfp_grasp.envs import ActionCode, EnvConfig, GfpGraspEnv, Randomisation, grasp_env
from gfp_grasp.envs.spaces import NUM_ACTION
from gfp_grasp.errors import InvalidAction, InvalidMesh, InvalidOption
from gfp_grasp.transforms import make_T
from gfp_grasp.types import CollisionMesh, CompletedShape, DepthImage, Grasp, Outcome, TrueObject

PART = box_part([0, 0, 0], [0.1, 0.06, 0.02])
TRUTH = TrueObject("ell", "mug", l_shape(), CollisionMesh((PART,), (0.0, 0.0, 0.0), "cuts", 0.0), 0.2, 0.5)
IMAGE = DepthImage(np.full((2, 4), 0.5), intrinsics(4, 2, 40.0), np.eye(4))


class Task:
    """A task whose episodes are known, and whose grasps are held where the action says so."""

    def __init__(self, config: EnvConfig) -> None:
        self.config, self.asked, self.closed = config, [], False
        self.sources, self.trial_settings = ("source",), "settings"
        self.episode: Any = None
        self.broken: Exception | None = None
        self.restored: list = []

    def draw(self, rng, **how):
        self.asked.append(("draw", how))
        cloud = SimpleNamespace(points=np.full((5, 3), 0.25))
        mesh = trimesh.creation.box((0.1, 0.1, 0.1))
        self.episode = SimpleNamespace(
            truth=TRUTH,
            randomisation=Randomisation(0.21, 0.55, 27.0),
            detection=SimpleNamespace(cloud=cloud),
            completion=SimpleNamespace(mesh=mesh),
            failure="",
            notes="a note",
            image=IMAGE,
        )
        return self.episode

    def world(self, which):
        self.asked.append(("world", which))
        if self.broken is not None:
            raise self.broken
        return SimpleNamespace(model="model", data="data", restore=lambda: self.restored.append(which))

    def run_trial(self, grasp, **how):
        self.asked.append(("trial", round(grasp.width_m, 4), how))
        held = grasp.width_m > 0.05
        return Outcome(
            held, "held" if held else "no_contact", 0.2, 0.004, held, {}, 0.3 if how["margin_trials"] else None
        )

    def close(self):
        self.closed = True


@pytest.fixture
def make(monkeypatch):
    monkeypatch.setattr(grasp_env, "GraspTask", Task)
    return lambda **options: GfpGraspEnv(num_points=8, image_width=4, image_height=2, **options)


BEFORE = {"is_success": False, "reason": "", "lift_m": 0.0, "slip_m": 0.0, "falls_free": False} | {
    "least_friction": np.inf
}
INFO = {
    **{"object": "ell", "category": "mug", "mass_kg": 0.21, "friction": 0.55, "grip_n": 27.0, "completer": "gfs"},
    **{"completion_failed": False, "completion_error": "", "completion_notes": "a note", "num_observed": 5},
}


def test_infos_and_rewards_are_those_of_the_trial(make):
    env = make(completer="gfs", margin_trials=3)
    observation, info = env.reset(seed=3, options={"object": 0})
    assert info == BEFORE | INFO | {"world": "true"}
    assert env.task.asked == [("draw", {"number": 0, "completion": None}), ("world", "true")]
    assert {key: array.shape for key, array in observation.items()} == {
        **{"observed": (8, 3), "observed_mask": (8,), "completed": (8, 3), "depth": (2, 4)}
    }
    observation["observed"][:] = 9.0  # is the caller's own
    action = np.zeros(NUM_ACTION, np.float32)
    again, reward, terminated, truncated, info = env.step(action)
    assert (reward, terminated, truncated) == (1.0, True, False)
    held = {"is_success": True, "reason": "held", "lift_m": 0.2, "slip_m": 0.004, "falls_free": True}
    assert info == held | INFO | {"world": "true", "least_friction": 0.3}
    assert again["observed"].max() == 0.25
    assert env.task.asked[-1] == ("trial", 0.06, {"world": "true", "on_step": None, "margin_trials": 3})
    action[9] = -0.5
    _, reward, _, _, info = env.step(action)
    assert (reward, info["is_success"], info["reason"], info["falls_free"]) == (0.0, False, "no_contact", False)
    env.close()
    assert env.task.closed
    with pytest.raises(gymnasium.error.ResetNeeded, match="before its first step"):
        env.step(action)


def test_a_completion_that_cannot_be_simulated_says_so_and_has_no_world(make):
    env = make(completer="gfs", world="completed")
    env.task.broken = InvalidMesh("too thin")
    _, info = env.reset(seed=3)
    assert (info["world"], info["completion_error"]) == ("completed", "InvalidMesh: too thin")
    assert info["completion_failed"] is False
    assert env.world is None
    env.step(np.zeros(NUM_ACTION, np.float32))
    assert env.task.asked[-1][2]["world"] == "completed"
    env.task.broken = None
    _, info = env.reset(seed=3)
    assert info["completion_error"] == ""
    assert env.world is not None


def test_nothing_detected_and_nothing_completed_are_told(make):
    env = make(completer="gfs")
    env.reset(seed=3)
    env.episode.detection = env.episode.completion = None
    env.episode.failure = "NothingDetected: no"
    info = env.step(np.zeros(NUM_ACTION, np.float32))[4]
    told = {"completion_failed": True, "completion_error": "NothingDetected: no", "num_observed": 0}
    assert told.items() <= info.items()


def test_what_is_asked_of_a_reset_arrives(make):
    env = make()
    shape = CompletedShape(l_shape(), np.ones(14, bool), np.ones(14))
    own = Completion(shape, None)  # type: ignore[arg-type]
    env.reset(options={"object": 2, "completion": own})
    assert env.task.asked[0] == ("draw", {"number": 2, "completion": own})
    for wrong, message in (({"x": 1}, "'x'; legal are object, completion"), ({"completion": 3}, "is a int")):
        with pytest.raises(InvalidOption, match=message):
            env.reset(options=wrong)


@pytest.mark.parametrize(("beyond", "taken"), [(0.8e-5, True), (1.2e-5, False)])
def test_rounding_may_leave_the_box_by_a_hundred_thousandth(beyond, taken):
    code = ActionCode()
    action = np.zeros(NUM_ACTION)
    action[0] = 1.0 + beyond
    grasp = Grasp(make_T(None, (0.4 * (1 + beyond), 0.0, 0.2)), 0.05)
    if taken:
        assert code.decode(action).T_world_gripper[0, 3] == pytest.approx(0.4)
        assert code.encode(grasp)[0] == 1.0
    else:
        for act in (lambda: code.decode(action), lambda: code.encode(grasp)):
            with pytest.raises(InvalidAction):
                act()
