"""From a depth picture or a cloud to detections (support, objects, category, box), by detectors with names."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import numpy as np

from gfp_grasp.clouds import local_axes
from gfp_grasp.detect.clusters import label_picture, label_points
from gfp_grasp.detect.merging import upright_box
from gfp_grasp.detect.refusal import no_table
from gfp_grasp.detect.support import find_support
from gfp_grasp.detect.tables import find_table, keep_on_table
from gfp_grasp.errors import InvalidOption, InvalidView, NothingDetected, UnknownDetector
from gfp_grasp.parallel import one_thread
from gfp_grasp.plugins import imported_function
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.types import (
    TABLETOP,
    DepthImage,
    Detection,
    PointCloud,
    Proposal,
    RangeImage,
    SensorProfile,
    SupportPlane,
    View,
)

UP = np.array([0.0, 0.0, 1.0])

_NEIGHBOURS = 16  # points of the small planes that noise is read off,
_SAMPLE = 400  # and the number of these planes


@dataclass(frozen=True)
class DetectConfig:
    """Switches of detection.

    Attributes:
        sensor: Its limits, its noise, and the sizes of what it looks at.
        max_points: Points of a cloud that are looked at; more are thinned evenly.
        max_object_points: Points that a detection keeps.
        classify: Name the class of each object; False leaves `category` "" and `scores` empty, and needs no torch.
        votes: A network's votes say which pixels of a picture are one object, which needs torch; False tells objects
            apart by the steps and creases of their surface.
    """

    sensor: SensorProfile = TABLETOP
    max_points: int = 400_000
    max_object_points: int = 60_000
    classify: bool = True
    votes: bool = False

    def __post_init__(self) -> None:
        if self.max_points < 1000 or self.max_object_points < 1000:
            raise InvalidOption(f"{self}: at least 1000 points are expected")


@one_thread()
def detect_objects(
    image: DepthImage | PointCloud, *, up: np.ndarray | None = UP, config: DetectConfig = DetectConfig()
) -> tuple[Detection, ...]:
    """Every object that stands on the support, biggest first.

    Args:
        image: A depth picture, which also tells touching objects apart, or bare points.
        up: (3,) roughly the support's normal, world frame; None looks for a plane from the camera's axes.
        config: Switches.

    Raises:
        InvalidView: A LiDAR's scan.
        NothingDetected: No support plane, or nothing on it.
    """
    if isinstance(image, RangeImage):
        raise InvalidView(
            "this detector looks at depth pictures, not at scans: detector 'pointrcnn' finds what is in a scan, and "
            "GivenBoxes(boxes) takes boxes of yours"
        )
    if isinstance(image, DepthImage):
        return _detect_in_picture(image, up, config)
    return _detect_in_points(image, up, config)


def make_detection(
    points: np.ndarray,
    *,
    viewpoint: np.ndarray | None = None,
    up: np.ndarray = UP,
    support: SupportPlane | None = None,
    view: View | None = None,
    mask: np.ndarray | None = None,
    category: str | None = None,
    config: DetectConfig = DetectConfig(),
) -> Detection:
    """A detection of the points of one object: class, box, sensor noise.

    Args:
        points: (n, 3) m, of this object only.
        viewpoint: (3,) m, where the camera stood.
        up: (3,) unit, the support's normal.
        support: What it stands on.
        view: The whole depth picture.
        mask: (h, w) bool, its pixels in the view.
        category: Its class; None names it, unless config.classify is False.
        config: Switches.
    """
    points = points[:: -(-len(points) // config.max_object_points)]
    scores, proposal = {category: 1.0} if category else {}, None
    if config.classify and not category:
        scores, proposal = _looked_at(points, up, support, viewpoint, config.sensor)
    return Detection(
        cloud=PointCloud(points, viewpoint),
        up=up,
        support=support,
        category=max(scores, key=lambda name: scores[name], default=""),
        scores=scores,
        box=upright_box(points, up),
        view=view,
        mask=mask,
        sensor_sigma_m=estimate_sigma(points, viewpoint, sensor=config.sensor),
        sensor=config.sensor,
        proposal=proposal,
    )


def _detect_in_picture(image: DepthImage, up: np.ndarray | None, config: DetectConfig) -> tuple[Detection, ...]:
    seen = find_table(image, up, sensor=config.sensor)
    if seen.best is None:
        raise no_table(image, num_planes=seen.num_planes, up=up, sensor=config.sensor)
    table, points, eye = seen.best, image.points(), image.viewpoint
    support = table.plane
    beyond_m = np.zeros(image.shape)
    higher = support.distances(points) > 0.0  # False where nothing came back; what is lower is no object
    beyond_m[higher] = table.beyond_m(points[higher])
    points[beyond_m > table.reach_m] = np.nan
    if config.votes:
        from gfp_grasp.detect.learned import label_by_votes  # torch, only where votes are asked for

        labels = label_by_votes(image, points, table, beyond_m, sensor=config.sensor)
    else:
        labels = label_picture(points, support, eye, float(image.K[0, 0]), sensor=config.sensor)
        labels = keep_on_table(labels, beyond_m <= table.margin_m)
    if not labels.any():
        raise NothingDetected("a support plane, but nothing on it that is large enough for an object")
    return tuple(
        make_detection(
            points[labels == k],
            viewpoint=eye,
            up=support.normal,
            support=support,
            view=image,
            mask=labels == k,
            category=None,
            config=config,
        )
        for k in range(1, int(labels.max()) + 1)
    )


def _detect_in_points(cloud: PointCloud, up: np.ndarray | None, config: DetectConfig) -> tuple[Detection, ...]:
    points = cloud.points[:: -(-len(cloud.points) // config.max_points)]
    support = find_support(points, up, viewpoint=cloud.viewpoint, sensor=config.sensor)
    if support is None:
        raise NothingDetected(
            "no support plane in the cloud: a single object without its table goes to complete_to_mesh"
        )
    labels = label_points(points, support, sensor=config.sensor)
    if not labels.any():
        raise NothingDetected("a support plane, but nothing on it that is large enough for an object")
    return tuple(
        make_detection(
            points[labels == k],
            viewpoint=cloud.viewpoint,
            up=support.normal,
            support=support,
            view=None,
            mask=None,
            category=None,
            config=config,
        )
        for k in range(1, int(labels.max()) + 1)
    )


def _looked_at(
    points: np.ndarray,
    up: np.ndarray,
    support: SupportPlane | None,
    viewpoint: np.ndarray | None,
    sensor: SensorProfile,
) -> tuple[dict[str, float], Proposal]:
    """Scores of the shipped classes, and the look that they come from."""
    from gfp_grasp.detect.classifier import scores_in  # torch, only where a category is asked for
    from gfp_grasp.detect.proposal import look

    proposal = look(points, up, support, viewpoint=viewpoint, sensor=sensor)
    return scores_in(proposal.embedding, PrimitiveLibrary.shipped(), sensor), proposal


def estimate_sigma(
    points: np.ndarray, viewpoint: np.ndarray | None = None, *, sensor: SensorProfile = TABLETOP
) -> float:
    """Standard deviation of the depth noise, m, from the residuals of small planes.

    The median over neighbourhoods of 16 points, so that edges and flying pixels do not count. Residuals are taken
    along the ray to the viewpoint where that is known, else along the local normal. Noise that neighbouring pixels
    share does not show here: the figure is a lower bound for such sensors.

    Args:
        points: (n, 3) m.
        viewpoint: (3,) m.
        sensor: What noise is believed.

    Returns:
        Within the sensor's `sigma_range_m`: between 0.5 and 6 mm for depth cameras over a table.
    """
    least_m, most_m = sensor.sigma_range_m
    if len(points) < 2 * _NEIGHBOURS:
        return least_m
    chosen = points[:: -(-len(points) // _SAMPLE)]
    variance, axes = local_axes(points, chosen, num_neighbours=_NEIGHBOURS)
    # Three degrees of freedom go into the plane.
    residual = np.sqrt(np.maximum(variance[:, 0], 0.0) / (_NEIGHBOURS - 3))
    if viewpoint is not None:
        rays = chosen - viewpoint
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        residual = residual / np.maximum(np.abs(np.einsum("ni,ni->n", rays, axes[:, :, 0])), 0.3)
    return float(np.clip(np.median(residual), least_m, most_m))


class Detector(Protocol):
    """A function from a DepthImage or RangeImage to the objects in it, largest first, world frame, without class."""

    def __call__(self, image: Any, *, up: np.ndarray | None) -> Sequence[Detection]: ...


def _detect_traffic(image: RangeImage, *, up: np.ndarray | None) -> Sequence[Detection]:
    from gfp_grasp.detect.pointrcnn import detect_traffic  # torch, only where it is asked for

    return detect_traffic(image, up=up)


# Classes are named when a detection is completed, by the library of the completion.
DETECTORS: Mapping[str, Detector] = {
    "tabletop": partial(detect_objects, config=DetectConfig(classify=False)),
    "votes": partial(detect_objects, config=DetectConfig(classify=False, votes=True)),
}
SCAN_DETECTORS: Mapping[str, Detector] = {"pointrcnn": _detect_traffic}


def get_detector(name: str | Detector) -> Detector:
    """A detector by name, or a function of the user's own, whose answers are checked.

    Args:
        name: For pictures `tabletop` (`detect_objects`: what stands on a support plane, told apart by steps and
            creases) or `votes` (told apart by a network), for scans of a LiDAR `pointrcnn`; or
            `package.module:function`, a function like them, or such a function itself.
            `make_detection` makes a detection of an object's points; its class is named when it is completed.

    Raises:
        UnknownDetector: The name is none of these, or cannot be imported.
    """
    if not isinstance(name, str):
        return _checked(name, getattr(name, "__name__", type(name).__name__))
    known = {**DETECTORS, **SCAN_DETECTORS}
    if name in known:
        return known[name]
    on_offer = ", ".join(known)
    function = imported_function(name, what="detector", of="a view", on_offer=on_offer, error=UnknownDetector)
    return _checked(function, name)


def _checked(function: Callable[..., object], name: str) -> Detector:
    def detect(image: DepthImage, *, up: np.ndarray | None) -> Sequence[Detection]:
        try:
            inspect.signature(function).bind(image, up=up)
        except TypeError as error:
            raise InvalidOption(f"detector {name!r} cannot be called as {name}(image, up=...): {error}") from error
        answer = function(image, up=up)
        items = tuple(answer) if isinstance(answer, Sequence) else (answer,)
        found = tuple(item for item in items if isinstance(item, Detection))
        if len(found) < len(items):
            came = next(type(item).__name__ for item in items if not isinstance(item, Detection))
            raise InvalidOption(
                f"detector {name!r} returned a {came}; a sequence of gfp_grasp.types.Detection is expected"
            )
        if not found:
            raise NothingDetected(f"detector {name!r} found no object in the picture")
        return found

    return detect
