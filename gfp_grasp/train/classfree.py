"""Trains the network of the class-free completion: signed distances on grids, and how sure they are.

`gfp-grasp train classfree` renders, trains and measures.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from gfp_grasp.classfree import REACH, DistanceNet, complete_classfree
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.parallel import Progress
from gfp_grasp.shapes import get_family
from gfp_grasp.train.classfree_data import SeenThing, cached_samples, draw_things, read_sample, seen_things
from gfp_grasp.train.classfree_measure import measure_against_hull, position_errors_m, summarise_against_hull
from gfp_grasp.train.loop import Batch, LoopConfig, train, training_key, weights_place, write_weights

_NEAR = 2.0  # cells from the surface within which errors count most
_FAR_WEIGHT = 0.1
_SCALE_WEIGHT = 0.2
_STEPS = 127.0  # of what is cached
_WITHIN_TWO_SIGMA = 0.95


@dataclass(frozen=True)
class ClassfreeConfig(LoopConfig):
    """Schedule and data of the network of the class-free completion.

    Attributes:
        width: Width of the network.
        depth: Pairs of convolutions at its coarsest level.
        members: Members of each family.
        mixtures: Things of each kind of mixture.
        views: Views of each thing.
    """

    steps: int = 10_000
    batch: int = 4
    rate: float = 2e-3
    decay: float = 0.65
    weight_decay: float = 1e-4
    width: int = 32
    depth: int = 3
    members: int = 90
    mixtures: int = 400
    views: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if min(self.width, self.depth, self.members, self.mixtures, self.views) < 1 or self.width % 8:
            raise InvalidOption("depth, members, mixtures and views must be at least 1, width a multiple of 8")


def train_classfree(
    *,
    config: ClassfreeConfig = ClassfreeConfig(),
    without: Sequence[str] = (),
    out: Path | None = None,
    runs: Path = Path("runs"),
    workers: int = 1,
    report: Callable[[int, float], None] | None = None,
    progress: Progress | None = None,
) -> Path:
    """Train, calibrate on val, measure on test and write weights and card.

    Args:
        config: Schedule and data.
        without: Families that are left out of what is learnt; they are measured like the others.
        out: Weights file; None is the shipped one.
        runs: Folder of samples and checkpoints; a later call goes on from there.
        workers: Processes that render.
        report: Told the step and the loss.
        progress: Wraps the stream of things that are looked at.

    Returns:
        Path of the card.

    Raises:
        UnknownCategory: A family to leave out that there is not.
        CannotWrite: `out` or `runs`.
    """
    for name in without:
        get_family(name)
    out = weights_place(out, "classfree", runs=runs)
    folder = runs / "classfree"
    draw = partial(draw_things, without=without)
    things = draw("train", members=config.members, mixtures=config.mixtures)
    samples = cached_samples(things, config.views, folder / "samples", workers=workers, progress=progress)
    torch.manual_seed(config.seed)
    network, hours = train(
        DistanceNet(config.width, config.depth),
        field_batches(samples, config),
        field_loss,
        config=config,
        checkpoint=folder / f"{training_key(config, sorted(without))}.pt",
        report=report,
    )
    assert isinstance(network, DistanceNet)
    val = draw("val", members=max(1, config.members // 30), mixtures=max(1, config.mixtures // 40))
    calibrate_scales(network, [seen for thing in val for seen in seen_things(thing, 1)])
    network = network.half().float()  # measured as it will be loaded
    few, many = max(1, config.members // 18), max(1, config.mixtures // 20)
    rows = measure_against_hull(partial(complete_classfree, network=network), draw_things("test", few, many))
    left_out = {"left_out": summarise_against_hull([row for row in rows if row.kind in without])} if without else {}
    return write_weights(
        network,
        out,
        config=config,
        data={
            "without": list(without),
            "split": "train",
            "things": len(things),
            "samples": len(samples),
        },
        hours=hours,
        metrics={"test": summarise_against_hull(rows), **left_out},
    )


def calibrate_scales(network: DistanceNet, views: Sequence[SeenThing]) -> None:
    """Make the network's scales so large that 95 % of the vertices of completions are within two sigma of the truth."""
    ratios = []
    for seen in views:
        try:
            shape = complete_classfree(seen.detection, network=network)
        except GfpGraspError:
            continue
        ratios.append(position_errors_m(shape, seen.mesh, seen.thing.rng(1)) / (2 * shape.sigma_m))
    if ratios:
        network.add_to_log_scale(float(np.log(np.quantile(np.concatenate(ratios), _WITHIN_TWO_SIGMA))))


def field_batches(samples: Sequence[tuple[Path, int]], config: ClassfreeConfig):
    """Endless batches of samples, each of which is a pair of known (c, x, y, z) and distance (x, y, z), both int8.

    Half of them are mirrored at the plane of the line of sight.
    """

    def stream(generator: torch.Generator) -> Iterator[Batch]:
        rng = np.random.default_rng(int(torch.randint(2**31, (1,), generator=generator)))
        while True:
            order = rng.permutation(len(samples))
            for start in range(0, max(len(order) - config.batch, 0) + 1, config.batch):
                batch: list[Tensor] = []
                for index in order[start : start + config.batch]:
                    sample = read_sample(*samples[index])
                    step = rng.choice([-1, 1])
                    batch.append(torch.from_numpy(np.ascontiguousarray(sample.known[:, :, ::step])))
                    batch.append(torch.from_numpy(np.ascontiguousarray(sample.distance[:, ::step])))
                yield tuple(batch)

    return stream


def field_loss(network: nn.Module, batch: Batch) -> Tensor:
    """Mean error of the distances, in cells, that near the surface counts most, and what the scales miss of it."""
    total = batch[0].new_zeros((), dtype=torch.float32)
    for known, steps in zip(batch[::2], batch[1::2], strict=True):
        distance, log_scale = network(known[None].float() / _STEPS)
        truth = steps[None].float() * (REACH / _STEPS)
        error = (distance.float() - truth).abs()
        weight = torch.exp(-truth.abs() / _NEAR) + _FAR_WEIGHT
        scale = error.detach() * torch.exp(-log_scale.float()) + log_scale.float()
        total = total + ((error + _SCALE_WEIGHT * scale) * weight).sum() / weight.sum()
    return total * 2 / len(batch)
