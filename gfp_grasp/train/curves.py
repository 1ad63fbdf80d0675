"""Learning curves, which the cards of weights keep and `gfp-grasp train curves` draws."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import torch
from torch import Tensor, nn

from gfp_grasp.errors import UnreadableFile
from gfp_grasp.journal import read_figures, write_whole
from gfp_grasp.train.loop import Batch

_CURVE = "learning_curve"  # what the keys of a card begin with that are curves


@dataclass(eq=False)
class LearningCurve:
    """A learning curve that outlives a run that is stopped: the report of a training.

    Attributes:
        network: What learns.
        loss: Scalar loss of one batch.
        held_out: A batch of the validation split.
        bf16: Multiply in bfloat16, as the training does.
        path: File of the points; one that cannot be read is begun anew.
        then: Told the step and the loss, too.
        points: Steps, mean loss since the point before, and loss of the validation batch.
    """

    network: nn.Module
    loss: Callable[[nn.Module, Batch], Tensor]
    held_out: Batch
    bf16: bool
    path: Path
    then: Callable[[int, float], None] | None = None
    points: list[tuple[int, float, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.path.is_file():
            with suppress(TypeError, ValueError):  # cut off by a run that was killed, or something else
                self.points = [(int(step), own, val) for step, own, val in json.loads(self.path.read_bytes())]

    def __call__(self, step: int, loss: float) -> None:
        """Add a point; those of steps that a resumed run does again are dropped."""
        device = next(self.network.parameters()).device
        held_out = tuple(part.to(device, torch.float32) if part.is_floating_point() else part for part in self.held_out)
        self.network.eval()
        with torch.no_grad(), torch.autocast(device.type, dtype=torch.bfloat16, enabled=self.bf16):
            val = float(self.loss(self.network, held_out))
        self.network.train()
        self.points = [point for point in self.points if point[0] < step] + [(step, _short(loss), _short(val))]
        write_whole(self.path, json.dumps(self.points))
        if self.then is not None:
            self.then(step, loss)


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def some_of(batch: Batch, count: int) -> Batch:
    """At most so many samples of a batch, evenly spread over it."""
    index = torch.linspace(0, len(batch[0]) - 1, count).long().unique()
    return tuple(part[index] for part in batch)


def curves_of_cards(folder: Path) -> dict[str, list[tuple[int, float, float]]]:
    """The learning curves that the cards of a folder's weights keep, by file and part of the training.

    Raises:
        UnreadableFile: No card in the folder has one, or one of them is no card.
    """
    found = {}
    for path in sorted(folder.glob("*.json")):
        card = read_figures(path)
        for key in [key for key in card if key.startswith(_CURVE) and card[key]]:
            part = key.removeprefix(_CURVE).replace("_", " ")
            found[path.stem + part] = [(int(step), loss, val) for step, loss, val in card[key]]
    if not found:
        raise UnreadableFile(
            f"no card in {folder} has a learning curve: were its weights trained before cards had one?"
        )
    return found
