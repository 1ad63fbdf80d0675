"""Vehicles and people of a LiDAR's scan, found by the two stages of `street_net`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch

from gfp_grasp.assets import data_file
from gfp_grasp.detect.boxes import SeenScan, things_in
from gfp_grasp.detect.street_net import (
    CELL_M,
    LEVELS_M,
    StreetNet,
    boxes_of,
    picture_from_above,
    places_in,
    point_features,
    pool,
    refined_boxes,
)
from gfp_grasp.detect.turned import inside, suppress
from gfp_grasp.errors import NothingDetected
from gfp_grasp.networks import with_weights
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import LIDAR, Detection, OrientedBox, RangeImage, SensorProfile

REACH_M = 51.2  # to the front, the back and the sides
_OWN_M = 2.5  # returns that are nearer come from the vehicle that carries the sensor
_THIN_M = 0.1
_LIKELY = 0.05  # score of a point whose box is looked at,
_SQUARE_M = 0.4  # the best of each square of this side
_MOST_POINTS, _MOST_BOXES, _MOST_FOUND = 1500, 100, 100
_PROPOSAL_IOU, _FINAL_IOU = 0.7, 0.1
_SHARED = 0.5  # of its points, from which on a box shows what a better one shows
_SIDE = int(2 * REACH_M / CELL_M)
SURE_BOX = 0.7  # score of a box that is believed
_GROWN_M = 0.1  # by which its sides are moved out, so that what is just beyond them belongs to it


@dataclass(frozen=True, eq=False)
class ShippedStreetNet:
    """The network with the classes that it tells apart."""

    network: StreetNet
    classes: tuple[str, ...]


@cache
def load_pointrcnn() -> ShippedStreetNet:
    """The shipped network, in evaluation mode, loaded once."""
    card = json.loads(data_file("weights", "pointrcnn.json").read_text(encoding="utf-8"))
    classes = tuple(card["config"]["classes"])
    path = data_file("weights", "pointrcnn.safetensors")
    network = with_weights(StreetNet(len(classes), card["config"]["width"]), path, name="pointrcnn")
    return ShippedStreetNet(network, classes)


def detect_traffic(
    image: RangeImage, *, up: np.ndarray | None = None, sensor: SensorProfile = LIDAR
) -> tuple[Detection, ...]:
    """The vehicles and people of a scan that have 30 returns or more, most points first.

    Args:
        image: The scan.
        up: (3,) roughly the road's normal; None takes the scanner's own z axis.
        sensor: What saw them.

    Raises:
        InvalidView: Not a RangeImage.
        NothingDetected: No road, or nothing on it.
    """
    seen = SeenScan.of(image, up, sensor)
    there = np.isfinite(seen.height_m)
    level = (seen.points[there] - image.viewpoint) @ seen.road.axes.T
    boxes, scores, _ = find_boxes(np.column_stack([level, seen.height_m[there]]))
    found = things_in(seen, [_box_in_world(box, seen) for box in boxes[scores > SURE_BOX]], None, sensor)
    if not found:
        raise NothingDetected(
            f"a road, but neither vehicle nor person on it: the most likely of {len(boxes)} boxes has the score "
            f"{scores.max(initial=0.0):.2f}, {SURE_BOX:g} is needed, and 30 returns"
        )
    return found


def _box_in_world(box: np.ndarray, seen: SeenScan) -> OrientedBox:
    """A box (7,) over the road's level axes, with its sides moved out a little."""
    road = seen.road
    axes = np.vstack([road.axes, road.up]).T
    foot = seen.image.viewpoint + road.axes.T @ box[:2]
    centre = foot + (box[2] - road.heights(foot[None])[0]) * road.up
    return OrientedBox(make_T(axes @ rotation_about((0, 0, 1), box[6]), centre), box[3:6] + 2 * _GROWN_M)


