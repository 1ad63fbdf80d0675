"""What is to be shown: objects with all that is known of them, of a recording or of an episode."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.captures import Capture, complete_capture
from gfp_grasp.complete import Completion
from gfp_grasp.demo.attempt import plan_among
from gfp_grasp.demo.story import Item
from gfp_grasp.envs.episode import Episode
from gfp_grasp.metrics import completion_errors
from gfp_grasp.types import DepthImage

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Sight:
    """One scene as the viewer draws it.

    Attributes:
        title: What it is.
        items: Its objects; none where nothing was completed.
        image: The depth picture, or None where only points are known.
        up: (3,) unit, the support's normal.
        truths: True meshes in place, of those objects whose truth is known.
        notes: Warnings and failures, a sentence each.
        facts: Further figures, name and value.
    """

    title: str
    items: tuple[Item, ...]
    image: DepthImage | None
    up: np.ndarray
    truths: tuple[trimesh.Trimesh, ...] = ()
    notes: tuple[str, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()


def sight_of_capture(capture: Capture, *, category: str | None = None, seed: int = 0) -> Sight:
    """Complete a recording and plan grasps on each of its objects.

    Args:
        capture: The recording.
        category: As `complete_capture` takes it.
        seed: Of every random choice.

    Raises:
        GfpGraspError: Nothing in it can be completed.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        warnings.simplefilter("always", RuntimeWarning)
        completions = complete_capture(capture, category=category, seed=seed)
        names = [f"{completion.category}-{i + 1}" for i, completion in enumerate(completions)]
        truth = capture.truth if len(completions) == 1 else None
        items = tuple(
            _item(name, completion, completions, truth, seed)
            for name, completion in zip(names, completions, strict=True)
        )
    return Sight(
        capture.name,
        items,
        capture.view,
        completions[0].detection.up,
        () if truth is None else (truth,),
        tuple(str(warning.message) for warning in caught),
    )


def sight_of_episode(episode: Episode, *, title: str, seed: int = 0) -> Sight:
    """What the environment drew: the object where it came to rest, its picture, and its completion if there is one."""
    truth = episode.true_mesh()
    completion = episode.completion
    items = () if completion is None else (_item(episode.truth.name, completion, (completion,), truth, seed),)
    load = episode.load
    return Sight(
        title,
        items,
        episode.image,
        _UP,
        (truth,),
        tuple(note for note in (episode.failure, *episode.notes.split("; ")) if note),
        (
            ("true object", " ".join(filter(None, (episode.truth.name, episode.truth.category)))),
            ("mass, friction", f"{1000 * load.mass_kg:.0f} g, {load.friction:.2f}"),
            ("grip", f"{load.grip_n:.0f} N"),
        ),
    )


def _item(
    name: str,
    completion: Completion,
    completions: tuple[Completion, ...],
    truth: trimesh.Trimesh | None,
    seed: int,
) -> Item:
    grasps, grasp_s = plan_among(completion, completions, seed=seed)
    errors = None
    if truth is not None:
        errors = completion_errors(completion.mesh, truth, rng=np.random.default_rng(seed))
    return Item(name, completion, grasps, truth=truth, errors=errors, grasp_s=grasp_s)
