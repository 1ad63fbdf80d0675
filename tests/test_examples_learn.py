"""The learning example: what four numbers mean, what is observed, how it is trained and what is compared."""

import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest
from recorded_calls import Recorder, recorded

from gfp_grasp.examples import learn as example
from gfp_grasp.examples.learn import AboutTheCloud, learn, main
from gfp_grasp.score import wilson_interval
from gfp_grasp.transforms import rotation_about

UP = np.array([0.0, 0.0, 1.0])


class ToyEnv(gymnasium.Env):
    """Shows one cloud, and keeps the actions."""

    def __init__(self, points: np.ndarray) -> None:
        self.points, self.actions, self.seeds = points, [], []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.seeds.append((seed, options))
        return {"completed": self.points}, {"object": "red"}

    def step(self, action: Any) -> Any:
        self.actions.append(action)
        return {"completed": 2 * self.points}, 1, True, False, {"is_success": True}


def slab(turn: float) -> np.ndarray:
    """A block of 4 by 10 by 20 cm over z = 0.02 whose narrow side lies at an angle from x, narrower at its top."""
    x, y, z = np.meshgrid([-1.0, 1.0], np.linspace(-0.05, 0.05, 6), np.linspace(0.02, 0.22, 5), indexing="ij")
    half = np.where(z > 0.2, 0.01, 0.02)
    points = np.column_stack([(half * x).ravel(), y.ravel(), z.ravel()]) @ rotation_about(UP, turn).T
    return points + np.array([0.1, -0.05, 0.0])


@pytest.mark.parametrize("turn", [0.0, 0.5])
def test_sizes_of_the_cloud_are_observed_along_its_own_axes_in_units_of_ten_centimetres(turn: float) -> None:
    toy = ToyEnv(slab(turn))
    env = AboutTheCloud(toy)
    observation, info = env.reset(seed=4, options={"a": 1})
    np.testing.assert_allclose(observation, [2.0, 0.2, 1.0, 0.4, 0.4, 0.4, 0.4, 0.2], atol=1e-5)
    assert (observation.dtype, info, toy.seeds) == (np.float32, {"object": "red"}, [(4, {"a": 1})])
    seen, reward, *ended, info = env.step(np.zeros(4))
    np.testing.assert_allclose(seen, 2 * observation, atol=1e-5)
    assert (reward, ended, info) == (1.0, [True, False], {"is_success": True})
    assert isinstance(reward, float)


def test_spaces_are_four_numbers_of_one_and_eight_sizes_up_to_six_metres() -> None:
    env = AboutTheCloud(ToyEnv(slab(0.0)))
    assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (4,), np.float32)
    assert env.observation_space == gymnasium.spaces.Box(-60.0, 60.0, (8,), np.float32)


@pytest.mark.parametrize(
    ("numbers", "height_m", "approach", "width_m"),
    [
        ((-1.0, -1.0, 0.0, -1.0), 0.02, (0.0, 0.0, -1.0), 0.0),
        ((1.0, 1.0, 0.0, 1.0), 0.22, (0.0, -1.0, 0.0), 0.08),
        ((0.0, 0.0, 0.0, 0.5), 0.12, (0.0, -(0.5**0.5), -(0.5**0.5)), 0.06),
    ],
)
def test_four_numbers_are_height_approach_turn_and_opening(
    numbers: tuple[float, ...], height_m: float, approach: tuple[float, ...], width_m: float
) -> None:
    env = AboutTheCloud(ToyEnv(slab(0.0)))
    env.reset()
    sign = np.sign(env.axes[0, 0])  # an axis has no sign
    height, tilt, _, width = numbers
    grasp = env._grasp(height, tilt, 0.0, width)
    np.testing.assert_allclose(grasp.T_world_gripper[:3, 3], (0.1, -0.05, height_m), atol=1e-9)
    np.testing.assert_allclose(grasp.T_world_gripper[:3, 2], np.array(approach) * (1.0, sign, 1.0), atol=1e-9)
    np.testing.assert_allclose(grasp.T_world_gripper[:3, 1], (sign, 0.0, 0.0), atol=1e-9)
    assert grasp.width_m == pytest.approx(width_m)
    turned = env._grasp(height, tilt, 0.5, width)
    half = rotation_about(UP, np.pi / 4) @ (sign, 0.0, 0.0)
    np.testing.assert_allclose(turned.T_world_gripper[:3, 1], half, atol=1e-9)


def test_a_grasp_stays_where_an_action_can_be() -> None:
    env = AboutTheCloud(ToyEnv(slab(0.0) + np.array([5.0, -5.0, 0.0])))
    env.reset()
    centre, half = np.array(env.code.centre_m), np.array(env.code.half_m)
    at = env._grasp(0.0, 0.0, 0.0, 0.0).T_world_gripper[:3, 3]
    np.testing.assert_allclose(at[:2], (centre + half * (1.0, -1.0, 1.0))[:2])


