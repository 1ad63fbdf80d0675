"""The paper's networks at a small budget: trained alike, their sets against the labels, and the time of a call."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch
from torch import nn

from gfp_grasp.deform import NUM_PATCHES, NUM_SOURCE, NUM_TEMPLATE, PaperNet
from gfp_grasp.errors import InvalidOption
from gfp_grasp.parallel import one_thread
from gfp_grasp.train import Batch, LoopConfig, Reading, chamfer_of_sets, looped_loss, paper_patches, shuffled, train

_MEASURED = 2048  # patches of the validation split
_CHUNK = 16  # patches whose layers fit into the cache: of 256 at once, a fourth of the time went to the system
_CALLS = 30


@dataclass(frozen=True)
class Architecture:
    """What a network of the paper's kind is made of; the defaults are the paper's own.

    Attributes:
        widths: Widths of the encoders' layers.
        iterations: How often the answer is looped back.
        hidden: Widths of the decoder's layers between the codes and the set.
    """

    widths: tuple[int, ...] = (64, 128, 1024)
    iterations: int = 5
    hidden: tuple[int, ...] = (1024, 512, 256)

    def make(self, seed: int) -> PaperNet:
        """A fresh network, the same for the same seed."""
        torch.manual_seed(seed)
        return PaperNet(self.widths, iterations=self.iterations, hidden=self.hidden)


PAPER = Architecture()


def joined(widths: tuple[int, ...]) -> str:
    """Widths as the paper writes them: 64-128-1024."""
    return "-".join(map(str, widths))


@dataclass(frozen=True)
class Budget:
    """What each network may learn from.

    Attributes:
        steps: Number of optimiser steps.
        batch: Number of patches a step.
        limit: Number of shapes of a class that patches come from.
        views: Number of views of each shape.
        seed: Seed of every network and of the order of its batches.
    """

    steps: int = 400
    batch: int = 64
    limit: int = 80
    views: int = 4
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.steps, self.batch, self.limit, self.views) < 1 or self.seed < 0:
            raise InvalidOption(f"{self}: positive numbers are expected")

    def folder(self, runs: Path, bench: str) -> Path:
        """Folder of what a bench made at this budget: rows of another budget are never read back."""
        return runs / bench / "_".join(str(getattr(self, each.name)) for each in fields(Budget))


class PatchSets(NamedTuple):
    """Patches as `paper_loss` takes them: S, T, label and unit.

    Attributes:
        training: Those of the train split.
        held_out: At most `_MEASURED` of the val split, the same ones whatever the seed.
    """

    training: Batch
    held_out: Batch


def read_patches(budget: Budget, *, runs: Path, workers: int) -> PatchSets:
    """Patches of both splits, their labels made where no earlier run made them."""
    members = {"train": budget.limit, "val": max(1, budget.limit // 8)}
    training, held_out = (
        paper_patches(split, members=count, num_views=budget.views, runs=runs, workers=workers)[0]
        for split, count in members.items()
    )
    picked = torch.randperm(len(held_out[0]), generator=torch.Generator().manual_seed(0))[:_MEASURED]
    return PatchSets(training, tuple(part[picked].float() for part in held_out))


def train_paper_net(
    network: PaperNet,
    training: Batch,
    budget: Budget,
    *,
    checkpoint: Path,
    noise_m: float = 0.0,
    reading: Reading = "as taken",
    until: int | None = None,
) -> tuple[PaperNet, float]:
    """Train one network, for each number of its iterations at once.

    Args:
        network: Freshly made.
        training: Patches.
        budget: Steps, batch and seed; the rate is ten times the paper's, as steps are few.
        checkpoint: File that holds the state between runs.
        noise_m: Standard deviation of noise on T, m.
        reading: How the loss is read, as `paper_loss` takes it.
        until: Step after which to stop for now; None is the whole budget.

    Returns:
        The network in evaluation mode, and the hours that it took.
    """
    return train(
        network,
        _noisy(shuffled(training, budget.batch), noise_m),
        partial(looped_loss, reading=reading),
        config=LoopConfig(steps=budget.steps, batch=budget.batch, rate=1e-3, seed=budget.seed, checkpoint_s=30.0),
        checkpoint=checkpoint,
        until=until,
    )


def _noisy(stream, noise_m: float):
    def batches(generator: torch.Generator):
        for source, template, target, unit_m in stream(generator):
            noise = torch.randn(template.shape, generator=generator) * (noise_m / unit_m)[:, None, None]
            yield source, template.float() + noise, target, unit_m

    return batches


def chamfers(network: nn.Module, patches: Batch, iterations: int) -> list[float]:
    """Chamfer distance of predicted sets to their labels after one, two and so on up to some number of iterations.

    It is the mean over patches of the sum of both ways, in units of the patch (`patch_unit_m`): a patch of a cup weighs
    as much as one of a car. A set that is looped back by hand is the one that the network loops back itself.
    """
    source, template, target, _ = patches
    found = []
    with torch.inference_mode():
        for _ in range(iterations):
            pairs = zip(source.split(_CHUNK), template.split(_CHUNK), strict=True)
            source = torch.cat([network(s, t, iterations=1) for s, t in pairs])
            found.append(round(float(chamfer_of_sets(source, target).mean()), 5))
    return found


def call_ms(network: nn.Module) -> float:
    """Median time of one answer for all patches of a primitive, in one thread, ms."""
    generator = torch.Generator().manual_seed(0)
    source, template = (torch.randn(NUM_PATCHES, n, 3, generator=generator) for n in (NUM_SOURCE, NUM_TEMPLATE))
    laps = []
    with one_thread(), torch.inference_mode():
        for _ in range(_CALLS):
            start = time.perf_counter()
            network(source, template)
            laps.append(time.perf_counter() - start)
    return round(1000 * sorted(laps)[_CALLS // 2], 4)


def num_parameters(network: nn.Module) -> int:
    """Count of a network's weights and biases."""
    return sum(parameter.numel() for parameter in network.parameters())
