"""Evolutionary search for networks of the paper's kind that are quicker or nearer: `gfp-grasp bench search`.

NSGA-II (Deb, Pratap, Agarwal and Meyarivan 2002, doi:10.1109/4235.996017), as optuna has it, varies layers and widths
of the encoders, iterations, and the width of the decoder. Each network is trained alike and for few steps: what the
search says holds for that budget. It begins with the paper's own network, which so is measured as all others are.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from typing import Any

from gfp_grasp.bench.paper_nets import (
    PAPER,
    Architecture,
    Budget,
    PatchSets,
    call_ms,
    chamfers,
    joined,
    num_parameters,
    read_patches,
    train_paper_net,
)
from gfp_grasp.errors import InvalidOption
from gfp_grasp.journal import Journal

# Genes and their values. All of them are always there, so that any two networks can be crossed: of the inner widths a
# network has as many as it has layers but for the first and the last.
GENES: Mapping[str, tuple[int, ...]] = {
    "layers": (2, 3, 4, 5),
    "first": (16, 32, 64, 128),
    "inner_1": (32, 64, 128, 256, 512),
    "inner_2": (32, 64, 128, 256, 512),
    "inner_3": (32, 64, 128, 256, 512),
    "code": (64, 128, 256, 512, 1024),
    "iterations": (1, 2, 3, 4, 5, 6, 7),
    "hidden": (128, 256, 512, 1024),
}
_PAPER_GENES = {
    "layers": 3,
    "first": 64,
    "inner_1": 128,
    "inner_2": 256,
    "inner_3": 512,
    "code": 1024,
    "iterations": 5,
    "hidden": 1024,
}
_ASKED_A_TRIAL = 20  # networks that were measured before come up again, the more often the longer a search is


@dataclass(frozen=True)
class SearchConfig(Budget):
    """Budget of each network, and how many there are; as it is, some forty minutes of one quiet core.

    Attributes:
        steps: Number of optimiser steps.
        batch: Number of patches a step.
        limit: Number of shapes of a class that patches come from.
        views: Number of views of each shape.
        seed: Seed of the search, of every network and of the order of its batches.
        trials: Number of networks, no two of them alike; fewer are measured where the search finds no more.
        population: Number of networks of a generation.
    """

    trials: int = 40
    population: int = 8

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.trials < 1 or self.population < 2:
            raise InvalidOption(f"{self}: at least one trial, and two networks of a generation, are expected")


def bench_search(
    *,
    config: SearchConfig = SearchConfig(),
    runs: Path = Path("runs"),
    workers: int = 1,
    report: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Search, and say which networks no other one is both quicker and nearer than.

    Networks that an earlier run measured at the same budget are read back, their times too: a search that was stopped
    goes on as it would have gone. Times that are measured anew differ a little, and may breed other networks.

    Args:
        config: Budget and length.
        runs: Folder of caches and of measured networks.
        workers: Number of processes that make labels.
        report: Called with what each network is before it is trained.

    Returns:
        {"settings", "trials": [{"name", "widths", "iterations", "hidden", "parameters", "ms", "cd_units", "hours"}],
        "front": those of the trials that `front_of` keeps, "paper": the trial of the paper's network}. A trial's "ms"
        is what `call_ms` measures; its "cd_units" is the Chamfer distance of predicted sets to their labels in units of
        the patch, on patches of the validation split.

    Raises:
        InvalidOption: Optuna, an extra of this package, is not installed.
    """
    study = _study(config)
    budget = {each.name: getattr(config, each.name) for each in fields(Budget)}
    journal = Journal(config.folder(runs, "search") / "networks.jsonl", budget)
    measured = {_architecture(row): row for row in journal.records}
    patches = cache(lambda: read_patches(config, runs=runs, workers=workers))
    trials: dict[Architecture, dict[str, Any]] = {}
    for _ in range(_ASKED_A_TRIAL * config.trials):
        if len(trials) == config.trials:
            break
        asked = study.ask()
        architecture = express({name: asked.suggest_categorical(name, values) for name, values in GENES.items()})
        if architecture not in measured:
            if report is not None:
                report(f"{len(trials) + 1} of {config.trials}: {name_of(architecture)}")
            measured[architecture] = _measure(architecture, patches(), config, journal.path.parent)
            journal.add(measured[architecture])
        row = trials[architecture] = measured[architecture]
        study.tell(asked, (row["ms"], row["cd_units"]))
    rows = list(trials.values())
    return {"settings": asdict(config), "trials": rows, "front": front_of(rows), "paper": trials[PAPER]}


def express(genes: Mapping[str, int]) -> Architecture:
    """The network of some genes; each layer of its decoder is half as wide as the one before, as the paper's are."""
    inner = tuple(genes[f"inner_{i}"] for i in range(1, genes["layers"] - 1))
    hidden = genes["hidden"]
    return Architecture(
        (genes["first"], *inner, genes["code"]), genes["iterations"], (hidden, hidden // 2, hidden // 4)
    )


def name_of(architecture: Architecture) -> str:
    """A network in a few words: encoders, decoder, and iterations m."""
    return f"{joined(architecture.widths)}, {joined(architecture.hidden)}, m = {architecture.iterations}"


def front_of(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The rows that no other one matches in both "ms" and "cd_units", the quickest first; of equal rows, the first."""
    front: list[Mapping[str, Any]] = []
    for row in sorted(rows, key=lambda row: (row["ms"], row["cd_units"])):
        if not front or row["cd_units"] < front[-1]["cd_units"]:
            front.append(row)
    return front


def _study(config: SearchConfig):
    """Optuna's study of both objectives, whose first network is the paper's."""
    if importlib.util.find_spec("optuna") is None:
        raise InvalidOption('the search needs optuna, which is not installed: pip install "gfp-grasp[search]"')
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    sampler = optuna.samplers.NSGAIISampler(population_size=config.population, seed=config.seed)
    study = optuna.create_study(directions=["minimize", "minimize"], sampler=sampler)
    study.enqueue_trial(_PAPER_GENES)
    return study


def _architecture(row: Mapping[str, Any]) -> Architecture:
    return Architecture(tuple(row["widths"]), row["iterations"], tuple(row["hidden"]))


def _measure(architecture: Architecture, patches: PatchSets, config: SearchConfig, folder: Path) -> dict[str, Any]:
    """Train one network and measure what the search weighs."""
    checkpoint = folder / f"{name_of(architecture).replace(' = ', '').replace(', ', '_')}.pt"
    network, hours = train_paper_net(architecture.make(config.seed), patches.training, config, checkpoint=checkpoint)
    checkpoint.unlink()
    return {
        "name": name_of(architecture),
        "widths": list(architecture.widths),
        "iterations": architecture.iterations,
        "hidden": list(architecture.hidden),
        "parameters": num_parameters(network),
        "ms": call_ms(network),
        "cd_units": chamfers(network, patches.held_out, architecture.iterations)[-1],
        "hours": round(hours, 4),
    }