def find_boxes(
    points: np.ndarray, *, network: StreetNet | None = None, classes: Sequence[str] = ()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Boxes of vehicles and people.

    Args:
        points: (n, 3) m, x and y from the sensor in a level frame, z from the road.
        network: None takes the shipped one.
        classes: The classes of that network.

    Returns:
        Boxes (m, 7) as `turned` has them, their scores (m,) from 0 to 1, the best first, and their classes (m,).
    """
    if network is None:
        shipped = load_pointrcnn()
        network, classes = shipped.network, shipped.classes
    away = np.hypot(points[:, 0], points[:, 1]) > _OWN_M
    near = (
        away
        & (np.abs(points[:, :2]) < REACH_M).all(axis=1)
        & (points[:, 2] >= LEVELS_M[0])
        & (points[:, 2] < LEVELS_M[-1])
    )
    points, nothing = points[near], (np.empty((0, 7)), np.empty(0), np.empty(0, dtype="U20"))
    if not len(points):
        return nothing
    corner, shape = np.full(2, -REACH_M), (_SIDE, _SIDE)
    picture = torch.from_numpy(picture_from_above(points, corner, shape))[None]
    chosen = points[thinned(points)]
    rng = np.random.default_rng(0)
    with torch.inference_mode():
        seen = network.seen(picture.contiguous(memory_format=torch.channels_last))
        own = torch.from_numpy(chosen.astype(np.float32))[None]
        features = network.features_at(seen, places_in(own, torch.from_numpy(corner.astype(np.float32)), shape))
        odds, answer = network.first(features, point_features(own))
        score = torch.sigmoid(odds[0]).amax(dim=-1)
        likely = torch.from_numpy(_spread(chosen, score.numpy()))
        boxes = boxes_of(own[0, likely], answer[0, likely]).double().numpy()
        kept = suppress(boxes, score[likely].numpy(), iou=_PROPOSAL_IOU, most=_MOST_BOXES)
        boxes = boxes[kept]
        index, mask, told = pool(chosen, boxes, rng)
        some = mask.any(axis=1)
        if not some.any():
            return nothing
        pooled = torch.cat([features[0][torch.from_numpy(index[some])], torch.from_numpy(told[some])], dim=-1)
        start = torch.from_numpy(boxes[some].astype(np.float32))
        sure, odds, moves = network.second(pooled, torch.from_numpy(mask[some]), start[:, 3:6])
        boxes = refined_boxes(start, moves).double().numpy()
        scores, names = torch.sigmoid(sure).double().numpy(), np.array(classes)[odds.argmax(dim=1).numpy()]
    kept = suppress(boxes, scores, iou=_FINAL_IOU, most=_MOST_FOUND)
    kept = kept[_with_own_points(boxes[kept], chosen)]
    return boxes[kept], scores[kept], names[kept]


def _with_own_points(boxes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which boxes (m, 7), the best first, hold points (n, 3) m of which no better box has most: (m,) bool.

    Two boxes on either side of one flank hardly overlap.
    """
    taken, kept = np.zeros(len(points), dtype=bool), np.zeros(len(boxes), dtype=bool)
    for row, box in enumerate(boxes):
        own = inside(points, box, grow_m=_GROWN_M)
        kept[row] = own.any() and taken[own].mean() < _SHARED
        if kept[row]:
            taken |= own
    return kept


def _spread(points: np.ndarray, scores: np.ndarray) -> np.ndarray:
    """Indices of the likely points (n, 3) m, the best of each square of the ground: near things have most points."""
    order = np.argsort(-scores, kind="stable")
    order = order[scores[order] > _LIKELY]
    cells = np.floor(points[order, :2] / _SQUARE_M).astype(np.int64)
    _, first = np.unique(cells, axis=0, return_index=True)
    return order[np.sort(first)[:_MOST_POINTS]]


def thinned(points: np.ndarray) -> np.ndarray:
    """Indices of one point (n, 3) m in each cube of a decimetre."""
    cells = np.floor(points / _THIN_M).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    key = (cells[:, 0] << 40) | (cells[:, 1] << 20) | cells[:, 2]
    return np.unique(key, return_index=True)[1]
