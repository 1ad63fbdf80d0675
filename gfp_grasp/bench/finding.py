"""How well detectors find the objects of a picture: on labelled table tops, on rendered clutter and in rooms."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gfp_grasp.bench.clutter import draw_clutter
from gfp_grasp.camera import SensorModel, apply_sensor, intrinsics, render_mesh_view, sample_viewpoint, view_from_points
from gfp_grasp.detect import DETECTORS, Detector, get_detector
from gfp_grasp.drawing import paint_objects
from gfp_grasp.errors import InvalidOption, NothingDetected
from gfp_grasp.plugins import DEFAULT_DETECTOR
from gfp_grasp.scenes import draw_camera, draw_things, make_room, view_room
from gfp_grasp.types import DepthImage, Detection

MATCH_IOU = 0.7
_UP = np.array([0.0, 0.0, 1.0])
_LEAST_PX = 100  # of a rendered object that counts
_MOST_THINGS = 12
_SHRUNK = 2  # pixels of a picture that become one of its panel


@dataclass(frozen=True, eq=False)
class LabelledPicture:
    """A depth picture whose objects are known.

    Attributes:
        name: Name of the picture.
        view: The picture.
        labels: (h, w) int, 0 for background; each object has a number of its own.
        up: (3,) what the detector is told of up; None where it is told nothing.
        least_px: Objects of fewer pixels do not count.
    """

    name: str
    view: DepthImage
    labels: np.ndarray
    up: np.ndarray | None
    least_px: int = 1


def table_pictures(data: Path) -> Iterator[LabelledPicture]:
    """Labelled table tops of a folder: captures/table_*.npz with points_cam (h, w, 3) m and label (h, w)."""
    for path in sorted(data.glob("captures/table_*.npz")):
        with np.load(path) as capture:
            yield LabelledPicture(path.stem, view_from_points(capture["points_cam"]), capture["label"], None)


def clutter_pictures(num_scenes: int, *, seed: int) -> Iterator[LabelledPicture]:
    """Two to five test shapes on a table, upright and at least 4 mm apart, as two kinds of sensor see them."""
    for number in range(num_scenes):
        rng = np.random.default_rng([seed, number])
        meshes = [placed.mesh for placed in draw_clutter(rng)]
        K = intrinsics(320, 240, 45.0)
        camera = sample_viewpoint(rng, distance_m=rng.uniform(0.6, 0.9))
        image, index = render_mesh_view(meshes, T_world_camera=camera, K=K, width=320, height=240, table_height=0.0)
        image = apply_sensor(image, _sensor(number), rng)
        known = (index >= 0) & (index < len(meshes)) & (image.depth_m > 0)
        yield LabelledPicture(f"clutter_{number}", image, np.where(known, index + 1, 0), _UP, _LEAST_PX)


def room_pictures(num_scenes: int, *, seed: int) -> Iterator[LabelledPicture]:
    """Rooms of test shapes and of things of no class, two of three piled up, 640 by 480 pixels."""
    for number in range(num_scenes):
        rng = np.random.default_rng([seed, number])
        things = draw_things(rng, int(rng.integers(2, _MOST_THINGS + 1)), split="test")
        room = make_room(things, rng, piled=number % 3 > 0)
        camera = draw_camera(room, rng, distance_m=rng.uniform(0.6, 1.4), elevation_deg=(25.0, 65.0))
        image, labels = view_room(room, camera, rng, sensor=_sensor(number), width=640, height=480)
        yield LabelledPicture(f"room_{number}", image, labels, _UP, 4 * _LEAST_PX)


def _sensor(number: int) -> SensorModel:
    return (SensorModel.realsense(), SensorModel.kinect())[number % 2]


def match_detectors(
    sets: Mapping[str, Callable[[], Iterable[LabelledPicture]]], detectors: Mapping[str, Detector] = DETECTORS
) -> dict[str, Any]:
    """Figures of each detector on each set of pictures.

    Args:
        sets: Pictures by the name of their set, made anew for each detector.
        detectors: Detectors by name.

    Returns:
        By detector and set: pictures, those refused, objects, how many of them are matched by a detection at an
        intersection over union of 0.7, the share, the mean of the union's share, the objects missed by picture, and
        the median of the seconds a picture.
    """
    return {
        name: {kind: match_pictures(pictures(), detector) for kind, pictures in sets.items()}
        for name, detector in detectors.items()
    }


def match_pictures(pictures: Iterable[LabelledPicture], detector: Detector) -> dict[str, Any]:
    """Figures of one detector on one set of pictures; see `match_detectors`."""
    ious, seconds, missed, refused = [], [], {}, 0
    for picture in pictures:
        start = time.perf_counter()
        try:
            found = detector(picture.view, up=picture.up)
        except NothingDetected:
            found, refused = (), refused + 1
        seconds.append(time.perf_counter() - start)
        numbers, sizes = np.unique(picture.labels[picture.labels > 0], return_counts=True)
        own = [best_iou(picture.labels == k, found) for k in numbers[sizes >= picture.least_px]]
        ious += own
        if lost := sum(iou < MATCH_IOU for iou in own):
            missed[picture.name] = lost
    matched = sum(iou >= MATCH_IOU for iou in ious)
    return {
        "pictures": len(seconds),
        "refused": refused,
        "objects": len(ious),
        "matched": matched,
        "share": round(matched / max(len(ious), 1), 3),
        "mean_iou": round(float(np.mean(ious)), 3) if ious else None,
        "missed": missed,
        "median_seconds": round(float(np.median(seconds)), 2) if seconds else None,
    }


def paint_rooms(data: Path, file: Path, *, detector: str = DEFAULT_DETECTOR) -> None:
    """Write one picture of what is found in captures/room_*.npz of a folder (depth_m, K), one beside the other."""
    panels = []
    for path in sorted(data.glob("captures/room_*.npz")):
        with np.load(path) as capture:
            view = DepthImage(capture["depth_m"], capture["K"], np.eye(4))
        found = get_detector(detector)(view, up=None)
        panels.append(paint_objects(view.depth_m, [d.mask for d in found if d.mask is not None])[::_SHRUNK, ::_SHRUNK])
    if not panels:
        raise InvalidOption(f"{data} has no captures/room_*.npz: there is nothing to paint")
    height = min(len(panel) for panel in panels)
    Image.fromarray(np.hstack([panel[:height] for panel in panels])).save(file)


def best_iou(mask: np.ndarray, found: Sequence[Detection]) -> float:
    """Largest intersection over union of a mask (h, w) with a detection's."""
    return max((float((mask & d.mask).sum() / (mask | d.mask).sum()) for d in found if d.mask is not None), default=0.0)
