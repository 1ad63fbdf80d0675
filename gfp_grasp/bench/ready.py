"""Bench of what robotics asks of a single-view mesh: `gfp-grasp bench ready`.

The five wishes of https://arxiv.org/abs/2505.17966 for every completer: a Chamfer distance under 2 mm, no cut into a
neighbour, under 5 degrees of tilt when it settles, the same behind an occluder, under 2 s. A completer is given the
depth picture and the object's true pixels in it. Its answer goes the way that a user's goes: into a file for MuJoCo,
which `gfp-grasp check` measures.
"""

from __future__ import annotations

import os
import platform
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from gfp_grasp.bench.ready_rows import SceneRow, ViewRow, summarise
from gfp_grasp.bench.sights import SightAnswer, answers_to, see_object, see_scene, warm_up
from gfp_grasp.completers import COMPLETERS, get_completer
from gfp_grasp.completion import CompletedScene, Completion
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.metrics import chamfer_m, visible_surface
from gfp_grasp.parallel import pmap
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.scenes import ALL_FAMILIES, BodyCheck, ObjectSource, check_file, load_objects
from gfp_grasp.types import DepthImage

HIDDEN = (0.0, 0.3, 0.5, 0.7)  # shares of the object's pixels that a board hides
_SAMPLES = 32_768
_AT_THE_START_S = 1e-3  # one step


@dataclass(frozen=True)
class ReadyConfig:
    """How much is measured.

    Attributes:
        views: Number of views of single objects in each group; objects take turns.
        scenes: Number of scenes of several objects.
        seed: Seed of views, noise and samples.
        noise_m: Standard deviation of the depth noise, m.
    """

    views: int = 18
    scenes: int = 8
    seed: int = 0
    noise_m: float = 0.001

    def __post_init__(self) -> None:
        if self.views < 1 or self.scenes < 1:
            raise InvalidOption(f"views are {self.views}, scenes {self.scenes}; at least 1 of each is expected")


