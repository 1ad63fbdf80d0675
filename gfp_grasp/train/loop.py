"""One training loop for every network: seeded, resumable, and leaving weights with a card."""

from __future__ import annotations

import hashlib
import json
import math
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from safetensors.torch import save
from torch import Tensor, nn

from gfp_grasp.assets import data_dir
from gfp_grasp.errors import InvalidOption, TrainingDiverged
from gfp_grasp.journal import check_place, write_file, write_whole

Batch = tuple[Tensor, ...]
Network = TypeVar("Network", bound=nn.Module)


@dataclass(frozen=True)
class LoopConfig:
    """How a network is trained.

    Attributes:
        steps: Optimiser steps.
        batch: Samples a step.
        rate: Adam's learning rate at the start.
        decay: Factor on the rate after each of ten equal spans of the schedule (the paper's 0.92).
        weight_decay: Decoupled decay of the weights a step (AdamW); 0 is the paper's Adam.
        seed: Seed of the initial weights and of the order of the samples.
        bf16: Multiply in bfloat16 (autocast); weights and losses stay float32.
        checkpoint_s: Seconds between checkpoints.
        device: "cpu" or "cuda".
    """

    steps: int
    batch: int
    rate: float = 1e-4
    decay: float = 0.92
    weight_decay: float = 0.0
    seed: int = 0
    bf16: bool = True
    checkpoint_s: float = 60.0
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.steps < 1 or self.batch < 1 or self.rate <= 0 or not 0 < self.decay <= 1:
            raise InvalidOption("steps and batch must be at least 1, rate positive, decay in (0, 1]")


