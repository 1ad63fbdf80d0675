"""The gymnasium environment `GfpGrasp-v0`."""

from __future__ import annotations

import dataclasses
from inspect import Parameter, Signature
from typing import Any, ClassVar, Literal

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import EzPickle

from gfp_grasp.complete import Completion
from gfp_grasp.envs.config import EnvConfig, TrialSettings
from gfp_grasp.envs.episode import Episode
from gfp_grasp.envs.picture import HumanView, has_display, shade
from gfp_grasp.envs.spaces import NUM_ACTION, ActionCode, Observation, observation_space, observe
from gfp_grasp.envs.task import GraspTask
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.scenes import ObjectSource, World
from gfp_grasp.types import Outcome

_RESET_OPTIONS = ("object", "completion")


class GfpGraspEnv(gymnasium.Env[Observation, np.ndarray], EzPickle):
    """One object on a table, alone or among clutter, one depth view of it, one grasp.

    An episode is one step: the action is a grasp, which is approached, closed, lifted and shaken
    (`gfp_grasp.envs.TrialSettings` has every number of it). The reward is 1 where the object is held to the
    end and 0 elsewhere; `terminated` is always True, `truncated` always False. Stepping again without a reset tries
    another grasp on the same scene, as it was. With world="completed" the completion's convex parts stand in for the
    object, and weigh nothing until the jaws have closed.

    Action, `Box(-1, 1, (10,), float32)`; world frame, z up, the table's top at z = 0:

    | entries | meaning | at -1 | at +1 |
    |---|---|---|---|
    | 0:3 | position of the gripper's origin (midway between its pads), m | (-0.4, -0.4, -0.1) | (0.4, 0.4, 0.5) |
    | 3:6 | approach direction (gripper's z), any length; shorter than 1e-4: straight down | | |
    | 6:9 | closing axis (gripper's y), any length; made square to the approach | | |
    | 9 | opening of the jaws before they close, m; more than 0.08 is `unreachable_width` | 0 | 0.12 |

    `env.unwrapped.action_code` encodes and decodes `gfp_grasp.types.Grasp`.

    Observation:

    | key | shape, type | meaning |
    |---|---|---|
    | observed | (num_points, 3) float32 | points seen on the object, m: at most so many, at random; then zeros |
    | observed_mask | (num_points,) int8 | 1 where `observed` has a point |
    | completed | (num_points, 3) float32 | samples of the completed surface, m; zeros where completion failed |
    | depth | (image_height, image_width) float32 | the depth picture, m, up to 10; 0 where nothing came back |

    Points are in the world's frame, clipped to 2 m; rows stand in no particular order.

    Info has the same keys after reset and step:

    | key | type | meaning |
    |---|---|---|
    | is_success | bool | held to the end |
    | reason | str | one of `gfp_grasp.types.REASONS`; "" before a trial |
    | lift_m | float | height that the object had gained when the trial ended |
    | slip_m | float | the most that it slipped in the gripper |
    | falls_free | bool | fell when the jaws opened at last; False where it was not held until then |
    | least_friction | float | least friction at which the grasp holds; inf at none, or without `margin_trials` |
    | object, category | str | name and class of the true object; the class is "" where it is unknown |
    | mass_kg, friction | float | of the object in this episode |
    | grip_n | float | force limit of each jaw |
    | completer, world | str | as in the options |
    | completion_failed | bool | nothing was detected or completed; a step in the completed world is `no_grasp_found` |
    | completion_error | str | the error that ended detection, completion or its simulation; "" where none did |
    | completion_notes | str | warnings given on the way, and why the likeliest class did not answer |
    | num_observed | int | points seen on the object, before they are thinned; 0 where nothing was detected |

    Options of the constructor are those of `gfp_grasp.envs.EnvConfig`, whose docstring tells what each means;
    `inspect.signature(GfpGraspEnv)` lists them with their defaults. Options of reset: `object` (number of the object,
    instead of a random one) and `completion` (a `Completion` to be used instead of the completer's).

    Raises:
        InvalidOption: An option that is unknown or not legal; the message lists what is.
        UnreadableFile: The folder of objects holds no mesh, or, at reset, a file is none.
        InvalidMesh: At reset: the file of the object that was drawn cannot be used; the message names it.
        InvalidAction: An action that is not a finite vector of the action space.
        gymnasium.error.ResetNeeded: A step before the first reset.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": ["rgb_array", "human"] if has_display() else ["rgb_array"],
        "render_fps": 1,
    }

    # What tools and people see of the constructor: the options by name, with types and defaults.
    __signature__: ClassVar[Signature] = Signature(
        [
            Parameter(option.name, Parameter.KEYWORD_ONLY, default=option.default, annotation=option.type)
            for option in dataclasses.fields(EnvConfig)
        ]
    )

    def __init__(self, **options: Any) -> None:
        EzPickle.__init__(self, **options)
        self.config = EnvConfig.of(options)
        self.render_mode = self.config.render_mode
        self.action_code = ActionCode()
        self.action_space = spaces.Box(-1.0, 1.0, (NUM_ACTION,), np.float32)
        self.observation_space = observation_space(self.config)  # pyright: ignore[reportAttributeAccessIssue]
        self.task = GraspTask(self.config)
        self._observation: Observation | None = None
        self._failure = ""
        self._human = HumanView() if self.render_mode == "human" else None

    @property
    def sources(self) -> tuple[ObjectSource, ...]:
        """The objects that episodes are about, by number."""
        return self.task.sources

    @property
    def episode(self) -> Episode:
        """The scene of the current episode, with its detection and completion.

        Raises:
            gymnasium.error.ResetNeeded: Before the first reset.
        """
        if self.task.episode is None:
            raise gymnasium.error.ResetNeeded("reset the environment first: there is no episode yet")
        return self.task.episode

    @property
    def completion(self) -> Completion | None:
        """The completed object of the current episode; None where completion failed."""
        return self.episode.completion

    @property
    def trial_settings(self) -> TrialSettings:
        """Numbers of a trial in the current episode, its grip among them."""
        return self.task.trial_settings

    @property
    def world(self) -> World | None:
        """The compiled scene that trials of the current episode run in; None where there is none."""
        return None if self._failure else self.task.world(self._which)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Draw an object, its place and a view; detect and complete it."""
        super().reset(seed=seed)
        number, completion = _asked_for(options)
        episode = self.task.draw(self.np_random, number=number, completion=completion)
        self._failure = ""
        try:
            self.task.world(self._which)
        except GfpGraspError as error:  # the completion has no parts, or none that MuJoCo takes
            self._failure = f"{type(error).__name__}: {error}"
        self._observation = observe(episode, self.config, self.np_random)
        self._show()
        return _copy(self._observation), self._info(None)

    def step(self, action: np.ndarray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Try one grasp."""
        if self._observation is None:
            raise gymnasium.error.ResetNeeded("reset the environment before its first step")
        grasp = self.action_code.decode(action)
        watch = None
        if self._human is not None and self.world is not None:
            self.world.restore()
            self._show()
            watch = self._human.follow
        outcome = self.task.run_trial(grasp, world=self._which, on_step=watch, margin_trials=self.config.margin_trials)
        return _copy(self._observation), float(outcome.success), True, False, self._info(outcome)

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Picture (240, 320, 3) uint8 of the scene as it stands, shaded by ray casting; None in MuJoCo's viewer."""
        if self.render_mode is None:
            gymnasium.logger.warn('render was called without a render_mode: make the environment with "rgb_array"')
            return None
        if self._human is not None:
            self._show()
            return None
        if self.world is None:  # not reset yet, or nothing to simulate
            return np.zeros((240, 320, 3), dtype=np.uint8)
        return shade(self.world.model, self.world.data)

    def close(self) -> None:
        """Let go of the compiled scenes."""
        if self._human is not None:
            self._human.close()
        self.task.close()
        self._observation = None

    @property
    def _which(self) -> Literal["true", "completed"]:
        return "completed" if self.config.world == "completed" else "true"

    def _show(self) -> None:
        if self._human is not None and self.world is not None:
            self._human.show(self.world.model, self.world.data)

    def _info(self, outcome: Outcome | None) -> dict[str, Any]:
        episode = self.episode
        return {
            "is_success": bool(outcome and outcome.success),
            "reason": outcome.reason if outcome else "",
            "lift_m": outcome.lift_m if outcome else 0.0,
            "slip_m": outcome.slip_m if outcome else 0.0,
            "falls_free": bool(outcome and outcome.falls_free),
            "least_friction": outcome.least_friction if outcome and outcome.least_friction is not None else np.inf,
            "object": episode.truth.name,
            "category": episode.truth.category,
            "mass_kg": episode.randomisation.mass_kg,
            "friction": episode.randomisation.friction,
            "grip_n": episode.randomisation.grip_n,
            "completer": self.config.completer,
            "world": self.config.world,
            "completion_failed": episode.completion is None,
            "completion_error": episode.failure or self._failure,
            "completion_notes": episode.notes,
            "num_observed": 0 if episode.detection is None else len(episode.detection.cloud.points),
        }


def _asked_for(options: dict[str, Any] | None) -> tuple[int | None, Completion | None]:
    """Number of the object and the completion that the options of a reset ask for."""
    if options is None:
        return None, None
    legal = ", ".join(_RESET_OPTIONS)
    if not isinstance(options, dict):
        raise InvalidOption(f"reset options are {options!r}; a dict is expected, of {legal}")
    unknown = [key for key in options if key not in _RESET_OPTIONS]
    if unknown:
        raise InvalidOption(f"unknown reset option {', '.join(map(repr, unknown))}; legal are {legal}")
    completion = options.get("completion")
    if completion is not None and not isinstance(completion, Completion):
        raise InvalidOption(f"completion is a {type(completion).__name__}; a Completion or None is expected")
    return options.get("object"), completion


def _copy(observation: Observation) -> Observation:
    return {key: array.copy() for key, array in observation.items()}
