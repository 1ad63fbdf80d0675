"""Trains the network that tells things on a table apart, on depth pictures of rooms of chance.

`gfp-grasp train instances` renders, trains and measures. The loss is the intersection over union that the votes of a
thing reach when they are gathered about their own mean (Lovasz hinge, arXiv:1705.08790, as arXiv:1906.11109 uses it).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from gfp_grasp.camera import SensorModel
from gfp_grasp.detect import InstanceNet, gather_votes, instance_features, level_picture, vote
from gfp_grasp.errors import InvalidOption
from gfp_grasp.journal import write_arrays
from gfp_grasp.parallel import Progress, pmap
from gfp_grasp.scenes import draw_camera, draw_things, make_room, view_room
from gfp_grasp.train.loop import Batch, LoopConfig, train, weights_place, write_weights
from gfp_grasp.transforms import rotation_about
from gfp_grasp.types import DepthImage, SupportPlane

CROP = (144, 192)  # rows and columns of what the network learns from
_MATCH_IOU = 0.7
_DEPTH_STEP_M = 1e-4  # of the cached pictures
_LEAST_PX = 40  # of a thing that counts
_SAMPLED = 3000  # pixels of a picture that the loss looks at
_VAL_ROOMS = 60
_TABLE = SupportPlane(np.array([0.0, 0.0, 1.0]), 0.0)


@dataclass(frozen=True)
class InstancesConfig(LoopConfig):
    """Schedule and data of the network that tells things apart.

    Attributes:
        width: Width of the network.
        rooms: Number of rooms that it learns from.
        views: Views of each room.
    """

    steps: int = 7000
    batch: int = 6
    rate: float = 2e-3
    decay: float = 0.65
    weight_decay: float = 1e-4
    width: int = 24
    rooms: int = 2500
    views: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.width, self.rooms, self.views) < 1:
            raise InvalidOption("width, rooms and views must be at least 1")


@dataclass(frozen=True, eq=False)
class RoomView:
    """One depth picture of a room, with its truth.

    Attributes:
        level: (h, w, 3) m, of `level_picture`.
        labels: (h, w) int, 0 for background.
        pitch_m: Size of a pixel on the things.
    """

    level: np.ndarray
    labels: np.ndarray
    pitch_m: float


def train_instances(
    *,
    config: InstancesConfig = InstancesConfig(),
    out: Path | None = None,
    runs: Path = Path("runs"),
    workers: int = 1,
    report: Callable[[int, float], None] | None = None,
    progress: Progress | None = None,
) -> Path:
    """Train, measure on rooms of the validation split and write weights and card.

    Args:
        config: Schedule and data.
        out: Weights file; None is the shipped one.
        runs: Folder of rendered rooms and checkpoints.
        workers: Processes that render.
        report: Told the step and the loss.
        progress: Progress of the rendering.

    Returns:
        Path of the card.

    Raises:
        CannotWrite: `out` or `runs`.
    """
    out = weights_place(out, "instances", runs=runs)
    torch.manual_seed(config.seed)
    render = partial(_render_room, num_views=config.views, folder=runs / "rooms")
    paths = list(pmap(render, [("train", n) for n in range(config.rooms)], workers=workers, progress=progress))
    held_out = list(pmap(render, [("val", n) for n in range(_VAL_ROOMS)], workers=workers))
    network = InstanceNet(config.width)
    _, hours = train(
        network,
        partial(_batches, paths, config),
        instance_loss,
        config=config,
        checkpoint=runs / "instances" / "checkpoint.pt",
        report=report,
    )
    return write_weights(
        network.half().float(),
        out,
        config=config,
        data={"rooms": config.rooms, "views_a_room": config.views, "split": "train"},
        hours=hours,
        metrics=measure_instances(network, [view for path in held_out for view in read_rooms(path)]),
    )


def instance_loss(network: nn.Module, batch: Batch) -> Tensor:
    """Mean over pictures and things of the Lovasz hinge of their votes, with the losses of spread and of seed."""
    features, labels, above = batch
    answer = network(features.contiguous(memory_format=torch.channels_last)).float()
    total = features.new_zeros(())
    for own_features, own_answer, own_labels, own_above in zip(features, answer, labels, above, strict=True):
        index = torch.nonzero((own_above | (own_labels > 0)).flatten()).flatten()
        if len(index) > _SAMPLED:
            index = index[torch.randperm(len(index))[:_SAMPLED]]
        if len(index):
            votes = (own_features[:3] + own_answer[:3]).flatten(1)[:, index].T
            spread, seed = own_answer[3:].flatten(1)[:, index]
            total = total + _picture_loss(votes, spread, seed, own_labels.flatten()[index])
    return total / len(features)


def _picture_loss(votes: Tensor, spread: Tensor, seed: Tensor, labels: Tensor) -> Tensor:
    wanted, losses = torch.zeros_like(seed), []
    for label in labels.unique():
        own = labels == label
        if label == 0 or int(own.sum()) < 5:
            continue
        log_s = spread[own].mean()
        squared = ((votes - votes[own].mean(dim=0)) ** 2).sum(dim=1)
        bell = torch.exp(-squared * torch.exp(-2 * log_s.clamp(-4, 2)) / 2)
        wanted[own] = bell[own].detach()
        losses.append(_lovasz(2 * bell - 1, own) + 0.5 * ((spread[own] - log_s.detach()) ** 2).mean())
    told = ((torch.sigmoid(seed) - wanted) ** 2).mean()
    return 4 * told + (torch.stack(losses).mean() if losses else 0.0 * votes.sum())


def _lovasz(logits: Tensor, truth: Tensor) -> Tensor:
    """Lovasz extension of one less the intersection over union, for logits (n,) and truth (n,) bool."""
    signs = 2.0 * truth.float() - 1.0
    errors, order = torch.sort(1.0 - logits * signs, descending=True)
    sorted_truth = truth[order].float()
    inside = sorted_truth.sum()
    missed = inside - sorted_truth.cumsum(0)
    union = inside + (1.0 - sorted_truth).cumsum(0)
    jaccard = 1.0 - missed / union
    jaccard = torch.cat([jaccard[:1], jaccard[1:] - jaccard[:-1]])
    return torch.relu(errors) @ jaccard


def measure_instances(network: InstanceNet, views: list[RoomView]) -> dict[str, float]:
    """Share of the things that are found at an intersection over union of 0.7, and the mean of it."""
    network = network.float().eval()
    best = []
    for view in views:
        votes, above = vote(view.level, view.pitch_m, network=network)
        labels = gather_votes(votes, above)
        for k in np.unique(view.labels[view.labels > 0]):
            own = (view.labels == k) & above
            if own.sum() >= _LEAST_PX:
                rivals = np.unique(labels[own])
                best.append(max((float(_iou(own, labels == r)) for r in rivals if r), default=0.0))
    return {
        "things": len(best),
        "found": round(float(np.mean(np.array(best) >= _MATCH_IOU)), 4),
        "mean_iou": round(float(np.mean(best)), 4),
    }


def _iou(a: np.ndarray, b: np.ndarray) -> float:
    return (a & b).sum() / (a | b).sum()


def _render_room(job: tuple[str, int], *, num_views: int, folder: Path) -> Path:
    """File of the views of one room, rendered where it is not there."""
    split, number = job
    path = folder / f"{split}_{number:05d}_{num_views}.npz"
    if path.is_file():
        return path
    rng = np.random.default_rng([number, len(split)])
    count, piled = int(rng.integers(1, 16)), bool(rng.random() < 0.7)
    room = make_room(draw_things(rng, count, split=split), rng, piled=piled)
    depths, labels, cameras = [], [], []
    for _ in range(num_views):
        sensor = (SensorModel.realsense(), SensorModel.kinect())[int(rng.integers(2))]
        distance_m = float(np.exp(rng.uniform(np.log(0.45), np.log(1.8))))
        image, label = view_room(room, draw_camera(room, rng, distance_m=distance_m), rng, sensor=sensor)
        depths.append(np.round(image.depth_m / _DEPTH_STEP_M).astype(np.uint16))
        labels.append(label.astype(np.uint8))
        cameras.append(image.T_world_camera)
    write_arrays(path, depth=depths, labels=labels, T_world_camera=cameras, K=image.K)
    return path


def read_rooms(path: Path) -> Iterator[RoomView]:
    """The views of a room."""
    with np.load(path) as content:
        depths, labels, cameras, K = (content[name] for name in ("depth", "labels", "T_world_camera", "K"))
    for depth, label, camera in zip(depths, labels, cameras, strict=True):
        image = DepthImage(depth * np.float32(_DEPTH_STEP_M), K, camera)
        ranges = depth[label > 0] * _DEPTH_STEP_M
        pitch_m = float(np.median(ranges) if len(ranges) else np.median(depth) * _DEPTH_STEP_M) / float(K[0, 0])
        yield RoomView(level_picture(image, _TABLE), label, max(pitch_m, 1e-4))


def _batches(paths: list[Path], config: InstancesConfig, generator: torch.Generator) -> Iterator[Batch]:
    """Endless batches of augmented crops: features, labels, and which pixels are above the table."""
    rng = np.random.default_rng(int(torch.randint(2**31, (1,), generator=generator)))
    waiting: list[tuple] = []
    while True:
        for number in rng.permutation(len(paths)):
            waiting += [_augmented(view, rng) for view in read_rooms(paths[number])]
            if len(waiting) >= 8 * config.batch:  # views of one room are not to meet in one batch
                rng.shuffle(waiting)
                while len(waiting) >= 4 * config.batch:
                    drawn, waiting = waiting[: config.batch], waiting[config.batch :]
                    yield tuple(torch.from_numpy(np.stack(part)) for part in zip(*drawn, strict=True))


def _augmented(view: RoomView, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A crop, mirrored or not, of another size, its table not quite where it is thought to be."""
    rows, columns = np.nonzero(view.labels)
    at = int(rng.integers(len(rows))) if len(rows) else 0
    centre = (rows[at], columns[at]) if len(rows) else (view.labels.shape[0] // 2, view.labels.shape[1] // 2)
    window = tuple(
        slice(start, start + size)
        for start, size in (
            (int(np.clip(c - rng.integers(size // 4, 3 * size // 4), 0, whole - size)), size)
            for c, size, whole in zip(centre, CROP, view.labels.shape, strict=True)
        )
    )
    scale = float(np.exp(rng.normal(scale=0.15)))
    level, labels = scale * view.level[window], view.labels[window].astype(np.int64)
    tilt = rotation_about((np.cos(a := rng.uniform(0, 2 * np.pi)), np.sin(a), 0), np.radians(rng.normal(scale=0.4)))
    seen = np.isfinite(level).all(axis=2) & (labels > 0)
    middle = level[seen].mean(axis=0) * (1, 1, 0) if seen.any() else np.zeros(3)
    level = (level - middle) @ tilt.T + (0.0, 0.0, rng.normal(scale=0.001))
    if rng.random() < 0.5:
        level, labels = level[:, ::-1] * (-1, 1, 1), labels[:, ::-1]
    features, above = instance_features(level, scale * view.pitch_m)
    return features, np.ascontiguousarray(labels), above