def train(
    network: Network,
    batches: Callable[[torch.Generator], Iterator[Batch]],
    loss: Callable[[Network, Batch], Tensor],
    *,
    config: LoopConfig,
    checkpoint: Path,
    until: int | None = None,
    report: Callable[[int, float], None] | None = None,
) -> tuple[Network, float]:
    """Optimise a network with Adam (AdamW where weights decay); resumes from the checkpoint where there is one.

    Args:
        network: Freshly made after `torch.manual_seed(config.seed)`.
        batches: Endless stream of batches for a generator.
        loss: Scalar loss of one batch.
        config: Schedule.
        checkpoint: File that holds the state between runs.
        until: Step after which to stop for now, its state in the checkpoint; None is the end of the schedule.
        report: Told the step and the mean loss since the last report, about every hundredth of the schedule.

    Returns:
        The trained network in evaluation mode, and the hours of a processor core that all runs took.

    Raises:
        TrainingDiverged: A loss or its gradient is not finite; the checkpoint keeps the weights from before.
    """
    network.to(config.device).train()
    optimiser = torch.optim.AdamW(network.parameters(), lr=config.rate, weight_decay=config.weight_decay)
    span, last = max(1, config.steps // 10), config.steps if until is None else min(until, config.steps)
    schedule = torch.optim.lr_scheduler.StepLR(optimiser, span, config.decay)
    done, seconds = 0, 0.0
    if checkpoint.is_file():
        state = torch.load(checkpoint, map_location=config.device, weights_only=True)
        network.load_state_dict(state["network"])
        optimiser.load_state_dict(state["optimiser"])
        schedule.load_state_dict(state["schedule"])
        done, seconds = int(state["done"]), float(state["seconds"])
    # The stream is a function of seed and step, so a resumed run does not see the first batches again.
    stream = batches(torch.Generator().manual_seed(config.seed * 1_000_003 + done))
    saved, start = time.monotonic(), time.process_time()
    summed, count = 0.0, 0
    for step in range(done, last):
        batch = tuple(_ready(part, config.device) for part in next(stream))
        with torch.autocast(config.device, dtype=torch.bfloat16, enabled=config.bf16):
            value = loss(network, batch)
        optimiser.zero_grad(set_to_none=True)
        value.backward()
        length, own = float(nn.utils.clip_grad_norm_(network.parameters(), 1.0)), float(value.detach())
        if not math.isfinite(own + length):
            raise TrainingDiverged(
                f"at step {step + 1} the loss is {own:g} and its gradient {length:g} long; finite numbers are "
                f"expected: a rate lower than {config.rate:g} helps"
            )
        optimiser.step()
        schedule.step()
        summed, count = summed + own, count + 1
        if report is not None and (step + 1) % max(1, config.steps // 100) == 0:
            report(step + 1, summed / count)
            summed, count = 0.0, 0
        now = time.monotonic()
        if now - saved > config.checkpoint_s or step + 1 == last:
            saved = now
            _save_checkpoint(checkpoint, network, optimiser, schedule, step + 1, seconds + time.process_time() - start)
    return network.cpu().eval(), (seconds + time.process_time() - start) / 3600


def weights_place(out: Path | None, stem: str, *, runs: Path) -> Path:
    """The file that a training is to write, once it is known that it can be written; this is asked before any work.

    Args:
        out: The weights file; None is the shipped one.
        stem: Name of the shipped one, without its suffix.
        runs: Folder of caches and checkpoints.

    Raises:
        CannotWrite: The weights, their card or the folder cannot be written.
    """
    path = out or data_dir("weights") / f"{stem}.safetensors"
    for place in (path, path.with_suffix(".json"), runs / f"{stem}.pt"):
        check_place(place)
    return path


def write_weights(
    network: nn.Module,
    path: Path,
    *,
    config: object,
    data: Mapping[str, object],
    hours: float,
    metrics: Mapping,
    extra: Mapping[str, object] | None = None,
    beside: Mapping[str, np.ndarray] | None = None,
) -> Path:
    """Write weights (float16 safetensors) and their card (JSON beside them).

    Args:
        network: Trained.
        path: Path of the .safetensors file.
        config: Dataclass with the seed and schedule.
        data: What it was trained on.
        hours: Hours of a processor core that the training took.
        metrics: Measured on data it was not trained on, with the float16 weights.
        extra: More of the card.
        beside: Arrays that the file holds beside the network's, by names of their own.

    Raises:
        CannotWrite: There is no room, no right, or no such place.
    """
    tensors = {**network.state_dict(), **{name: torch.from_numpy(array) for name, array in (beside or {}).items()}}
    content = save({name: tensor.half().contiguous() for name, tensor in tensors.items()})
    write_file(path, lambda file: file.write(content))
    path.chmod(0o644)  # whatever the umask: a wheel keeps the mode
    card = {
        "command": command_line(),
        "config": asdict(config),  # type: ignore[call-overload]
        "data": dict(data),
        "hours": round(hours, 3),
        "torch": torch.__version__.split("+")[0],
        "metrics": dict(metrics),
        **(extra or {}),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }
    card_path = path.with_suffix(".json")
    write_whole(card_path, json.dumps(card, indent=1) + "\n")
    return card_path


def training_key(*content: object) -> str:
    """Ten hexadecimal digits for what a training is made from, so that a checkpoint is that of no other training."""
    return hashlib.sha256(repr(content).encode()).hexdigest()[:10]


def mean_mm(distance_m: Tensor) -> float:
    """Mean of distances, in millimetres as a card says them."""
    return round(float(distance_m.mean()) * 1000, 3)


def shuffled(parts: Batch, batch: int) -> Callable[[torch.Generator], Iterator[Batch]]:
    """Endless batches of samples drawn without replacement, pass after pass, from tensors of equal length."""

    def stream(generator: torch.Generator) -> Iterator[Batch]:
        count = len(parts[0])
        while True:
            order = torch.randperm(count, generator=generator)
            for start in range(0, max(count - batch, 0) + 1, batch):
                index = order[start : start + batch]
                yield tuple(part[index] for part in parts)

    return stream


def _ready(part: Tensor, device: str) -> Tensor:
    """On the device, and in single precision where it was stored in less."""
    return part.to(device, torch.float32 if part.is_floating_point() else None)


def command_line() -> str:
    """The command line that is running, as a user would type it."""
    main = sys.modules["__main__"]
    if main.__spec__ is not None and main.__spec__.name:
        return " ".join(["python -m", main.__spec__.name.removesuffix(".__main__"), *sys.argv[1:]])
    return " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])


def _save_checkpoint(path: Path, network, optimiser, schedule, done: int, seconds: float) -> None:
    state = {
        "network": network.state_dict(),
        "optimiser": optimiser.state_dict(),
        "schedule": schedule.state_dict(),
        "done": done,
        "seconds": seconds,
    }
    write_file(path, lambda file: torch.save(state, file))
