"""The paper's ablation at a short budget: `gfp-grasp bench ablation`.

Encoders of two to five layers are trained alike, for so few steps that none converges, and each is asked with one to
seven iterations; the paper's augmenting noise of 0.01 m is a row of its own. What it shows is which way each choice
pulls, not how good any of them gets.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from gfp_grasp.deform import PaperNet
from gfp_grasp.errors import InvalidOption
from gfp_grasp.train import Batch, LoopConfig, paper_loss, patches_of_split, shuffled, train

WIDTHS = {2: (64, 1024), 3: (64, 128, 1024), 4: (64, 128, 512, 1024), 5: (64, 128, 256, 512, 1024)}
ITERATIONS = tuple(range(1, 8))
_NOISY_LAYERS = 3  # the paper's iterative network
_MEASURED = 2048  # patches of the validation split


@dataclass(frozen=True)
class AblationConfig:
    """Budget of each network.

    Attributes:
        steps: Number of optimiser steps.
        batch: Number of patches a step.
        limit: Number of shapes of a family that patches come from.
        views: Number of views of each shape.
        noise_m: Standard deviation of the noise in the noisy row, m.
        seed: Seed of every network and of the order of its batches.
    """

    steps: int = 200
    batch: int = 64
    limit: int = 60
    views: int = 3
    noise_m: float = 0.01
    seed: int = 0

    def __post_init__(self) -> None:
        if min(self.steps, self.batch, self.limit, self.views) < 1 or self.noise_m <= 0:
            raise InvalidOption(f"{self}: positive numbers are expected")


def bench_ablation(
    *,
    config: AblationConfig = AblationConfig(),
    runs: Path = Path("runs"),
    workers: int = 1,
    report: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Train and measure every row; rows that were finished by an earlier run are read back.

    Args:
        config: Budget of each network.
        runs: Folder of caches and finished rows.
        workers: Number of processes that make labels.
        report: Called with the name of each row before it is made.

    Returns:
        {"settings", "rows": {name: {"cd_mm": [of each of ITERATIONS], "hours"}}}, the Chamfer distance of predicted
        sets to their labels, on patches of the validation split.
    """
    folder = runs / "ablation" / "_".join(f"{v}" for v in asdict(config).values())
    training = held_out = None
    rows = {}
    for name, layers, noise_m in [
        *((f"{layers} layers", layers, 0.0) for layers in WIDTHS),
        (f"{_NOISY_LAYERS} layers, {config.noise_m:g} m noise", _NOISY_LAYERS, config.noise_m),
    ]:
        path = folder / f"{name.replace(' ', '_').replace(',', '')}.json"
        if not path.is_file():
            if report is not None:
                report(name)
            if training is None or held_out is None:
                training = patches_of_split("train", config.views, config.limit, runs, workers)
                held_out = patches_of_split("val", config.views, config.limit, runs, workers)
            row = _row(layers, noise_m, training, held_out, config, path.with_suffix(".pt"))
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(row))
        rows[name] = json.loads(path.read_text())
    return {"settings": {**asdict(config), "iterations": list(ITERATIONS)}, "rows": rows}


def _row(
    layers: int, noise_m: float, training: Batch, held_out: Batch, config: AblationConfig, checkpoint: Path
) -> dict[str, Any]:
    torch.manual_seed(config.seed)
    loop = LoopConfig(steps=config.steps, batch=config.batch, rate=1e-3, seed=config.seed)
    network, hours = train(
        PaperNet(WIDTHS[layers]),
        _noisy(shuffled(training, config.batch), noise_m),
        paper_loss,
        config=replace(loop, checkpoint_s=30.0),
        checkpoint=checkpoint,
    )
    picked = torch.randperm(len(held_out[0]), generator=torch.Generator().manual_seed(0))[:_MEASURED]
    source, template, target, unit_m = (part[picked].float() for part in held_out)
    return {
        "cd_mm": [round(_chamfer_mm(network, source, template, target, unit_m, m), 4) for m in ITERATIONS],
        "hours": round(hours, 4),
    }


def _noisy(stream, noise_m: float):
    def batches(generator: torch.Generator):
        for source, template, target, unit_m in stream(generator):
            noise = torch.randn(template.shape, generator=generator) * (noise_m / unit_m)[:, None, None]
            yield source, template.float() + noise, target, unit_m

    return batches


def _chamfer_mm(
    network: nn.Module, source: Tensor, template: Tensor, target: Tensor, unit_m: Tensor, iterations: int
) -> float:
    with torch.inference_mode():
        moved = torch.cat(
            [network(s, t, iterations=iterations) for s, t in zip(source.split(256), template.split(256), strict=True)]
        )
        pairwise = torch.cdist(moved, target)
    chamfer = pairwise.amin(dim=2).mean(dim=1) + pairwise.amin(dim=1).mean(dim=1)
    return float((chamfer * unit_m).mean()) * 1000
