"""Samples of the proposal network: views in the seen frame with their targets, turned, cropped and thinned anew."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gfp_grasp.detect import (
    NUM_CHANNELS,
    POOL_POINTS,
    features,
    sample_points,
    seen_frame,
    size_of,
    turned_cloud,
    with_surface,
)
from gfp_grasp.errors import InvalidOption
from gfp_grasp.journal import write_arrays
from gfp_grasp.train.loop import LoopConfig
from gfp_grasp.train.proposal_data import TABLE, UP, Example, Placed, above_table
from gfp_grasp.transforms import apply_T, invert_T, rotation_about
from gfp_grasp.types import RESTS, get_sensor

_TRAIN_POINTS = 256  # a third of what is used later: max-pooling does not mind, and steps are thrice as fast
_MOST_TURNS = 6


@dataclass(frozen=True)
class ProposalConfig(LoopConfig):
    """Schedule and data of the proposal network.

    Attributes:
        width: Width of the network.
        channels: Length of an embedding.
        views: Number of views of each member of a class of the training split.
        limit: Members of a class; None takes the whole split.
        kinds: Kinds of other things.
        members: Members of each of these kinds, two views each.
        share: Share of a batch that are views of classes; the rest are views of other things.
        proxies: Vectors that the views of one kind or subcategory are drawn to.
        kind_weight: Weight of the loss that tells subcategories of one class apart.
        pose_weight: Weight of the loss of pose and box.
        unknown_table: Share of samples whose lowest point stands for the table.
        unknown_viewpoint: Share of samples of which nobody knows from where they were seen.
        sensor: Name of the kind of sensor whose views it learns from, see `types.SENSORS`.
    """

    steps: int = 15000
    batch: int = 96
    rate: float = 2e-3
    decay: float = 0.65
    bf16: bool = True
    width: int = 64
    channels: int = NUM_CHANNELS
    views: int = 3
    limit: int | None = 240
    kinds: int = 60
    members: int = 8
    share: float = 0.8
    proxies: int = 2
    kind_weight: float = 0.2
    pose_weight: float = 1.0
    unknown_table: float = 0.25
    unknown_viewpoint: float = 0.2
    sensor: str = "tabletop"

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.width, self.channels, self.views, self.kinds, self.members, self.proxies) < 1:
            raise InvalidOption("width, channels, views, kinds, members and proxies must be at least 1")
        shares = (self.unknown_table, self.unknown_viewpoint)
        if not all(0 <= share <= 1 for share in shares) or not 0 < self.share < 1:
            raise InvalidOption("unknown_table, unknown_viewpoint must be in 0 .. 1, share between 0 and 1")


# Of traffic there are fewer classes, and nobody knows the road under a box that was cut out of a scan.
LIDAR_CONFIG = ProposalConfig(steps=6000, views=6, unknown_table=0.5, sensor="lidar")


@dataclass(frozen=True, eq=False)
class Targets:
    """What the samples are, e of them, in the seen frame of each.

    Attributes:
        pool: (e, POOL_POINTS, 9) float16 clouds of `with_surface`; lengths in units of `unit_m`.
        unit_m: (e,) m.
        classes: (e, a) the probability of each class and of each kind of other things.
        kind: (e,) number of the kind among all kinds; -1 where it must not be asked for.
        class_of: (kinds,) number of the class of each kind.
        rests: (e,) index in RESTS.
        R: (e, 3, 3), the object's axes.
        box: (e, 2, 3) m, centre and extents; NaN where the object has no axes of its own.
        order: (e,) fold of the symmetry about z; 0 for a body of revolution.
        num_views: How many of the first samples are views of classes.
        floor_m: What is nearer to the table was left out.
    """

    pool: np.ndarray
    unit_m: np.ndarray
    classes: np.ndarray
    kind: np.ndarray
    class_of: Tensor
    rests: np.ndarray
    R: np.ndarray
    box: np.ndarray
    order: np.ndarray
    num_views: int
    floor_m: float


def make_targets(
    examples: Sequence[Example], assorted: Sequence[Example], config: ProposalConfig, cache: Path
) -> Targets:
    usable = [e for e in examples if _is_usable(e)]
    num_views = len(usable)
    usable += [e for e in assorted if _is_usable(e)]
    classes = list(dict.fromkeys(e.category for e in usable))
    kinds = list(dict.fromkeys((e.category, e.subcategory) for e in usable))
    target = np.zeros((len(usable), len(classes)), dtype=np.float32)
    for row, example in zip(target, usable, strict=True):
        known = [answer for answer in example.answers if answer in classes]
        row[[classes.index(answer) for answer in known]] = 1 / len(known)
    kind = [kinds.index((e.category, e.subcategory)) if len(e.answers) == 1 else -1 for e in usable]
    pool, unit_m = _pool(usable, config.seed, cache)
    R, box, order = np.tile(np.eye(3), (len(usable), 1, 1)), np.full((len(usable), 2, 3), np.nan), np.zeros(len(usable))
    for i, example in enumerate(usable):
        if example.placed is not None:
            truth = placed_in_seen_frame(example)
            R[i], box[i] = truth.R, (truth.centre, truth.extents)
            order[i] = 0 if math.isinf(truth.order) else truth.order
    return Targets(
        pool,
        unit_m,
        target,
        np.array(kind),
        torch.tensor([classes.index(category) for category, _ in kinds]),
        np.array([RESTS.index(e.resting) for e in usable]),
        R,
        box,
        order,
        num_views,
        get_sensor(config.sensor).floor_m,
    )


def placed_in_seen_frame(example: Example) -> Placed:
    """How an object with axes of its own lies in the seen frame of its view."""
    assert example.placed is not None
    T_seen_world = invert_T(
        seen_frame(above_table(example), UP, TABLE, example.viewpoint, floor_m=example.sensor.floor_m)
    )
    R, centre = T_seen_world[:3, :3] @ example.placed.R, apply_T(T_seen_world, example.placed.centre)
    return replace(example.placed, R=R, centre=centre)


def _pool(examples: Sequence[Example], seed: int, cache: Path) -> tuple[np.ndarray, np.ndarray]:
    """Clouds (e, POOL_POINTS, 9) float16 in units (e,) m, which takes minutes: from the cache."""
    content = hashlib.sha256(f"{seed} {POOL_POINTS}".encode())
    for example in examples:
        content.update(example.points.tobytes())
    path = cache / f"pool_{content.hexdigest()[:16]}.npz"
    if not path.is_file():
        rng = np.random.default_rng(seed)
        clouds, units = np.zeros((len(examples), POOL_POINTS, 9), dtype=np.float16), np.zeros(len(examples))
        for i, example in enumerate(examples):
            cloud = seen_cloud(example, rng)
            units[i] = size_of(cloud[:, :3])
            clouds[i] = np.column_stack([cloud[:, :3] / units[i], cloud[:, 3:]])
        write_arrays(path, clouds=clouds, units=units)
    with np.load(path) as stored:
        return stored["clouds"], stored["units"]


def seen_cloud(
    example: Example, rng: np.random.Generator, *, table_known: bool = True, viewpoint_known: bool = True
) -> np.ndarray:
    """(POOL_POINTS, 9) cloud of an example in its seen frame, as the network is asked about it."""
    points, eye = above_table(example), example.viewpoint if viewpoint_known else None
    T_seen_world = invert_T(seen_frame(points, UP, TABLE if table_known else None, eye, floor_m=example.sensor.floor_m))
    local = sample_points(apply_T(T_seen_world, points), POOL_POINTS, rng)
    return with_surface(local, None if eye is None else apply_T(T_seen_world, eye))


def _is_usable(example: Example) -> bool:
    return int((example.points[:, 2] > example.sensor.floor_m).sum()) >= 30


def augmented_batches(targets: Targets, config: ProposalConfig):
    """Endless batches: turned a little or at will, mirrored, stretched, noisier, cropped, thinner, the table unknown.

    A batch is features, classes, kinds, rests, front (b, turns, 3) with NaN where it says nothing, and (b, 3, 3) up,
    logarithms of extents and centre.
    """
    own, total = targets.num_views, len(targets.pool)
    num_own = round(config.share * config.batch)

    def stream(generator: torch.Generator):
        rng = np.random.default_rng(int(torch.randint(2**31, (1,), generator=generator)))
        while True:
            order = rng.permutation(own)
            for start in range(0, max(own - num_own, 0) + 1, num_own):
                others = rng.integers(own, total, config.batch - num_own)
                index = np.concatenate([order[start : start + num_own], others])
                samples = [_augmented(targets, k, rng, config) for k in index]
                clouds, fronts, poses = (np.stack(column) for column in zip(*samples, strict=True))
                yield (
                    torch.from_numpy(features(clouds)),
                    torch.from_numpy(targets.classes[index]),
                    torch.from_numpy(targets.kind[index]),
                    torch.from_numpy(targets.rests[index]),
                    torch.from_numpy(fronts.astype(np.float32)),
                    torch.from_numpy(poses.astype(np.float32)),
                )

    return stream


def _augmented(
    targets: Targets, k: int, rng: np.random.Generator, config: ProposalConfig
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A cloud (n, 9), the fronts (6, 3) that count as right, and up, logarithms of extents, and centre (3, 3)."""
    unit, cloud = targets.unit_m[k], targets.pool[k].astype(np.float64)
    centre, extents = targets.box[k] / unit
    stretch = rng.uniform(0.93, 1.07)
    points, surface = cloud[:, :3], cloud[:, 3:]
    if rng.random() < 0.1:  # a part is hidden
        along = points @ rng.normal(size=3)
        seen = along > np.quantile(along, rng.uniform(0.0, 0.4))
        points, surface = points[seen], surface[seen]
    kept = rng.permutation(len(points))[: _TRAIN_POINTS if rng.random() < 0.7 else int(rng.integers(80, _TRAIN_POINTS))]
    points = points[kept] + rng.normal(scale=rng.uniform(0, 0.012), size=(len(kept), 3))
    blind = rng.random() < config.unknown_viewpoint
    turn = rotation_about((0, 0, 1), rng.uniform(0, 2 * np.pi) if blind else rng.normal(scale=0.08))
    move = turn @ np.diag([1.0, rng.choice([-1.0, 1.0]), 1.0])
    thinned = turned_cloud(np.column_stack([points, surface[kept]]), move)
    if blind:
        thinned[:, 6:] = 0.0
    # As the seen frame is made of these points, with the table a little off, or not known.
    low, high = np.percentile(thinned[:, :3], (1, 99), axis=0)
    height = low[2] - targets.floor_m / unit if rng.random() < config.unknown_table else rng.normal(scale=0.016)
    origin = np.append((low[:2] + high[:2]) / 2 + rng.normal(scale=0.03, size=2), height)
    thinned[:, :3] -= origin
    size = float(size_of(thinned[:, :3]))
    R = move @ targets.R[k]
    pose = np.stack([R[:, 2], np.log(np.maximum(extents / size, 1e-3)), (move @ centre - origin) / size])
    thinned[:, :3] *= stretch * unit
    return sample_points(thinned, _TRAIN_POINTS, rng), _fronts(R, int(targets.order[k])), pose


def _fronts(R: np.ndarray, order: int) -> np.ndarray:
    """(6, 3): the object's x axis and those that its symmetry makes equal to it; NaN for a body of revolution."""
    fronts = np.full((_MOST_TURNS, 3), np.nan)
    found = equal_fronts(R, order)[:_MOST_TURNS]
    fronts[: len(found)] = found
    return fronts


def equal_fronts(R: np.ndarray, order: int) -> np.ndarray:
    """(order, 3): the x axis of R (3, 3), and those that a symmetry about its z axis makes equal to it."""
    turns = [rotation_about((0, 0, 1), 2 * np.pi * i / order) for i in range(order)]
    return np.array([R @ turn[:, 0] for turn in turns]).reshape(-1, 3)
