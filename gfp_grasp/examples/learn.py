"""Learning to grasp on one CPU core in a few minutes: `python -m gfp_grasp.examples.learn`.

A grasp is ten numbers, of which random ones never hold anything. Here a policy chooses four, about the cloud that the
environment has completed: how high, from how steep, how far turned from the narrow side, and how wide open. It is
trained on objects of one split and compared with random choices of the same four numbers on those of another.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from gfp_grasp.envs import ActionCode
from gfp_grasp.errors import InvalidOption
from gfp_grasp.journal import write_whole
from gfp_grasp.score import wilson_interval
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import Grasp

_UP = np.array([0.0, 0.0, 1.0])
_STROKE_M = 0.08
_SLICES = 5
Policy = Callable[[np.ndarray], np.ndarray]


class AboutTheCloud(gymnasium.Wrapper):
    """Four numbers in place of a grasp, eight sizes in place of clouds and picture.

    | action | meaning | at -1 | at +1 |
    |---|---|---|---|
    | 0 | height of the gripper's origin | foot of the cloud | its top |
    | 1 | approach | straight down | level |
    | 2 | turn of the closing axis about up, from the cloud's narrow side | -90 degrees | 90 degrees |
    | 3 | opening of the jaws | 0 | 0.08 m |

    Observation, in units of 0.1 m: the cloud's height, that of its foot, its wide side, and its narrow side by fifths
    of its points from the lowest up.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        super().__init__(env)
        self.code = ActionCode()
        self.action_space = spaces.Box(-1.0, 1.0, (4,), np.float32)
        self.observation_space = spaces.Box(-60.0, 60.0, (3 + _SLICES,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Look at the next object."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._seen(observation), info

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Attempt the grasp that the four numbers mean."""
        grasp = self.code.encode(self._grasp(*np.asarray(action, dtype=float)))
        observation, reward, terminated, truncated, info = self.env.step(grasp)
        return self._seen(observation), float(reward), terminated, truncated, info

    def _seen(self, observation: dict[str, np.ndarray]) -> np.ndarray:
        """Sizes of the completed cloud, along its own axes; they and its place are remembered for the grasp."""
        points = observation["completed"].astype(float)
        self.axes = np.linalg.eigh(np.cov(points[:, :2].T))[1]
        along = np.column_stack([points[:, :2] @ self.axes, points[:, 2]])
        self.low, self.high = along.min(axis=0), along.max(axis=0)
        narrow = [np.ptp(part[:, 0]) for part in np.array_split(along[np.argsort(along[:, 2])], _SLICES)]
        _, wide, height = self.high - self.low
        return np.array([height, self.low[2], wide, *narrow], dtype=np.float32) * 10

    def _grasp(self, height: float, tilt: float, turn: float, width: float) -> Grasp:
        closing = rotation_about(_UP, turn * np.pi / 2) @ [*self.axes[:, 0], 0.0]
        steep = (tilt + 1) * np.pi / 4
        approach = np.sin(steep) * np.cross(closing, _UP) - np.cos(steep) * _UP
        middle = self.axes @ (self.low + self.high)[:2] / 2
        at = [*middle, self.low[2] + (height + 1) / 2 * (self.high - self.low)[2]]
        low, high = np.array(self.code.centre_m) + np.outer([-1, 1], self.code.half_m)
        R = np.column_stack([np.cross(closing, approach), closing, approach])
        return Grasp(make_T(R, np.clip(at, low, high)), (width + 1) / 2 * _STROKE_M)


def make(objects: str, split: str, limit: int) -> AboutTheCloud:
    """The environment with few objects, small pictures and a completer that needs no network."""
    options: dict[str, Any] = {"objects": objects, "split": split, "limit": limit, "completer": "mirror"}
    small: dict[str, Any] = {"num_points": 256, "image_width": 160, "image_height": 120}
    return AboutTheCloud(gymnasium.make("gfp_grasp:GfpGrasp-v0", **options, **small))


def learn(
    objects: str = "bottle", *, attempts: int = 1000, held_out: int = 100, limit: int = 16, seed: int = 0
) -> dict[str, Any]:
    """Train on the train split, and compare with random choices on the test split.

    Args:
        objects: Families of shapes, with commas between.
        attempts: Grasps to learn from.
        held_out: Grasps to compare on, at the same seeds for both.
        limit: Objects of each split; up to 16 stay compiled.
        seed: Seed of every random choice.

    Returns:
        {"settings", "random" and "trained": {"held", "attempts", "rate", "interval": Wilson's, of 95 %}, "cpu_seconds":
        of all}.

    Raises:
        InvalidOption: Stable-Baselines3 is not installed.
    """
    try:
        from stable_baselines3 import SAC  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise InvalidOption("learning needs Stable-Baselines3: pip install 'gfp-grasp[learn]'") from error
    start = time.process_time()
    # One step an episode: no discount, and a network that has to learn no more than which grasps hold.
    model = SAC(
        "MlpPolicy",
        make(objects, "train", limit),
        learning_starts=min(200, attempts // 2),
        gradient_steps=4,
        learning_rate=1e-3,
        ent_coef=0.02,
        policy_kwargs={"net_arch": [64, 64]},
        seed=seed,
        device="cpu",
    )
    model.learn(attempts)
    test, dice = make(objects, "test", limit), np.random.default_rng(seed)
    policies: dict[str, Policy] = {
        "random": lambda _: dice.uniform(-1, 1, 4),
        "trained": lambda observation: model.predict(observation, deterministic=True)[0],
    }
    rates = {name: _rate(test, policy, held_out, seed) for name, policy in policies.items()}
    settings = {"objects": objects, "attempts": attempts, "held_out": held_out, "limit": limit, "seed": seed}
    return {"settings": settings, **rates, "cpu_seconds": round(time.process_time() - start, 1)}


def _rate(env: AboutTheCloud, policy: Policy, attempts: int, seed: int) -> dict[str, Any]:
    held = 0
    for number in range(attempts):
        observation, _ = env.reset(seed=1_000_000 * (seed + 1) + number)
        held += int(env.step(policy(observation))[4]["is_success"])
    low, high = wilson_interval(held, attempts)
    return {
        "held": held,
        "attempts": attempts,
        "rate": round(held / attempts, 3),
        "interval": [round(low, 3), round(high, 3)],
    }


def main(arguments: list[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m gfp_grasp.examples.learn", description=__doc__)
    parser.add_argument("--objects", default="bottle", help="families of shapes, with commas between")
    parser.add_argument("--attempts", type=int, default=1000, help="grasps to learn from")
    parser.add_argument("--held-out", type=int, default=100, help="grasps to compare on")
    parser.add_argument("--limit", type=int, default=16, help="objects of each split")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    chosen = vars(parser.parse_args(arguments))
    path = chosen.pop("json")
    report = learn(chosen.pop("objects"), **chosen)
    for name in ("random", "trained"):
        held, attempts, (low, high) = (report[name][key] for key in ("held", "attempts", "interval"))
        sys.stdout.write(f"{name:8} held {held} of {attempts}, 95 % interval {low:.0%} to {high:.0%}\n")
    if path is not None:
        write_whole(path, json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
