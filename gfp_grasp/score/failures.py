"""Failures that are worth a look, made again from their seeds: a picture of each, and a clip of its trial."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from gfp_grasp.drawing import filmed_trial, overlay, spoken, write_clip
from gfp_grasp.envs import Episode, GraspTask
from gfp_grasp.errors import CannotWrite, GfpGraspError, InvalidOption
from gfp_grasp.parallel import Progress
from gfp_grasp.scenes import load_objects
from gfp_grasp.score.report import Report, ScoreRow, method_names
from gfp_grasp.score.rows import ScoreConfig, as_step, best_grasps, task_of
from gfp_grasp.types import Grasp

ORACLE = "oracle"
MOST, MOST_OF_ONE_OBJECT = 8, 2
RULE = (
    f"Shown are at most {MOST} failures, at most {MOST_OF_ONE_OBJECT} of one object. Rows take turns, the one with the "
    "most successes first; each shows the failure with the largest Chamfer distance that it has left, those without a "
    "completion last."
)
# Where a process died under a row, making the row again would be the death of this process.
_LOST = "WorkerLost"
# Twice as many pictures as the demonstration takes: many a failure is over in half a second.
_COMMANDS_A_FRAME = 8


@dataclass(frozen=True)
class Exhibit:
    """A failure with its pictures.

    Attributes:
        row: The row that failed.
        picture: File name of the picture beside the page, "" where there is none.
        clip: File name of the clip, "" where there was no grasp to try.
        note: A remark on picture and clip.
    """

    row: ScoreRow
    picture: str = ""
    clip: str = ""
    note: str = ""


def choose_failures(report: Report) -> tuple[ScoreRow, ...]:
    """Failed rows of the methods under test, by RULE, where the true mesh led to a grasp that held.

    Where the oracle was not scored, every failure may be chosen. Neither depends on anything but the report.
    """
    turns = [_worst_first(report, method) for method in _best_first(report)]
    chosen: list[ScoreRow] = []
    while any(turns) and len(chosen) < MOST:
        for left in turns:
            while left and _count(chosen, left[0].object) >= MOST_OF_ONE_OBJECT:
                left.pop(0)
            if left and len(chosen) < MOST:
                chosen.append(left.pop(0))
    return tuple(chosen)


def is_oracle(method: str) -> bool:
    """Whether a method completes by the true mesh, whichever planner it has."""
    return method_names(method)[0] == ORACLE


def has_oracle(report: Report) -> bool:
    """Whether such a method was scored."""
    return any(is_oracle(row.completer) for row in report.rows)


def _best_first(report: Report) -> list[str]:
    summaries = report.completers()
    methods = [method for method in summaries if not is_oracle(method)]
    return sorted(methods, key=lambda method: -summaries[method]["successes"])


def _worst_first(report: Report, method: str) -> list[ScoreRow]:
    held = {(row.object, row.view) for row in report.rows if is_oracle(row.completer) and row.success}
    bracketed = has_oracle(report)
    failed = [
        row
        for row in report.rows
        if row.completer == method
        and not row.success
        and not row.note.startswith(_LOST)
        and (not bracketed or (row.object, row.view) in held)
    ]
    return sorted(failed, key=lambda row: -1.0 if row.cd_m is None else row.cd_m, reverse=True)


def _count(chosen: Sequence[ScoreRow], name: str) -> int:
    return sum(row.object == name for row in chosen)


def make_exhibits(
    rows: Sequence[ScoreRow],
    directory: Path,
    *,
    objects: str | Path,
    config: ScoreConfig,
    progress: Progress | None = None,
) -> tuple[Exhibit, ...]:
    """Make rows again and write failure-1.png, failure-1.gif and so on.

    Args:
        rows: Rows of the report.
        directory: A folder that is there.
        objects: Objects that were scored, as `score` took them.
        config: Config of the score.
        progress: Wraps the stream of exhibits, told how many there will be.

    Raises:
        InvalidOption: The objects are not those of the report.
        CannotWrite: A picture.
    """
    numbers = {source.name: number for number, source in enumerate(load_objects(objects, config.split))}
    strange = sorted({row.object for row in rows} - set(numbers))
    if strange:
        raise InvalidOption(
            f"the report has objects that are not among the {len(numbers)} given ({', '.join(strange)}): "
            "name the objects and the split that were scored"
        )
    watch = progress or (lambda exhibits, total: exhibits)
    return tuple(watch(_made_again(rows, directory, str(objects), config, numbers), len(rows)))


def _made_again(
    rows: Sequence[ScoreRow], directory: Path, objects: str, config: ScoreConfig, numbers: dict[str, int]
) -> Iterator[Exhibit]:
    for place, row in enumerate(rows, start=1):
        task = task_of(objects, config, method_names(row.completer)[0])
        yield _exhibit(row, task, numbers[row.object], config, directory / f"failure-{place}")


def _exhibit(row: ScoreRow, task: GraspTask, number: int, config: ScoreConfig, stem: Path) -> Exhibit:
    episode = task.draw(np.random.default_rng(row.episode_seed), number=number)
    picture, clip = stem.with_suffix(".png"), stem.with_suffix(".gif")
    try:
        _write_picture(episode, picture)
        if row.quality is None:
            return Exhibit(row, picture.name, note=row.note or "there was no grasp to try")
        found = ()
        if episode.completion is not None:
            found = best_grasps(episode.completion, row.completer, config.grasps, config.seed)[0]
        if not found:
            return Exhibit(row, picture.name, note="made again, there was no grasp to try")
        reason = _film(task, as_step(found[0]), clip)
    except CannotWrite:
        raise
    except OSError as error:
        raise CannotWrite(f"{stem.name} cannot be written ({error.strerror or error}): make room for it") from error
    except GfpGraspError as error:
        return Exhibit(row, note=f"it cannot be made again: {type(error).__name__}: {error}")
    return Exhibit(
        row,
        picture.name,
        clip.name,
        "" if reason == row.reason else f"made again, the trial ended otherwise: {spoken(reason)}",
    )


def _write_picture(episode: Episode, path: Path) -> None:
    completed = None if episode.completion is None else episode.completion.mesh
    picture = overlay(episode.true_mesh(), completed, seen_from=episode.image.T_world_camera[:3, 3])
    Image.fromarray(picture).save(path, optimize=True)


def _film(task: GraspTask, grasp: Grasp, path: Path) -> str:
    """Write the clip; returns the reason for which the trial ended."""
    world = task.world()
    assert world is not None, "the true world is always there once an episode is drawn"
    outcome, frames = filmed_trial(
        world, grasp, task.trial_settings, alone=not task.config.clutter, commands_a_frame=_COMMANDS_A_FRAME
    )
    write_clip(path, frames)
    return outcome.reason
