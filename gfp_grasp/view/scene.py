"""The scene that is shown: objects with all that is known of them, from a recording or an episode, and all points."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.captures import Capture, complete_capture
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.completion import CompletedScene, Completion, lowest_support
from gfp_grasp.detect import Detector
from gfp_grasp.drawing import Item, items_of, make_item
from gfp_grasp.envs import Episode
from gfp_grasp.types import DepthImage, RangeImage, SensorProfile, get_sensor

_UP = np.array([0.0, 0.0, 1.0])
# Labels of points beside the numbers of objects.
SUPPORT, OTHER = -1, -2
# More points would hide the surfaces under them and make a browser slow; 640 by 480 pixels are thinned to every tenth.
MAX_POINTS = 30_000
# Walls and floors farther than this from the objects' middle are left out.
REACH_M = 0.7
# Points this close to the support belong to it; at least three sigmas of the sensor.
_SUPPORT_M = 0.004


@dataclass(frozen=True, eq=False)
class ShownScene:
    """One scene as the viewer draws it.

    Attributes:
        title: Name of the recording or the episode.
        items: Objects of the scene; none where nothing was completed.
        image: The depth picture, or None where only points are known.
        up: (3,) unit, the support's normal.
        truths: True meshes in place, one for each object whose truth is known.
        notes: Warnings and failures, a sentence each.
        facts: Further figures, each a name and a value.
        street: The completed objects of a whole LiDAR scan, where that is what is shown.
    """

    title: str
    items: tuple[Item, ...]
    image: DepthImage | None
    up: np.ndarray
    truths: tuple[trimesh.Trimesh, ...] = ()
    notes: tuple[str, ...] = ()
    facts: tuple[tuple[str, str], ...] = ()
    street: CompletedScene | None = None

    @property
    def in_traffic(self) -> bool:
        """Whether the objects are vehicles and people, which are some 30 times as large as things on tables."""
        return any(item.completion.detection.sensor.of_traffic for item in self.items)


def scene_of_capture(
    capture: Capture,
    *,
    category: str | None = None,
    detector: str | Detector | None = None,
    sensor: str | SensorProfile = "tabletop",
    config: CompleteConfig | None = None,
    seed: int = 0,
) -> ShownScene:
    """Complete a recording, and plan grasps on each of its objects unless they are vehicles and people.

    Args:
        capture: The recording.
        category: Class of the recording's objects; None lets the classifier choose.
        detector: As `complete_capture` takes it.
        sensor: What saw it.
        config: Switches of the completion.
        seed: Seed of every random choice.

    Raises:
        GfpGraspError: Nothing in it can be completed.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        warnings.simplefilter("always", RuntimeWarning)
        completions = complete_capture(
            capture, category=category, detector=detector, sensor=sensor, config=config, seed=seed
        )
        street = _street_of(completions)
        if get_sensor(sensor).of_traffic:
            names = (completions[0].category,) if street is None else street.names
            items = tuple(Item(name, completion) for name, completion in zip(names, completions, strict=True))
        else:
            items = items_of(completions, capture.truth, seed=seed)
    return ShownScene(
        capture.name,
        items,
        capture.view,
        completions[0].detection.up,
        tuple(item.truth for item in items if item.truth is not None),
        tuple(str(warning.message) for warning in caught),
        street=street,
    )


def _street_of(completions: Sequence[Completion]) -> CompletedScene | None:
    """The completions as a scene where a whole LiDAR scan is what they come of."""
    if isinstance(completions, CompletedScene) and isinstance(completions.view, RangeImage):
        return completions
    return None


def scene_of_episode(episode: Episode, *, title: str, seed: int = 0) -> ShownScene:
    """Scene that the environment drew: the object at rest, its picture, and its completion if there is one."""
    truth = episode.true_mesh()
    completion = episode.completion
    items = () if completion is None else (make_item(episode.truth.name, completion, (completion,), truth, seed=seed),)
    load = episode.randomisation
    return ShownScene(
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


def scene_cloud(
    image: DepthImage, completions: Sequence[Completion], *, max_points: int = MAX_POINTS
) -> tuple[np.ndarray, np.ndarray]:
    """Points near the objects, thinned evenly.

    Args:
        image: The depth picture.
        completions: Completions of its objects; without any, all points are kept and belong to nothing.
        max_points: Most points to return.

    Returns:
        Points (n, 3) m, world frame, and labels (n,) int: the number of the object in whose cluster the point is,
        SUPPORT, or OTHER.
    """
    points = image.points().reshape(-1, 3)
    labels = _labels(points, image, completions)
    keep = np.isfinite(points).all(axis=1)
    if completions:
        middle = np.mean([completion.mesh.bounds.mean(axis=0) for completion in completions], axis=0)
        keep &= np.linalg.norm(points - middle, axis=1) < REACH_M
    kept = np.flatnonzero(keep)
    kept = kept[:: max(1, -(-len(kept) // max_points))]
    return points[kept], labels[kept]


def _labels(points: np.ndarray, image: DepthImage, completions: Sequence[Completion]) -> np.ndarray:
    labels = np.full(len(points), OTHER)
    if (support := lowest_support(completions)) is not None:
        near_m = max(_SUPPORT_M, 3 * completions[0].detection.sensor_sigma_m)
        labels[np.abs(support.distances(points)) < near_m] = SUPPORT  # false for a point that is NaN
    for number, completion in enumerate(completions):
        mask = completion.detection.mask
        if mask is not None and mask.shape == image.depth_m.shape:
            labels[mask.reshape(-1)] = number
    return labels
