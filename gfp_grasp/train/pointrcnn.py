"""Trains the detector of LiDAR scans: both stages at once, on streets of chance or on a tree of KITTI's.

`gfp-grasp train pointrcnn` renders, trains and measures. The first stage's loss is the focal loss of the classes
(arXiv:1708.02002) and that of the boxes in bins (arXiv:1812.04244); the second stage learns from boxes of the first
and from true boxes that are moved a little.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from gfp_grasp.detect import (
    CELL_M,
    SURE_BOX,
    StreetNet,
    box_loss,
    boxes_of,
    find_boxes,
    inside,
    iou_from_above,
    picture_from_above,
    places_in,
    point_features,
    pool,
    refined_loss,
    thinned,
)
from gfp_grasp.errors import InvalidOption
from gfp_grasp.parallel import pmap
from gfp_grasp.shapes import IN_STREETS
from gfp_grasp.train.loop import Batch, LoopConfig, train, weights_place, write_weights
from gfp_grasp.train.street_data import StreetScan, read_street, render_street, street_of_kitti, write_street
from gfp_grasp.transforms import rotation_about

_CROP = 256  # cells of a side of what is learnt from
_POINTS = 5000  # of a crop
_MOST_BOXES = 48
_FEWEST_SEEN = 5  # points of a box that is to be found; what has fewer teaches nothing
_LIKELIEST = 600  # points of a crop, whose boxes the first stage proposes to the second,
_PROPOSALS, _MOVED = 24, 12  # the number of those that it learns from, and of true ones that are moved
_UNSAID = -2  # what a point is that teaches nothing; -1 is of no thing
_SURE_IOU = (0.25, 0.75)  # overlaps from which on a box is not quite wrong, and right
_REFINED_IOU = 0.3
_VAL_STREETS = 60
_FOUND_IOU = 0.5
_FEWEST_MEASURED = 30  # points


@dataclass(frozen=True)
class PointRCNNConfig(LoopConfig):
    """Schedule and data of the detector of LiDAR scans.

    Attributes:
        width: Width of the network.
        streets: Number of simulated scans that it learns from.
        classes: What it tells apart.
    """

    steps: int = 6000
    batch: int = 4
    rate: float = 2e-3
    decay: float = 0.65
    weight_decay: float = 1e-3
    width: int = 32
    streets: int = 1500
    classes: tuple[str, ...] = tuple(IN_STREETS)

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.width, self.streets, len(self.classes)) < 1:
            raise InvalidOption("width, streets and the number of classes must be at least 1")


def train_pointrcnn(
    *,
    config: PointRCNNConfig = PointRCNNConfig(),
    data: Path | None = None,
    out: Path | None = None,
    runs: Path = Path("runs"),
    workers: int = 1,
    report: Callable[[int, float], None] | None = None,
) -> Path:
    """Train, measure on held-out scans and write weights and card.

    Args:
        config: Schedule and data.
        data: A tree of KITTI's, of which every tenth scan is held out; None simulates streets.
        out: Weights file; None is the shipped one.
        runs: Folder of scans and checkpoints.
        workers: Processes that render.
        report: Told the step and the loss.

    Returns:
        Path of the card.

    Raises:
        InvalidOption: Fewer than two scans in `data`.
        CannotWrite: `out` or `runs`.
    """
    out = weights_place(out, "pointrcnn", runs=runs)
    torch.manual_seed(config.seed)
    if data is None:
        render = partial(render_street, folder=runs / "streets")
        paths = list(pmap(render, [("train", n) for n in range(config.streets)], workers=workers))
        held_out = list(pmap(render, [("val", n) for n in range(_VAL_STREETS)], workers=workers))
    else:
        scans = enumerate(street_of_kitti(data))
        kept = [write_street(runs / "kitti" / f"{n:06d}.npz", scan) for n, scan in scans]
        paths, held_out = [path for n, path in enumerate(kept) if n % 10], kept[::10]
        if not paths:
            raise InvalidOption(f"{data.name} holds {len(kept)} scans; at least 2 are needed, one of them held out")
    network = StreetNet(len(config.classes), config.width)
    _, hours = train(
        network,
        partial(_batches, paths, config),
        pointrcnn_loss,
        config=config,
        checkpoint=runs / "pointrcnn" / "checkpoint.pt",
        report=report,
    )
    return write_weights(
        network.half().float(),
        out,
        config=config,
        data={"scans": len(paths), "held_out": len(held_out), "simulated": data is None},
        hours=hours,
        metrics=measure_pointrcnn(network, [read_street(path) for path in held_out], config.classes),
    )


def pointrcnn_loss(network: nn.Module, batch: Batch) -> Tensor:
    """Loss of both stages for one batch: pictures, their corners, points, their things, boxes and classes."""
    assert isinstance(network, StreetNet)
    picture, corner, points, things, boxes, classes = batch
    seen = network.seen(picture.contiguous(memory_format=torch.channels_last))
    shape = picture.shape[2], picture.shape[3]
    features = network.features_at(seen, places_in(points, corner[:, None], shape))
    odds, answer = network.first(features, point_features(points))
    own = things.clamp(min=0)[..., None]
    of_thing = boxes.gather(1, own.expand(-1, -1, 7))
    wanted = functional.one_hot(classes.gather(1, things.clamp(min=0)).clamp(min=0), network.num_classes).float()
    wanted = wanted * (things >= 0)[..., None]
    told = things > _UNSAID
    weights = _by_thing(things)
    focal = _focal(odds, wanted) * torch.where(things >= 0, weights, torch.ones_like(weights))[..., None]
    num_things = (classes >= 0).sum().clamp(min=1)
    total = (focal * told[..., None]).sum() / num_things / 4
    fg = things >= 0
    total = total + box_loss(answer[fg], points[fg], of_thing[fg], weights[fg]) / weights[fg].sum().clamp(min=1.0)
    with torch.no_grad():
        found = boxes_of(points, answer)
        score = odds.amax(dim=-1)
    rng = np.random.default_rng(int(torch.randint(2**31, (1,))))
    losses = []
    for b in range(len(picture)):
        own_loss = _second_loss(
            network, features[b], points[b], found[b], score[b].masked_fill(~told[b], -20.0), boxes[b], classes[b], rng
        )
        losses.append(own_loss)
    return total + torch.stack(losses).mean()


def _second_loss(
    network: StreetNet,
    features: Tensor,
    points: Tensor,
    found: Tensor,
    score: Tensor,
    boxes: Tensor,
    classes: Tensor,
    rng: np.random.Generator,
) -> Tensor:
    """The second stage's loss in one crop."""
    device, known = features.device, (classes >= 0).cpu().numpy()
    truth, names = boxes.cpu().numpy()[known].astype(np.float64), classes.cpu().numpy()[known]
    best = torch.topk(score, min(_LIKELIEST, len(score))).indices.cpu().numpy()
    best = rng.choice(best, min(_PROPOSALS, len(best)), replace=False)
    rois = np.concatenate([found.cpu().numpy()[best].astype(np.float64), _moved(truth, rng)])
    if not len(rois):
        return features.sum() * 0.0
    overlap = iou_from_above(rois, truth) if len(truth) else np.zeros((len(rois), 1))
    which, iou = overlap.argmax(axis=1), overlap.max(axis=1)
    index, mask, told = pool(points.cpu().numpy(), rois, rng)
    some = np.flatnonzero(mask.any(axis=1))
    if not len(some):
        return features.sum() * 0.0
    which, iou = which[some], iou[some]
    pooled = torch.cat([features[torch.from_numpy(index[some])], torch.from_numpy(told[some]).to(device)], dim=-1)
    start = torch.from_numpy(rois[some].astype(np.float32)).to(device)
    sure, odds, moves = network.second(pooled, torch.from_numpy(mask[some]).to(device), start[:, 3:6])
    low, high = _SURE_IOU
    wanted = torch.from_numpy(np.clip((iou - low) / (high - low), 0, 1).astype(np.float32)).to(device)
    total = functional.binary_cross_entropy_with_logits(sure, wanted)
    good = iou > _REFINED_IOU
    if good.any():
        own = torch.from_numpy(truth[which[good]].astype(np.float32)).to(device)
        chosen = torch.from_numpy(good).to(device)
        total = total + refined_loss(moves[chosen], start[chosen], own) / 2
        total = total + functional.cross_entropy(odds[chosen], torch.from_numpy(names[which[good]]).to(device)) / 2
    return total


