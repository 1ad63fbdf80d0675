"""`gfp-grasp train`: the networks whose weights ship with the package, made again or made better."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from gfp_grasp.cli.terminal import Limit, Seed, Workers, err, out
from gfp_grasp.errors import InvalidOption

train = typer.Typer(name="train", help="Train the networks; a run that was stopped goes on.", no_args_is_help=True)

Steps = Annotated[int | None, typer.Option(min=1, help="Optimiser steps; left out, those of the shipped weights.")]
Device = Annotated[str, typer.Option(help="cpu or cuda.")]
Runs = Annotated[Path, typer.Option(help="Folder of rendered views, labels and checkpoints.")]
Views = Annotated[int, typer.Option(min=1, help="Views of each shape.")]
Out = Annotated[Path | None, typer.Option(help="Weights file to write; left out, the shipped one.")]
Classes = Annotated[
    str | None, typer.Option(help="Classes to learn from, with commas between; left out, all that ship.")
]
Data = Annotated[
    Path | None, typer.Option(help="Folder of ModelNet40, ShapeNetCore or of meshes; left out, procedural shapes.")
]


@train.command()
def classifier(
    classes: Classes = None,
    data: Data = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder of the weights.")] = Path("gfp_grasp/weights"),
    steps: Steps = None,
    limit: Limit = None,
    device: Device = "cpu",
    runs: Runs = Path("runs"),
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """The network that embeds a cloud, by which classes are told apart; then `gps prototypes` makes theirs anew."""
    from gfp_grasp.train import ClassifierConfig, train_classifier

    config = ClassifierConfig(seed=seed, device=device, limit=limit)
    config = replace(config, steps=steps or config.steps)
    with _bar("classifier", config.steps) as report:
        metrics = train_classifier(
            config,
            classes=_listed(classes),
            data=data,
            out=folder,
            cache=runs / "classifier",
            workers=workers,
            report=report,
        )
    out.print(metrics)


@train.command()
def pcrnet(
    classes: Classes = None,
    data: Data = None,
    file: Out = None,
    steps: Steps = None,
    views: Views = 4,
    limit: Limit = None,
    device: Device = "cpu",
    runs: Runs = Path("runs"),
    seed: Seed = 0,
) -> None:
    """The registration network."""
    from gfp_grasp.train import PCRNET_CONFIG, train_pcrnet

    config = replace(PCRNET_CONFIG, seed=seed, device=device, steps=steps or PCRNET_CONFIG.steps)
    with _bar("pcrnet", config.steps) as report:
        card = train_pcrnet(
            config=config,
            classes=_listed(classes),
            data=data,
            num_views=views,
            limit=limit,
            out=file,
            runs=runs,
            report=report,
        )
    out.print(str(card), markup=False)


@train.command()
def gfpnet(
    variant: Annotated[str, typer.Option(help="patch, paper-iterative or paper-oneshot.")] = "patch",
    classes: Classes = None,
    data: Data = None,
    file: Out = None,
    steps: Steps = None,
    views: Views = 4,
    limit: Limit = None,
    device: Device = "cpu",
    runs: Runs = Path("runs"),
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """The deformation network."""
    from gfp_grasp.deform import Variant
    from gfp_grasp.train import GFPNET_CONFIGS, train_gfpnet

    if variant not in GFPNET_CONFIGS:
        raise InvalidOption(f"--variant is {variant!r}; legal are {', '.join(GFPNET_CONFIGS)}")
    chosen = cast(Variant, variant)
    config = replace(GFPNET_CONFIGS[chosen], seed=seed, device=device, steps=steps or GFPNET_CONFIGS[chosen].steps)
    with _bar(f"gfpnet {variant}", config.steps) as report:
        card = train_gfpnet(
            chosen,
            classes=_listed(classes),
            config=config,
            num_views=views,
            limit=limit,
            data=data,
            out=file,
            runs=runs,
            workers=workers,
            report=report,
        )
    out.print(str(card), markup=False)


def _listed(classes: str | None) -> tuple[str, ...] | None:
    """The classes of a comma-separated list; None where there is no list."""
    return None if classes is None else tuple(name.strip() for name in classes.split(",") if name.strip())


@contextmanager
def _bar(name: str, steps: int) -> Iterator[Callable[[int, float], None]]:
    """A progress bar as a function of step and loss."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=err) as progress:
        task = progress.add_task(f"{name}: data", total=steps)

        def report(step: int, loss: float) -> None:
            progress.update(task, completed=step, description=f"{name}: loss {loss:.4f}")

        yield report
