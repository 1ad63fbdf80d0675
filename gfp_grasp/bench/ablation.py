"""The paper's ablation: `gfp-grasp bench ablation`.

Encoders of two to five layers, at the paper's widths, at half and at a quarter of them, are trained alike, and each is
asked with one to seven iterations; the paper's augmenting noise of 0.01 m and other readings of its loss are rows of
their own. A row says what its network came to at a third and at two thirds of its steps, too: where these differ
little, more steps would not change much. The decoder is the paper's in every row.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

from gfp_grasp.bench.paper_nets import (
    PAPER,
    Architecture,
    Budget,
    PatchSets,
    chamfers,
    joined,
    num_parameters,
    read_patches,
    train_paper_net,
)
from gfp_grasp.errors import InvalidOption
from gfp_grasp.journal import write_whole
from gfp_grasp.train import Reading

WIDTHS = ((64, 1024), (64, 128, 1024), (64, 128, 512, 1024), (64, 128, 256, 512, 1024))  # the middle two: the paper's
DIVISORS = (4, 2, 1)
ITERATIONS = tuple(range(1, 8))
_SPANS = 3


@dataclass(frozen=True)
class AblationConfig(Budget):
    """Budget of each of fifteen networks, and the noise of one; as it is, an hour and a half of one core.

    Attributes:
        steps: Number of optimiser steps.
        batch: Number of patches a step.
        limit: Number of shapes of a class that patches come from.
        views: Number of views of each shape.
        seed: Seed of every network and of the order of its batches.
        noise_m: Standard deviation of the noise in the noisy row, m.
    """

    steps: int = 2400
    noise_m: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.noise_m <= 0:
            raise InvalidOption(f"noise_m is {self.noise_m}; a positive number is expected")


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
        {"settings", "rows": {name: {"widths", "noise_m", "reading", "parameters", "cd_units": [of each of ITERATIONS],
        "thirds": [after each third of the steps, of the paper's iterations], "hours"}}}, the Chamfer distance of
        predicted sets to their labels in units of the patch, on patches of the validation split.
    """
    folder = config.folder(runs, "ablation")
    patches = cache(lambda: read_patches(config, runs=runs, workers=workers))
    rows = {}
    for name, kind in _plan(config.noise_m).items():
        path = folder / f"{name.replace(', ', '_').replace(' ', '_')}.json"
        row = _begun(path)
        if "hours" not in row:
            if report is not None:
                report(name)
            row = _row(kind, row["thirds"], patches(), config, path)
        rows[name] = row
    return {"settings": {**asdict(config), "iterations": list(ITERATIONS)}, "rows": rows}


@dataclass(frozen=True)
class _Kind:
    """What a row is of: widths, noise on T in metres, and how the loss is read."""

    widths: tuple[int, ...]
    noise_m: float = 0.0
    reading: Reading = "as taken"


def _plan(noise_m: float) -> dict[str, _Kind]:
    """Every row by name: from the smallest network to the largest, and then what else may be done with the paper's."""
    scaled = [tuple(width // divisor for width in widths) for divisor in DIVISORS for widths in WIDTHS]
    own = joined(PAPER.widths)
    return {
        **{joined(widths): _Kind(widths) for widths in scaled},
        f"{own}, {noise_m:g} m noise": _Kind(PAPER.widths, noise_m=noise_m),
        f"{own}, CD to T": _Kind(PAPER.widths, reading="CD to T"),
        f"{own}, eq. 3 as printed": _Kind(PAPER.widths, reading="eq. 3 as printed"),
    }


def _begun(path: Path) -> dict[str, Any]:
    """A row as far as it came."""
    return json.loads(path.read_text()) if path.is_file() else {"thirds": []}


def _row(kind: _Kind, thirds: list[float], patches: PatchSets, config: AblationConfig, path: Path) -> dict[str, Any]:
    """Train and measure one row from the third of its steps where an earlier run left it."""
    network = Architecture(kind.widths, max(ITERATIONS)).make(config.seed)
    checkpoint = path.with_suffix(".pt")
    row: dict[str, Any] = {"thirds": thirds}
    for span in range(len(thirds) + 1, _SPANS + 1):
        until = config.steps * span // _SPANS
        trained, hours = train_paper_net(
            network,
            patches.training,
            config,
            checkpoint=checkpoint,
            noise_m=kind.noise_m,
            reading=kind.reading,
            until=until,
        )
        cd_units = chamfers(trained, patches.held_out, max(ITERATIONS) if span == _SPANS else PAPER.iterations)
        row["thirds"] = [*row["thirds"], cd_units[PAPER.iterations - 1]]
        if span == _SPANS:
            parameters = num_parameters(trained)
            row |= {**asdict(kind), "parameters": parameters, "cd_units": cd_units}
            row["hours"] = round(hours, 4)
        write_whole(path, json.dumps(row))
    checkpoint.unlink()
    return _begun(path)
