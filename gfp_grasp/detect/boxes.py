"""A detector that is told where things are: boxes of labels, or of a detector of one's own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gfp_grasp.detect.detector import DetectConfig, make_detection
from gfp_grasp.detect.road import Road, find_road
from gfp_grasp.errors import InvalidOption, InvalidView, NothingDetected
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import LIDAR, Detection, OrientedBox, RangeImage, SensorProfile

_FEWEST = 30  # points of a box that are completed


@dataclass(frozen=True, eq=False)
class GivenBoxes:
    """Detects what is in given boxes of a scan, as `complete_scene(scan, detector=GivenBoxes(boxes))`.

    Attributes:
        boxes: World frame, z up, m; road under them is left out, however low they reach.
        categories: Class of each box, "" where it is to be named; None names all of them.
        sensor: What saw them.
    """

    boxes: Sequence[OrientedBox]
    categories: Sequence[str] | None = None
    sensor: SensorProfile = LIDAR

    def __post_init__(self) -> None:
        if self.categories is not None and len(self.categories) != len(self.boxes):
            raise InvalidOption(
                f"{len(self.categories)} categories for {len(self.boxes)} boxes; one for each is expected"
            )

    def __call__(self, image: RangeImage, *, up: np.ndarray | None = None) -> tuple[Detection, ...]:
        """The things in the boxes, each on the road as it is under it; boxes of fewer than 30 points are left out.

        Args:
            image: The scan.
            up: (3,) roughly the road's normal; None takes the scanner's own z axis.

        Raises:
            InvalidView: Not a RangeImage.
            NothingDetected: No road, or no box with enough points.
        """
        seen = SeenScan.of(image, up, self.sensor)
        found = things_in(seen, self.boxes, self.categories, self.sensor)
        if not found:
            raise NothingDetected(
                f"none of {len(self.boxes)} boxes holds {_FEWEST} points above the road: are they in the scan's frame?"
            )
        return found


@dataclass(frozen=True, eq=False)
class SeenScan:
    """A scan with its road.

    Attributes:
        image: The scan.
        points: (h, w, 3) m, world frame, NaN where nothing came back.
        road: What is driven on.
        height_m: (h, w) above the road, NaN where nothing came back.
    """

    image: RangeImage
    points: np.ndarray
    road: Road
    height_m: np.ndarray

    @classmethod
    def of(cls, image: RangeImage, up: np.ndarray | None, sensor: SensorProfile) -> SeenScan:
        """A scan whose road is looked for.

        Args:
            image: The scan.
            up: (3,) roughly the road's normal; None takes the scanner's own z axis.
            sensor: Its limits.

        Raises:
            InvalidView: Not a RangeImage.
            NothingDetected: No road.
        """
        if not isinstance(image, RangeImage):
            raise InvalidView(f"image is a {type(image).__name__}; a gfp_grasp.types.RangeImage is expected")
        points, seen = image.points(), image.range_m > 0
        up = image.T_world_sensor[:3, 2] if up is None else up
        road = find_road(points[seen], up, viewpoint=image.viewpoint, forward=image.T_world_sensor[:3, 0])
        height_m = np.full(image.shape, np.nan)
        height_m[seen] = road.heights(points[seen])
        return cls(image, points, road, height_m)


def things_in(
    seen: SeenScan, boxes: Sequence[OrientedBox], categories: Sequence[str] | None, sensor: SensorProfile
) -> tuple[Detection, ...]:
    """What is in each box above the road, most points first; boxes of fewer than 30 points are left out.

    Args:
        seen: The scan.
        boxes: World frame, z up, m.
        categories: Class of each, "" where it is to be named; None names all of them.
        sensor: What saw them.
    """
    config = DetectConfig(sensor=sensor, classify=False)
    above = seen.height_m > sensor.floor_m
    found = []
    for box, category in zip(boxes, categories or [""] * len(boxes), strict=True):
        mask = above.copy()
        mask[above] = (np.abs(apply_T(invert_T(box.T_world_box), seen.points[above])) <= box.extents / 2).all(axis=1)
        if mask.sum() < _FEWEST:
            continue
        support = seen.road.support_at(box.T_world_box[:3, 3])
        found.append(
            make_detection(
                seen.points[mask],
                viewpoint=seen.image.viewpoint,
                up=support.normal,
                support=support,
                view=seen.image,
                mask=mask,
                category=category or None,
                config=config,
            )
        )
    return tuple(sorted(found, key=lambda one: -len(one.cloud.points)))
