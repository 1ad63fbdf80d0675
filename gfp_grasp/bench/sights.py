"""Objects in pictures, and what completers answer when they are given the picture and the object's true pixels."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import count

import numpy as np
import trimesh

from gfp_grasp.bench.clutter import draw_clutter
from gfp_grasp.bench.methods import view_object
from gfp_grasp.camera import SensorModel, apply_sensor, cloud_of, intrinsics, render_mesh_view, sample_viewpoint
from gfp_grasp.completers import ToldTruth, get_completer, needs_class
from gfp_grasp.completion import Completion
from gfp_grasp.detect import DetectConfig, detect_single
from gfp_grasp.errors import GfpGraspError
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.recognition import recognise
from gfp_grasp.scenes import ALL_FAMILIES, ObjectSource, load_objects
from gfp_grasp.types import DepthImage, Detection

_LEAST_OBJECTS = 3  # of a scene
_SPREAD_M = 0.07  # so near that neighbours touch where they are completed too large
_LEAST_PIXELS = 100  # of an object that is asked for
_CAMERA_M = 0.7


@dataclass(frozen=True, eq=False)
class Sight:
    """An object in a picture.

    Attributes:
        image: The depth picture.
        mask: (h, w) bool, the object's pixels that came back.
        source: Where the object comes from; for the oracle alone.
        mesh: The true mesh, in the world's frame.
        T_world_object: (4, 4) its pose; for the oracle alone.
    """

    image: DepthImage
    mask: np.ndarray
    source: ObjectSource
    mesh: trimesh.Trimesh
    T_world_object: np.ndarray


@dataclass(frozen=True, eq=False)
class SightAnswer:
    """What a completer made of a sight.

    Attributes:
        completion: The completed object; None where there is none.
        seconds: From the picture to the mesh and its convex parts; None for the oracle, which makes nothing.
        error: Name of the error, where there is no completion.
    """

    completion: Completion | None
    seconds: float | None = None
    error: str | None = None


def see_object(source: ObjectSource, rng: np.random.Generator, *, hidden: float, noise_m: float) -> Sight:
    """An object alone on a table, a share of its pixels behind a board; see `view_object`."""
    protocol = "hidden" if hidden else "standard"
    view = view_object(source.load_mesh(), rng, protocol=protocol, noise_m=noise_m, hidden_share=hidden)
    assert view.image is not None
    assert view.mask is not None
    return Sight(view.image, view.mask, source, view.mesh, view.T_world_object)


def see_scene(rng: np.random.Generator, *, noise_m: float) -> list[Sight]:
    """The objects of a picture of clutter that are seen, largest first, as `complete_scene` takes them."""
    drawn = (draw_clutter(rng, least=_LEAST_OBJECTS, spread_m=_SPREAD_M) for _ in count())
    placed = next(shapes for shapes in drawn if len(shapes) >= _LEAST_OBJECTS)
    K = intrinsics(320, 240, 45.0)
    camera = sample_viewpoint(rng, distance_m=_CAMERA_M)
    meshes = [shape.mesh for shape in placed]
    image, index = render_mesh_view(meshes, T_world_camera=camera, K=K, width=320, height=240, table_height=0.0)
    image = apply_sensor(image, SensorModel.gaussian(noise_m), rng)
    masks = [(index == k) & (image.depth_m > 0) for k in range(len(placed))]
    sights = [
        Sight(image, mask, shape.source, shape.mesh, shape.T_world_object)
        for shape, mask in zip(placed, masks, strict=True)
    ]
    seen = [sight for sight in sights if sight.mask.sum() >= _LEAST_PIXELS]
    return sorted(seen, key=lambda sight: -int(sight.mask.sum()))


def answers_to(sight: Sight, completers: Sequence[str]) -> dict[str, SightAnswer]:
    """The answer of each completer, by name; the object is cut out of the picture once, in everybody's time."""
    start = time.perf_counter()
    try:
        points, config = cloud_of(sight.image, sight.mask).points, DetectConfig(classify=False)
        detection = detect_single(points, view=sight.image, mask=sight.mask, config=config)
    except GfpGraspError as error:
        return {name: SightAnswer(None, error=type(error).__name__) for name in completers}
    seconds = time.perf_counter() - start
    return {name: _answer(name, detection, sight, seconds) for name in completers}


def _answer(name: str, detection: Detection, sight: Sight, detect_s: float) -> SightAnswer:
    complete = get_completer(name)
    try:
        if isinstance(complete, ToldTruth):
            return SightAnswer(complete.placed(detection, sight.source.load(), sight.T_world_object))
        start = time.perf_counter()
        if needs_class(name):
            detection = recognise(detection, PrimitiveLibrary.shipped())
        completion = complete(detection)
        completion.collision  # noqa: B018  (made at first access)
    except GfpGraspError as error:
        return SightAnswer(None, error=type(error).__name__)
    return SightAnswer(completion, round(detect_s + time.perf_counter() - start, 4))


@lru_cache(maxsize=64)
def warm_up(name: str) -> None:
    """Complete something once: what a completer loads at its first call in a process is none of its seconds."""
    answers_to(see_object(load_objects(ALL_FAMILIES)[0], np.random.default_rng(0), hidden=0.0, noise_m=0.001), (name,))
