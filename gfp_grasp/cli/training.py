"""`gfp-grasp train`: how networks are made."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from gfp_grasp.cli.terminal import LimitOfEach, Seed, Workers, err, out, track
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
Sensor = Annotated[str, typer.Option(help="tabletop, or lidar for scans of traffic.")]
Data = Annotated[
    Path | None, typer.Option(help="Folder of ModelNet40, ShapeNetCore or of meshes; left out, procedural shapes.")
]


@train.command()
def proposal(
    classes: Classes = None,
    data: Data = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder of the weights.")] = Path("gfp_grasp/weights"),
    sensor: Sensor = "tabletop",
    steps: Steps = None,
    limit: LimitOfEach = None,
    device: Device = "cpu",
    runs: Runs = Path("runs"),
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """The network that tells classes apart and proposes pose and size; then `gps prototypes` makes those anew."""
    from gfp_grasp.train import LIDAR_CONFIG, ProposalConfig, train_proposal
    from gfp_grasp.types import LIDAR, get_sensor

    shipped = LIDAR_CONFIG if get_sensor(sensor) is LIDAR else ProposalConfig()
    config = replace(shipped, seed=seed, device=device)
    config = replace(config, steps=steps or config.steps, limit=limit or config.limit)
    with _bar("proposal", config.steps) as report:
        metrics = train_proposal(
            config,
            classes=_listed(classes),
            data=data,
            out=folder,
            cache=runs / "proposal",
            workers=workers,
            report=report,
        )
    out.print(metrics)


@train.command()
def pcrnet(
    classes: Classes = None,
    data: Data = None,
    file: Out = None,
    sensor: Sensor = "tabletop",
    steps: Steps = None,
    views: Views = 4,
    limit: LimitOfEach = None,
    device: Device = "cpu",
    runs: Runs = Path("runs"),
    seed: Seed = 0,
) -> None:
    """The registration network."""
    from gfp_grasp.train import PCRNET_CONFIG, train_pcrnet
    from gfp_grasp.types import get_sensor

    config = replace(PCRNET_CONFIG, seed=seed, device=device, steps=steps or PCRNET_CONFIG.steps)
    with _bar("pcrnet", config.steps) as report:
        card = train_pcrnet(
            config=config,
            sensor=get_sensor(sensor),
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
    start: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="Weights file to go on from; left out, training starts anew."),
    ] = None,
    steps: Steps = None,
    rate: Annotated[
        float | None, typer.Option(help="Learning rate at first; left out, that of the shipped weights.")
    ] = None,
    views: Views = 4,
    limit: LimitOfEach = None,
    device: Device = "cpu",
    runs: Runs = Path("runs"),
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """The deformation network; the paper's two learn in the paper's own setting."""
    from gfp_grasp.train import GFPNET_CONFIG, PAPER_CONFIGS, train_gfpnet, train_paper

    kinds = {"patch": (GFPNET_CONFIG, train_gfpnet)} | {
        name: (own, partial(train_paper, name)) for name, own in PAPER_CONFIGS.items()
    }
    if variant not in kinds:
        raise InvalidOption(f"--variant is {variant!r}; legal are {', '.join(kinds)}")
    default, run = kinds[variant]
    config = replace(
        default, seed=seed, device=device, steps=steps or default.steps, rate=default.rate if rate is None else rate
    )
    with _bar(f"gfpnet {variant}", config.steps) as report:
        card = run(
            classes=_listed(classes),
            config=config,
            num_views=views,
            limit=limit,
            data=data,
            out=file,
            start=start,
            runs=runs,
            workers=workers,
            report=report,
        )
    out.print(str(card), markup=False)


@train.command()
def instances(
    file: Out = None,
    steps: Steps = None,
    rooms: Annotated[int | None, typer.Option(min=1, help="Rooms; left out, those of the shipped weights.")] = None,
    runs: Runs = Path("runs"),
    device: Device = "cpu",
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """The network that tells the things on a table apart in a depth picture."""
    from gfp_grasp.train import InstancesConfig, train_instances

    config = InstancesConfig(seed=seed, device=device)
    config = replace(config, steps=steps or config.steps, rooms=rooms or config.rooms)
    with _bar("instances", config.steps) as report:
        card = train_instances(config=config, out=file, runs=runs, workers=workers, report=report)
    out.print(str(card), markup=False)


@train.command()
def pointrcnn(
    data: Annotated[
        Path | None, typer.Option(help="KITTI's object or tracking layout to learn from; left out, simulated streets.")
    ] = None,
    file: Out = None,
    steps: Steps = None,
    streets: Annotated[int | None, typer.Option(min=1, help="Streets; left out, those of the shipped weights.")] = None,
    runs: Runs = Path("runs"),
    device: Device = "cpu",
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """The network that finds vehicles and people in a LiDAR's scan."""
    from gfp_grasp.train import PointRCNNConfig, train_pointrcnn

    config = PointRCNNConfig(seed=seed, device=device)
    config = replace(config, steps=steps or config.steps, streets=streets or config.streets)
    with _bar("pointrcnn", config.steps) as report:
        card = train_pointrcnn(config=config, data=data, out=file, runs=runs, workers=workers, report=report)
    out.print(str(card), markup=False)