def bench_ready(
    data: Path | None = None,
    *,
    completers: Sequence[str] = COMPLETERS,
    config: ReadyConfig = ReadyConfig(),
    workers: int = 1,
    progress=None,
) -> dict[str, Any]:
    """Measure the five wishes.

    Args:
        data: Folder with meshes/ of real objects, named `<class>__<name>.ply`; classes that have no primitive are left
            out. None takes procedural shapes of the test split only.
        completers: Names of completers, see `gfp_grasp.completers.get_completer`.
        config: Views, scenes, noise.
        workers: Number of processes; more of them than idle cores spoil the seconds.
        progress: Wraps the stream of finished views and scenes.

    Returns:
        {"settings", "rows": {group: {completer: figures of `summarise`}}, "scenes": every `SceneRow`, "trials": every
        `ViewRow`}. The groups are "procedural", which alone has scenes, and with a folder "real".

    Raises:
        UnknownCompleter: A name that is not on offer.
        InvalidOption: The folder has no mesh of a class that there is.
    """
    for name in completers:
        get_completer(name)
    groups = _groups(data)
    jobs: list[tuple[str, ObjectSource, int] | int] = [
        (group, sources[k % len(sources)], k // len(sources))
        for group, sources in groups.items()
        for k in range(config.views)
    ]
    jobs += range(config.scenes)
    run = partial(_rows_of_job, completers=tuple(completers), config=config)
    found = [row for rows in pmap(run, jobs, workers=workers, progress=progress) for row in rows]
    views = [row for row in found if isinstance(row, ViewRow)]
    scenes = [row for row in found if isinstance(row, SceneRow)]
    return {
        "settings": {
            **asdict(config),
            "samples": _SAMPLES,
            "completers": list(completers),
            "objects": {group: len(sources[: config.views]) for group, sources in groups.items()},
            "machine": f"{platform.machine()}, {os.cpu_count()} cores, {workers} used",
        },
        "rows": by_group(views, scenes),
        "scenes": [row.to_json() for row in scenes],
        "trials": [row.to_json() for row in views],
    }


def by_group(views: Sequence[ViewRow], scenes: Sequence[SceneRow]) -> dict[str, dict[str, dict[str, Any]]]:
    """{group: {completer: figures}} of all rows, in the order of the rows; scenes belong to the first group."""
    groups, names = (list(dict.fromkeys(getattr(row, key) for row in views)) for key in ("group", "completer"))
    return {
        group: {
            name: summarise(
                [row for row in views if row.group == group and row.completer == name],
                [row for row in scenes if row.completer == name and group == groups[0]],
            )
            for name in names
        }
        for group in groups
    }


def _groups(data: Path | None) -> dict[str, list[ObjectSource]]:
    groups = {"procedural": list(load_objects(ALL_FAMILIES))}
    if data is not None:
        known = PrimitiveLibrary.shipped().categories
        groups["real"] = [source for source in load_objects(data / "meshes") if source.category in known]
        if not groups["real"]:
            raise InvalidOption(f"{data / 'meshes'} has no mesh of {', '.join(known)}; <class>__<name>.ply is expected")
    return groups


def _rows_of_job(
    job: tuple[str, ObjectSource, int] | int, *, completers: tuple[str, ...], config: ReadyConfig
) -> list[ViewRow] | list[SceneRow]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in completers:
            warm_up(name)
        return _scene_rows(job, completers, config) if isinstance(job, int) else _view_rows(*job, completers, config)


def _view_rows(
    group: str, source: ObjectSource, number: int, completers: tuple[str, ...], config: ReadyConfig
) -> list[ViewRow]:
    """Rows of one view, the same place and camera with more and more of the object hidden."""
    seed = [config.seed, number, zlib.crc32(source.name.encode())]
    rows = []
    for hidden in HIDDEN:
        rng = np.random.default_rng(seed)
        sight = see_object(source, rng, hidden=hidden, noise_m=config.noise_m)
        truth = visible_surface(sight.mesh, _SAMPLES, rng)
        for name, answer in answers_to(sight, completers).items():
            rows.append(
                ViewRow(
                    group=group,
                    object=source.name,
                    category=source.category,
                    view=number,
                    hidden=hidden,
                    completer=name,
                    **_figures(answer, truth, np.random.default_rng([*seed, zlib.crc32(name.encode())])),
                )
            )
    return rows


def _scene_rows(number: int, completers: tuple[str, ...], config: ReadyConfig) -> list[SceneRow]:
    sights = see_scene(np.random.default_rng([config.seed, number]), noise_m=config.noise_m)
    answers = [answers_to(sight, completers) for sight in sights]
    return [_scene_row(number, name, [found[name] for found in answers], sights[0].image) for name in completers]


def _scene_row(number: int, name: str, answers: Sequence[SightAnswer], image: DepthImage) -> SceneRow:
    done = [answer.completion for answer in answers if answer.completion is not None]
    error = next((answer.error for answer in reversed(answers) if answer.error), None)
    cuts: dict[str, tuple[float, ...]] = {}
    if done:
        try:
            scene = CompletedScene.of(done, image)
            cuts["unparted_m"] = _cuts_m(replace(scene, completions=tuple(done)))
            cuts["cuts_m"] = _cuts_m(scene)
        except GfpGraspError as failure:
            cuts, error = {}, type(failure).__name__
    return SceneRow(scene=number, completer=name, objects=len(answers), error=error, **cuts)


def _cuts_m(scene: CompletedScene) -> tuple[float, ...]:
    return tuple(round(body.neighbour_m, 6) for body in _check(scene, seconds=_AT_THE_START_S))


def _figures(answer: SightAnswer, truth: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    """Fields of a `ViewRow` that an answer gives."""
    if answer.completion is None:
        return {"error": answer.error}
    figures: dict[str, Any] = {"seconds": answer.seconds}
    try:
        points = visible_surface(answer.completion.mesh, _SAMPLES, rng)
        figures["chamfer_m"] = round(chamfer_m(points, truth) / 2, 6)
        (body,) = _check(answer.completion)
    except GfpGraspError as error:
        return {**figures, "error": type(error).__name__}
    if not np.isfinite(body.tilt_deg):
        return {**figures, "error": "BrokeDown"}
    # The floor of the file is the support that was found, which need not be level.
    body = replace(body, tilt_deg=body.tilt_deg + _off_level_deg(answer.completion.detection.up))
    moved = {"tilt_deg": round(body.tilt_deg, 3), "travel_m": round(body.travel_m, 6)}
    return {**figures, **moved, "stands": body.stands}


def _off_level_deg(up: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(up[:2]), up[2])))


def _check(completed: Completion | CompletedScene, **how: float) -> tuple[BodyCheck, ...]:
    with TemporaryDirectory() as folder:
        return check_file(completed.export(Path(folder) / "completed.xml"), **how)
