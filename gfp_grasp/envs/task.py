"""The task of grasping without the interface of gymnasium: episodes are drawn, grasps are tried in their worlds."""

from __future__ import annotations

import ctypes
import gc
import sys
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import count
from typing import Any, Literal

import numpy as np

from gfp_grasp.complete import Completion
from gfp_grasp.completers import get_completer
from gfp_grasp.detect import get_detector
from gfp_grasp.envs.config import EnvConfig, TrialSettings
from gfp_grasp.envs.episode import Episode, draw_episode
from gfp_grasp.envs.margin import least_friction
from gfp_grasp.envs.trial import run_trial
from gfp_grasp.errors import GfpGraspError, InvalidOption, InvalidScene
from gfp_grasp.scenes import TARGET, SceneObject, World, load_objects, place_clutter
from gfp_grasp.types import Grasp, Outcome, TrueObject

_EVERY = 32  # episodes, which leave up to 1 MB each; giving it back takes 2 % of their time
_drawn = count(1)  # by all tasks of this process: a score has one for each row


class GraspTask:
    """Objects, a camera, a completer and a gripper: what `GfpGraspEnv` and a score have in common.

    Attributes:
        config: Options of the task.
        settings: Numbers of the trials; each episode has a grip of its own.
        sources: The objects that episodes are about.
        num_kept: Compiled scenes are kept for this many objects, at up to 10 MB each; making one takes 0.2 s.
    """

    def __init__(self, config: EnvConfig, *, settings: TrialSettings = TrialSettings(), num_kept: int = 16) -> None:
        """Find the objects, the detector and the completer; no object is loaded yet.

        Args:
            config: Options.
            settings: Numbers of the trials.
            num_kept: Number of objects whose compiled scenes are kept.

        Raises:
            InvalidOption: There are no such objects.
            UnknownCompleter, UnknownDetector: There is no completer or detector of that name.
            UnreadableFile: The folder of objects holds no mesh, or a folder of primitives is none.
        """
        self.config = config
        self.settings = settings
        self.sources = load_objects(config.objects, config.split, config.limit or None)
        self._detect = get_detector(config.detector)
        self._complete = get_completer(config.completer, library=config.library)
        self.num_kept = num_kept
        self._true_worlds: OrderedDict[int, tuple[TrueObject, World]] = OrderedDict()
        self._episode: Episode | None = None
        self._true_world: World | None = None
        self._completed_world: World | None = None
        self._around: tuple[SceneObject, ...] = ()

    @property
    def episode(self) -> Episode | None:
        """The current episode; None before the first."""
        return self._episode

    @property
    def trial_settings(self) -> TrialSettings:
        """Numbers of a trial in the current episode, its grip among them."""
        if self._episode is None:
            return self.settings
        return replace(self.settings, grip_n=self._episode.randomisation.grip_n)

    def draw(
        self, rng: np.random.Generator, *, number: int | None = None, completion: Completion | None = None
    ) -> Episode:
        """Draw an episode, which becomes the current one.

        Args:
            rng: Draws everything; `np.random.default_rng(seed)` gives the episode of `GfpGraspEnv.reset(seed=seed)`.
            number: Number of the object among the sources; a random one where it is None.
            completion: Used in place of what the completer would give.

        Raises:
            InvalidOption: There is no object of that number.
            InvalidMesh, UnreadableFile, DecompositionFailed, InvalidScene: The object cannot be simulated; the message
                names it, and the episode before it stays the current one.
        """
        _give_back_memory()
        drawn = int(rng.integers(len(self.sources)))  # always, so that later draws do not depend on the number
        number = drawn if number is None else number
        if not isinstance(number, (int, np.integer)) or not 0 <= number < len(self.sources):
            raise InvalidOption(f"there is no object {number!r}; there are 0 to {len(self.sources) - 1}")
        truth, world, T_start, around = self._scene(int(number), rng)
        self._episode = draw_episode(
            truth, world, self._detect, self._complete, self.config, rng, T_start=T_start, completion=completion
        )
        self._true_world, self._completed_world, self._around = world, None, around
        return self._episode

    def world(self, which: Literal["true", "completed"] = "true") -> World | None:
        """The scene of the current episode; None where there is no episode or no completion to simulate.

        Args:
            which: "true", or "completed": the completion's convex parts in place of the object.

        Raises:
            GfpGraspError: The completion has no parts, or none that MuJoCo takes.
        """
        episode = self._episode
        if episode is None or which == "true":
            return self._true_world
        if self._completed_world is None and episode.completion is not None:
            drawn, parts = episode.randomisation, episode.completion.collision.parts
            self._completed_world = World([SceneObject.of_parts(parts, drawn.mass_kg, drawn.friction), *self._around])
        return self._completed_world

    def run_trial(
        self,
        grasp: Grasp,
        *,
        world: Literal["true", "completed"] = "true",
        on_step: Callable[[Any], None] | None = None,
        margin_trials: int = 0,
    ) -> Outcome:
        """Try a grasp in the current episode, on the scene as it was drawn.

        Args:
            grasp: World frame.
            world: See `world`. The parts of a completion weigh nothing until the jaws have closed.
            on_step: Called with the state after every command, e.g. to film.
            margin_trials: So many more trials look for `Outcome.least_friction`, see `least_friction`; the scene is
                left as the first trial ended.

        Returns:
            What happened; `no_grasp_found` where there is no such world.
        """
        try:
            scene = self.world(world)
        except GfpGraspError:
            scene = None
        if scene is None:
            return Outcome(False, "no_grasp_found", 0.0, 0.0, False, self.trial_settings.as_dict())
        floats = world == "completed"
        outcome = run_trial(scene, grasp, self.trial_settings, floats=floats, on_step=on_step)
        if not margin_trials:
            return outcome
        assert self._episode is not None
        drawn, at_end = self._episode.randomisation, scene.snapshot()

        def attempt(friction: float) -> Outcome:
            scene.set_mass_and_friction(TARGET, drawn.mass_kg, friction)
            return run_trial(scene, grasp, self.trial_settings, floats=floats)

        try:
            least = least_friction(attempt, outcome, num_trials=margin_trials)
        finally:
            scene.set_mass_and_friction(TARGET, drawn.mass_kg, drawn.friction)
            scene.resume(at_end)
        return replace(outcome, least_friction=least)

    def close(self) -> None:
        """Let go of the compiled scenes and the episode."""
        self._true_worlds.clear()
        self._true_world = self._completed_world = self._episode = None
        self._around = ()

    def _scene(
        self, number: int, rng: np.random.Generator
    ) -> tuple[TrueObject, World, np.ndarray | None, tuple[SceneObject, ...]]:
        """The object, its world, where it is to be put down if that is drawn already, and what stands around it."""
        truth, world = self._true_world_of(number)
        if not self.config.clutter:
            return truth, world, None, ()
        drawn = rng.integers(len(self.sources), size=self.config.clutter)
        others = [self._true_world_of(int(other))[0] for other in drawn]
        T_start, *places = _placed(truth, others, rng)
        # They are stuck to the table: hundreds of contacts of things at rest would take most of the time, and whatever
        # touches them has failed in any case.
        around = tuple(
            replace(SceneObject.of(other, T, name=f"clutter_{i}"), fixed=True)
            for i, (other, T) in enumerate(zip(others, places, strict=True))
        )
        return truth, World([SceneObject.of(truth, T_start, name=TARGET), *around]), T_start, around

    def _true_world_of(self, number: int) -> tuple[TrueObject, World]:
        if number not in self._true_worlds:
            source = self.sources[number]
            try:
                truth = source.load(library=self.config.library)
                world = World([SceneObject.of(truth, np.eye(4), name=TARGET)])
            except GfpGraspError as error:
                if source.path is None:
                    raise InvalidOption(
                        f"objects is {self.config.objects!r}, and {source.name!r} of it is nothing that a table holds: "
                        f"take household families, or files of your own ({error})"
                    ) from error
                advice = f"repair it or take it out of {self.config.objects!r}"
                raise type(error)(f"object {source.name!r} cannot be simulated, {advice}: {error}") from error
            self._true_worlds[number] = truth, world
            if len(self._true_worlds) > self.num_kept:
                self._true_worlds.popitem(last=False)
        self._true_worlds.move_to_end(number)
        return self._true_worlds[number]


def _placed(truth: TrueObject, others: list[TrueObject], rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Places of the object and of those around it; the widest of these are taken out where all find no place."""
    while others:
        try:
            return place_clutter([truth, *others], rng)
        except InvalidScene:
            others.remove(max(others, key=lambda other: float(np.linalg.norm(other.mesh.extents[:2]))))
    return place_clutter([truth], rng)


def _give_back_memory() -> None:
    """At every 32nd call, collect garbage and hand what the heap has free back to the system.

    Trimesh's meshes refer to themselves in circles, few objects with much memory, which Python counts but does not
    weigh: left to itself it collects them after thousands of meshes. And glibc keeps what was freed between two things
    that stay; on other systems that is left to the system.
    """
    if next(_drawn) % _EVERY:
        return
    gc.collect()
    if sys.platform == "linux":
        with suppress(AttributeError, OSError):  # a libc without it, such as musl
            ctypes.CDLL(None).malloc_trim(0)