@train.command()
def classfree(
    without: Annotated[
        str | None, typer.Option(help="Classes to leave out of what is learnt, with commas between.")
    ] = None,
    file: Out = None,
    steps: Steps = None,
    members: Annotated[
        int | None, typer.Option(min=1, help="Objects of each class; left out, those of the shipped weights.")
    ] = None,
    mixtures: Annotated[
        int | None,
        typer.Option(min=1, help="Things of each kind that is of no class; left out, those of the shipped weights."),
    ] = None,
    runs: Runs = Path("runs"),
    device: Device = "cpu",
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """The network that completes things of no class; it is measured on classes left out like on the others."""
    from gfp_grasp.train import ClassfreeConfig, train_classfree

    config = ClassfreeConfig(seed=seed, device=device)
    config = replace(
        config,
        steps=steps or config.steps,
        members=members or config.members,
        mixtures=mixtures or config.mixtures,
    )
    with _bar("classfree", config.steps) as report:
        card = train_classfree(
            config=config, without=_listed(without) or (), out=file, runs=runs, workers=workers, report=report
        )
    out.print(str(card), markup=False)


@train.command()
def openset(
    file: Annotated[Path | None, typer.Option(help="Card to write; left out, the shipped one.")] = None,
    members: Annotated[int, typer.Option(min=1, help="Objects of each household class.")] = 8,
    mixtures: Annotated[int, typer.Option(min=1, help="Things of each kind that is of no class.")] = 24,
    workers: Workers = 1,
) -> None:
    """What tells things of no class from things of a class; the networks and the primitives come first."""
    from gfp_grasp.train import OpenSetConfig, train_openset

    config = OpenSetConfig(members, mixtures)
    out.print(str(train_openset(config=config, out=file, workers=workers, progress=track("things"))), markup=False)


@train.command()
def peer(
    name: Annotated[str, typer.Argument(help="pcn, foldingnet, topnet, 3d-epn, 3d-sc or scrg.")],
    true_box: Annotated[
        bool,
        typer.Option("--true-box", help="Go on in the true box, as the papers do; left out, around what was seen."),
    ] = False,
    classes: Annotated[
        str | None,
        typer.Option(help="Classes to learn from, with commas between; left out, households and those of the paper."),
    ] = None,
    file: Out = None,
    steps: Steps = None,
    members: Annotated[
        int | None, typer.Option(min=1, help="Objects of each class; left out, those of the shipped weights.")
    ] = None,
    runs: Runs = Path("runs"),
    device: Device = "cpu",
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """One of the networks that GFPNet is compared with: forty minutes of one core, ten more in the true box."""
    from gfp_grasp.train import peer_config, train_peer

    config = replace(peer_config(name, true_box=true_box), seed=seed, device=device)
    config = replace(config, steps=steps or config.steps, members=members or config.members)
    with _bar(name, config.steps) as report:
        card = train_peer(
            name,
            true_box=true_box,
            config=config,
            classes=_listed(classes),
            out=file,
            runs=runs,
            workers=workers,
            report=report,
        )
    out.print(str(card), markup=False)


@train.command()
def curves(
    picture: Annotated[Path, typer.Argument(dir_okay=False, help="Draw them to this .svg file.")],
    folder: Annotated[
        Path | None,
        typer.Option("--weights", exists=True, file_okay=False, help="Folder of cards; left out, the shipped ones."),
    ] = None,
) -> None:
    """The learning curves that the cards of weights keep."""
    from gfp_grasp.assets import data_dir
    from gfp_grasp.drawing import write_learning_curves
    from gfp_grasp.train import curves_of_cards

    found = curves_of_cards(folder or data_dir("weights"))
    out.print(str(write_learning_curves(found, picture, title="Learning curves")), markup=False)


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
