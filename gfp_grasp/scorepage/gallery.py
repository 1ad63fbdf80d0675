"""Failures made again from their seeds: a picture of each completion over the truth, and a clip of the attempt."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path

from PIL import Image

from gfp_grasp.demo.attempt import filmed_trial
from gfp_grasp.demo.pictures import write_clip
from gfp_grasp.envs.grasp_env import GfpGraspEnv
from gfp_grasp.envs.world import TARGET
from gfp_grasp.errors import CannotWrite, GfpGraspError, InvalidOption
from gfp_grasp.grasps.planners import planner
from gfp_grasp.report import Report, Trial, row_names
from gfp_grasp.scenes import load_objects
from gfp_grasp.scorepage.failures import Exhibit
from gfp_grasp.scorepage.overlay import overlay
from gfp_grasp.scorepage.words import spoken
from gfp_grasp.types import Grasp

# Twice as many pictures as the demonstration takes: many a failure is over in half a second.
_COMMANDS_A_FRAME = 8


Progress = Callable[[Iterable[Exhibit], int], Iterable[Exhibit]]


def make_exhibits(
    trials: Sequence[Trial],
    report: Report,
    directory: Path,
    *,
    objects: str | Path,
    split: str,
    progress: Progress | None = None,
) -> tuple[Exhibit, ...]:
    """Make trials again and write failure-1.png, failure-1.gif and so on.

    Args:
        trials: Of the report.
        report: Its settings tell how grasps were planned.
        directory: A folder that is there.
        objects: What was scored.
        split: Of it.
        progress: Wraps the stream of exhibits, told how many there will be.

    Raises:
        InvalidOption: The objects are not those of the report.
        CannotWrite: A picture.
    """
    numbers = {source.name: number for number, source in enumerate(load_objects(objects, split))}
    strange = sorted({trial.object for trial in trials} - set(numbers))
    if strange:
        raise InvalidOption(
            f"the report has objects that are not among the {len(numbers)} given ({', '.join(strange)}): "
            "name the objects and the split that were scored"
        )
    watch = progress or (lambda exhibits, total: exhibits)
    return tuple(watch(_made_again(trials, report, directory, str(objects), split, numbers), len(trials)))


def _made_again(
    trials: Sequence[Trial], report: Report, directory: Path, objects: str, split: str, numbers: dict[str, int]
) -> Iterator[Exhibit]:
    envs: dict[str, GfpGraspEnv] = {}
    for place, trial in enumerate(trials, start=1):
        name, _ = row_names(trial.completer)
        if name not in envs:
            clutter = int(str(report.settings.get("clutter", 0)))
            envs[name] = GfpGraspEnv(objects=objects, split=split, clutter=clutter, completer=name)
        yield _exhibit(trial, envs[name], numbers[trial.object], report, directory / f"failure-{place}")


def _exhibit(trial: Trial, env: GfpGraspEnv, number: int, report: Report, stem: Path) -> Exhibit:
    env.reset(seed=trial.episode_seed, options={"object": number})
    picture = stem.with_suffix(".png")
    try:
        _write_picture(env, picture)
        if trial.quality is None:
            return Exhibit(trial, picture.name, note=trial.note or "there was no grasp to try")
        grasp = _best_grasp(env, trial, report)
        if grasp is None:
            return Exhibit(trial, picture.name, note="made again, there was no grasp to try")
        clip = stem.with_suffix(".gif")
        reason = _film(env, grasp, clip)
    except CannotWrite:
        raise
    except OSError as error:
        raise CannotWrite(f"{stem.name} cannot be written ({error.strerror or error}): make room for it") from error
    except GfpGraspError as error:
        return Exhibit(trial, note=f"it cannot be made again: {type(error).__name__}: {error}")
    return Exhibit(
        trial,
        picture.name,
        clip.name,
        "" if reason == trial.reason else f"made again, the attempt ended otherwise: {spoken(reason)}",
    )


def _write_picture(env: GfpGraspEnv, path: Path) -> None:
    episode = env.episode
    completed = None if episode.completion is None else episode.completion.mesh
    picture = overlay(episode.true_mesh(), completed, seen_from=episode.image.T_world_camera[:3, 3])
    Image.fromarray(picture).save(path, optimize=True)


def _best_grasp(env: GfpGraspEnv, trial: Trial, report: Report) -> Grasp | None:
    """As the score had it: through the code of an action, which rounds it."""
    if env.completion is None:
        return None
    _, name = row_names(trial.completer)
    num, seed = int(str(report.settings["grasps"])), int(str(report.settings["seed"]))
    grasp = next(islice(planner(name)(env.completion, num, seed=seed), num), None)
    return None if grasp is None else env.action_code.decode(env.action_code.encode(grasp))


def _film(env: GfpGraspEnv, grasp: Grasp, path: Path) -> str:
    """Write the clip; the reason that the attempt ended for."""
    world = env.world
    assert world is not None, "the true world is always there after a reset"
    world.restore()
    outcome, frames = filmed_trial(
        world.model,
        world.data,
        grasp,
        env.trial_settings,
        target=TARGET,
        alone=not env.config.clutter,
        commands_a_frame=_COMMANDS_A_FRAME,
    )
    write_clip(path, frames)
    return outcome.reason