def _moved(truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """True boxes (m, 7) moved, turned and stretched a little."""
    if not len(truth):
        return np.empty((0, 7))
    boxes = truth[rng.integers(len(truth), size=_MOVED)].copy()
    spread = rng.uniform(0.0, 1.0, (_MOVED, 1))
    boxes[:, :2] += spread * rng.normal(scale=0.2, size=(_MOVED, 2)) * np.minimum(boxes[:, 3:5], 4.0)
    boxes[:, 2] += 0.1 * rng.standard_normal(_MOVED)
    boxes[:, 3:6] *= np.exp(spread * rng.normal(scale=0.15, size=(_MOVED, 3)))
    boxes[:, 6] += spread[:, 0] * rng.normal(scale=0.2, size=_MOVED)
    return boxes


def _by_thing(things: Tensor) -> Tensor:
    """Weight (b, p) of each point: a near thing has more points than a far one, but is not worth as much more."""
    weights = torch.zeros_like(things, dtype=torch.float32)
    for own, out in zip(things, weights, strict=True):
        counts = torch.bincount(own.clamp(min=0)[own >= 0], minlength=_MOST_BOXES).float().clamp(min=1)
        out[own >= 0] = 1 / counts[own[own >= 0]].sqrt()
    return weights


def _focal(odds: Tensor, wanted: Tensor) -> Tensor:
    p = torch.sigmoid(odds)
    right = wanted * p + (1 - wanted) * (1 - p)
    balance = wanted * 0.5 + (1 - wanted) * 0.5
    return balance * (1 - right) ** 2 * functional.binary_cross_entropy_with_logits(odds, wanted, reduction="none")


def _batches(paths: Sequence[Path], config: PointRCNNConfig, generator: torch.Generator) -> Iterator[Batch]:
    rng = np.random.default_rng(int(torch.randint(2**31, (1,), generator=generator)))
    number = {name: n for n, name in enumerate(config.classes)}
    waiting: list[tuple[np.ndarray, ...]] = []
    while True:
        for chosen in rng.permutation(len(paths)):
            scan = read_street(paths[chosen])
            waiting += [_crop(scan, number, rng) for _ in range(2)]
            while len(waiting) >= config.batch:
                drawn, waiting = waiting[: config.batch], waiting[config.batch :]
                yield tuple(torch.from_numpy(np.stack(part)) for part in zip(*drawn, strict=True))


def _crop(scan: StreetScan, number: dict[str, int], rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """A square of a scan, turned, mirrored and worn: picture, corner, points, their things, boxes and classes."""
    points, boxes = scan.points.copy(), scan.boxes.copy()
    known = np.array([name in number for name in scan.classes], dtype=bool)
    things = scan.things.copy()
    taught = np.append(known & (np.bincount(things[things >= 0], minlength=len(boxes)) >= _FEWEST_SEEN), True)
    things[~taught[things]] = _UNSAID  # the last is that of no thing
    things[np.abs(np.arctan2(points[:, 1], points[:, 0])) > scan.labelled] = _UNSAID
    points, things = _worn(points, things, boxes, rng)
    points, boxes = _turned(points, boxes, rng)
    side = _CROP * CELL_M
    seen = np.unique(things[things >= 0])
    middle = boxes[rng.choice(seen), :2] if len(seen) and rng.random() < 0.85 else rng.uniform(-30, 30, 2)
    corner = middle - rng.uniform(0.15, 0.85, 2) * side
    picture = picture_from_above(points, corner, (_CROP, _CROP))
    chosen = thinned(points)
    chosen = chosen[((points[chosen, :2] >= corner) & (points[chosen, :2] < corner + side)).all(axis=1)]
    chosen = rng.choice(chosen, _POINTS, replace=len(chosen) < _POINTS) if len(chosen) else chosen
    if not len(chosen):
        return _crop(scan, number, rng)
    own = things[chosen]
    there = np.unique(own[own >= 0])[:_MOST_BOXES]
    place = np.full(len(boxes) + 1, _UNSAID)
    place[there] = np.arange(len(there))
    own = np.where(own >= 0, place[own], own)
    kept, classes = np.ones((_MOST_BOXES, 7)), np.full(_MOST_BOXES, -1)
    kept[: len(there)], classes[: len(there)] = boxes[there], [number[str(scan.classes[n])] for n in there]
    return (
        picture,
        corner.astype(np.float32),
        points[chosen].astype(np.float32),
        own.astype(np.int64),
        kept.astype(np.float32),
        classes.astype(np.int64),
    )


def _worn(
    points: np.ndarray, things: np.ndarray, boxes: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Returns are lost, above all of windows and dark paint, and places are noisy."""
    kept = rng.random(len(points)) >= rng.uniform(0.0, 0.5)
    for n in np.unique(things[things >= 0]):
        if rng.random() < 0.6:
            low, high = np.array([0.5, 1.0]) * boxes[n, 5] + rng.normal(scale=0.08, size=2)
            glass = (things == n) & (points[:, 2] > low) & (points[:, 2] < high)
            kept &= ~(glass & (rng.random(len(points)) < rng.uniform(0.3, 1.0)))
        if rng.random() < 0.2:
            kept &= ~((things == n) & (rng.random(len(points)) < rng.uniform(0.0, 0.8)))
    noisy = points[kept] + rng.normal(scale=rng.uniform(0.0, 0.03), size=(int(kept.sum()), 3))
    return noisy, things[kept]


def _turned(points: np.ndarray, boxes: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Another heading of the sensor, mirrored or not, another size, and a road that is not quite where it was found."""
    turn, scale = rng.uniform(-np.pi, np.pi), np.exp(rng.normal(scale=0.05))
    R = rotation_about((0, 0, 1), turn)
    points, boxes = scale * points @ R.T, boxes.copy()
    boxes[:, :3] = scale * boxes[:, :3] @ R.T
    boxes[:, 3:6] *= scale
    boxes[:, 6] += turn
    if rng.random() < 0.5:
        points, boxes = points * (1, -1, 1), boxes * (1, -1, 1, 1, 1, 1, -1)
    wave, phase, high = rng.normal(scale=0.08, size=2), rng.uniform(0, 2 * np.pi), rng.normal(scale=0.1)
    points[:, 2] += high * np.sin(points[:, :2] @ wave + phase)
    boxes[:, 2] += high * np.sin(boxes[:, :2] @ wave + phase)
    return points, boxes


def measure_pointrcnn(network: StreetNet, scans: Sequence[StreetScan], classes: Sequence[str]) -> dict[str, float]:
    """Recall and precision at an overlap of one half, by class, of what has 30 points or more."""
    network = network.float().eval()
    counts = {name: np.zeros(4) for name in classes}  # things, those found, boxes, those right
    for scan in scans:
        boxes, scores, names = find_boxes(scan.points, network=network, classes=classes)
        sure = (scores > SURE_BOX) & (np.abs(np.arctan2(boxes[:, 1], boxes[:, 0])) < scan.labelled)
        boxes, names = boxes[sure], names[sure]
        hit = (iou_from_above(boxes, scan.boxes) > _FOUND_IOU) & (names[:, None] == scan.classes[None])
        for there, category, found, at in ((scan.boxes, scan.classes, hit.T, 0), (boxes, names, hit, 2)):
            for box, name, right in zip(there, category, found, strict=True):
                if name in counts and inside(scan.points, box).sum() >= _FEWEST_MEASURED:
                    counts[str(name)][at : at + 2] += 1, right.any()
    figures: dict[str, float] = {}
    for name, (things, found, given, right) in counts.items():
        figures[f"recall_{name}"] = round(float(found / max(things, 1)), 4)
        figures[f"precision_{name}"] = round(float(right / max(given, 1)), 4)
    return figures
