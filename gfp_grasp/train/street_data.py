"""Scans of streets with boxes, as the detector of LiDAR scans learns from them: simulated ones, and a tree of KITTI's.

Kept are the points between the road and 5 m above it, their z measured from the road.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gfp_grasp.camera import HDL_64
from gfp_grasp.datasets import read_scans
from gfp_grasp.detect import find_road, inside
from gfp_grasp.errors import NothingDetected
from gfp_grasp.journal import write_arrays
from gfp_grasp.scenes import draw_street, scan_street

_HIGHEST_M = 5.0  # above the road
_LOWEST_M = 0.05
_FARTHEST_M = 60.0
_STEP_M = 0.002  # of the cached places
_NUM_THINGS = (10, 45)
_HEIGHT_M = (1.5, 2.0)  # of the sensor
_LOST = 0.3  # largest share of the returns that are lost
_UP = np.array([0.0, 0.0, 1.0])
_GROWN_M = 0.05  # by which a box is grown for the points that belong to it
# The field of KITTI's left colour camera, in which things have labels, is 81 degrees wide.
_LABELLED_RAD = np.deg2rad(40.5)


@dataclass(frozen=True, eq=False)
class StreetScan:
    """What is above the road in one scan, and the boxes of vehicles and people.

    Attributes:
        points: (n, 3) m, x and y from the sensor, z from the road.
        boxes: (m, 7) m and rad: centre, length, width, height, yaw; z from the road.
        classes: (m,) names.
        things: (n,) int, the box that each point is in; -1 for none.
        labelled: Half the angle about x within which everything has a box, rad.
    """

    points: np.ndarray
    boxes: np.ndarray
    classes: np.ndarray
    things: np.ndarray
    labelled: float = np.pi


def render_street(job: tuple[str, int], *, folder: Path) -> Path:
    """File of one simulated scan, made where it is not there.

    Args:
        job: Split of the shapes, and number of the street.
        folder: Where scans are kept.
    """
    split, number = job
    path = folder / f"{split}_{number:05d}.npz"
    if path.is_file():
        return path
    rng = np.random.default_rng([number, len(split)])
    street = draw_street(rng, num_things=int(rng.integers(*_NUM_THINGS)), split=split)
    lidar = replace(HDL_64, height_m=rng.uniform(*_HEIGHT_M), lost_share=rng.uniform(0.0, _LOST))
    image, _ = scan_street(street, rng, lidar=lidar)
    boxes = np.array(
        [[*one.box.T_world_box[:3, 3], *one.box.extents, _yaw(one.box.T_world_box)] for one in street.things]
    )
    names = np.array([thing.category for thing in street.things], dtype="U20")
    write_street(path, _street(image.points()[image.range_m > 0], boxes.reshape(-1, 7), names))
    return path


def street_of_kitti(scans: str | Path, *, limit: int | None = None) -> Iterator[StreetScan]:
    """The scans of a tree of KITTI's, whose labels cover what the camera saw.

    Args:
        scans: A folder as `datasets.read_scans` takes it.
        limit: Most scans.
    """
    for scan in read_scans(scans, limit=limit):
        try:
            road = find_road(scan.points, _UP, viewpoint=np.zeros(3))
        except NothingDetected:  # a crop of one thing
            continue
        centres = np.array([box.centre for box in scan.boxes]).reshape(-1, 3)
        rest = [[*box.size_m, box.yaw_rad] for box in scan.boxes]
        heights = road.heights(centres)
        boxes = np.column_stack([centres[:, :2], heights, np.array(rest).reshape(-1, 4)])
        points = np.column_stack([scan.points[:, :2], road.heights(scan.points)])
        yield _street(points, boxes, np.array([box.category for box in scan.boxes], dtype="U20"), _LABELLED_RAD)


def read_street(path: Path) -> StreetScan:
    """A scan that `write_street` has written."""
    with np.load(path) as content:
        return StreetScan(
            content["points"] * _STEP_M,
            content["boxes"],
            content["classes"],
            content["things"].astype(np.int64),
            float(content["labelled"]),
        )


def write_street(path: Path, scan: StreetScan) -> Path:
    """Keep a scan, its places to 2 mm."""
    write_arrays(
        path,
        points=np.round(scan.points / _STEP_M).astype(np.int16),
        boxes=scan.boxes,
        classes=scan.classes,
        things=scan.things.astype(np.int8),
        labelled=scan.labelled,
    )
    return path


def _street(points: np.ndarray, boxes: np.ndarray, classes: np.ndarray, labelled: float = np.pi) -> StreetScan:
    """What of a scan's points (n, 3) m is kept, with the box that each is in."""
    points = _kept(points)
    things = np.full(len(points), -1)
    for n, box in enumerate(boxes):
        things[inside(points, box, grow_m=_GROWN_M)] = n
    return StreetScan(points, boxes, classes, things, labelled)


def _kept(points: np.ndarray) -> np.ndarray:
    near = (np.abs(points[:, :2]) < _FARTHEST_M).all(axis=1)
    return points[near & (points[:, 2] > _LOWEST_M) & (points[:, 2] < _HIGHEST_M)]


def _yaw(T: np.ndarray) -> float:
    return float(np.arctan2(T[1, 0], T[0, 0]))