def test_environments_are_small_and_need_no_network(monkeypatch: pytest.MonkeyPatch) -> None:
    made = recorded(monkeypatch, "gfp_grasp.examples.learn.gymnasium.make", ToyEnv(slab(0.0)))
    assert isinstance(example.make("cup", "val", 7), AboutTheCloud)
    small = {"num_points": 256, "image_width": 160, "image_height": 120}
    options = {"objects": "cup", "split": "val", "limit": 7, "completer": "mirror"}
    assert made.only == (("gfp_grasp:GfpGrasp-v0",), options | small)


class HeldEnv:
    """Every other attempt holds; keeps seeds and actions."""

    def __init__(self) -> None:
        self.seeds: list[int] = []
        self.actions: list[Any] = []

    def reset(self, *, seed: int) -> Any:
        self.seeds.append(seed)
        return "seen", {}

    def step(self, action: Any) -> Any:
        self.actions.append(action)
        return "seen", 0.0, True, False, {"is_success": len(self.actions) % 2 == 1}


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A trainer in the place of Stable-Baselines3, and environments of both splits."""
    train, test = HeldEnv(), HeldEnv()
    predict = Recorder((np.full(4, 0.5), None))
    model = SimpleNamespace(learn=Recorder(), predict=predict)
    trainer = Recorder(model)
    module = ModuleType("stable_baselines3")
    module.SAC = trainer  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "stable_baselines3", module)
    asked = []

    def make(objects: str, split: str, limit: int) -> HeldEnv:
        asked.append((objects, split, limit))
        return {"train": train, "test": test}[split]

    monkeypatch.setattr("gfp_grasp.examples.learn.make", make)
    ticks = iter([10.0, 12.345])
    monkeypatch.setattr("gfp_grasp.examples.learn.time.process_time", lambda: next(ticks))
    return SimpleNamespace(train=train, test=test, model=model, trainer=trainer, asked=asked)


def test_a_policy_is_trained_on_one_split_and_compared_on_the_other_at_the_same_seeds(made: SimpleNamespace) -> None:
    report = learn("cup", attempts=300, held_out=3, limit=7, seed=5)
    assert made.asked == [("cup", "train", 7), ("cup", "test", 7)]
    (policy, env), named = made.trainer.only
    assert (policy, env) == ("MlpPolicy", made.train)
    schedule = {"learning_starts": 150, "gradient_steps": 4, "learning_rate": 1e-3, "ent_coef": 0.02}
    assert named == {**schedule, "policy_kwargs": {"net_arch": [64, 64]}, "seed": 5, "device": "cpu"}
    assert made.model.learn.only == ((300,), {})
    assert made.test.seeds == [6_000_000, 6_000_001, 6_000_002] * 2
    dice = np.random.default_rng(5)
    for action in made.test.actions[:3]:
        np.testing.assert_array_equal(action, dice.uniform(-1, 1, 4))
    np.testing.assert_array_equal(made.test.actions[3], np.full(4, 0.5))
    assert made.model.predict.calls == [(("seen",), {"deterministic": True})] * 3

    def row(held: int) -> dict[str, Any]:
        interval = [round(end, 3) for end in wilson_interval(held, 3)]
        return {"held": held, "attempts": 3, "rate": round(held / 3, 3), "interval": interval}

    assert report == {
        "settings": {"objects": "cup", "attempts": 300, "held_out": 3, "limit": 7, "seed": 5},
        "random": row(2),
        "trained": row(1),
        "cpu_seconds": 2.3,
    }


def test_defaults_are_bottles_and_a_thousand_attempts(made: SimpleNamespace) -> None:
    settings = learn()["settings"]
    assert settings == {"objects": "bottle", "attempts": 1000, "held_out": 100, "limit": 16, "seed": 0}
    assert made.trainer.only[1]["learning_starts"] == 200
    assert made.test.seeds[0] == 1_000_000


def test_the_program_hands_on_every_option_and_prints_rates(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    rates = {"held": 3, "attempts": 7, "interval": (0.158, 0.75)}
    report = {"random": {**rates, "held": 1}, "trained": rates}
    learnt = recorded(monkeypatch, "gfp_grasp.examples.learn.learn", report)
    words = "--objects cup --attempts 30 --held-out 7 --limit 4 --seed 5 --json"
    main([*words.split(), str(tmp_path / "a.json")])
    main([])
    assert learnt.calls == [
        (("cup",), {"attempts": 30, "held_out": 7, "limit": 4, "seed": 5}),
        (("bottle",), {"attempts": 1000, "held_out": 100, "limit": 16, "seed": 0}),
    ]
    assert capsys.readouterr().out.splitlines()[:2] == [
        "random   held 1 of 7, 95 % interval 16% to 75%",
        "trained  held 3 of 7, 95 % interval 16% to 75%",
    ]
    written = (tmp_path / "a.json").read_text()
    assert json.loads(written)["trained"]["held"] == 3
    assert written.startswith('{\n "random"')
