"""`gfp-grasp gps` and `gfp-grasp train`: what primitives and networks are and how they are made."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, cast

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from gfp_grasp.cli.terminal import Gps, LimitOfEach, Seed, Workers, err, out, table, track, warnings_as_notes
from gfp_grasp.errors import InvalidOption, UnreadableFile

gps = typer.Typer(name="gps", help="Generic primitives: list, show, build.", no_args_is_help=True)


@gps.command("list")
def list_all(folders: Gps = None) -> None:
    """The primitives that ship with the package, and those of your own folders."""
    from gfp_grasp.primitives import PrimitiveLibrary

    library, rows = PrimitiveLibrary.with_shipped(*(folders or [])), []
    for primitive in map(library.primitive, library.names):
        extents_mm = 1000 * (primitive.vertices.max(axis=0) - primitive.vertices.min(axis=0))
        size = " x ".join(f"{extent:.0f}" for extent in extents_mm)
        counts = (len(primitive.vertices), len(primitive.modes), len(primitive.parts))
        rows.append((primitive.name, size, *map(str, counts), primitive.licence))
    table(("class", "mean, mm", "vertices", "modes", "parts", "licence"), rows)


@gps.command()
def show(category: Annotated[str, typer.Argument(help="Class, or class.subcategory.")], folders: Gps = None) -> None:
    """The card of a primitive: what is known of its class, how it was built, from what, and its figures."""
    from gfp_grasp.primitives import PrimitiveLibrary

    out.print_json(
        json.dumps(dict(PrimitiveLibrary.with_shipped(*(folders or [])).primitive(category).card), default=str)
    )


@gps.command()
def build(
    category: Annotated[
        str | None, typer.Argument(help="Name of the class, or class.subcategory; left out, all that ship.")
    ] = None,
    meshes: Annotated[Path | None, typer.Option(help="Folder of its meshes; left out, its procedural shapes.")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder of the .safetensors, .ply and .json.")] = Path("gps"),
    orientation: Annotated[str, typer.Option(help="What is known of a folder's meshes: placed, upright, any.")] = "any",
    licence: Annotated[str, typer.Option(help="Licence of a folder's meshes, for the card.")] = "",
    spec: Annotated[
        Path | None,
        typer.Option(exists=True, dir_okay=False, help="JSON of what is known of the class, for its card."),
    ] = None,
    limit: Annotated[int | None, typer.Option(min=1, help="Number of procedural shapes.")] = None,
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """Build the primitive of any class from a set of its meshes, and measure it on some that are held out."""
    from gfp_grasp.primitives import BuildConfig, save_primitive
    from gfp_grasp.train import build_from_folder, build_from_shapes, build_shipped, shipped_names

    if category is None:
        if meshes is not None or spec is not None or limit is not None:
            raise InvalidOption("--meshes, --spec and --limit are of one class: name it")
        build_shipped(shipped_names(), folder, seed=seed, workers=workers, progress=track("primitives"))
        return
    progress, known = track(f"primitive of {category}"), _read_spec(spec)
    if meshes is None:
        primitive = build_from_shapes(category, members=limit, seed=seed, spec=known, progress=progress)
    else:
        config = BuildConfig(orientation=orientation, licence=licence)  # pyright: ignore[reportArgumentType]
        with warnings_as_notes():
            primitive = build_from_folder(meshes, category, seed=seed, config=config, spec=known, progress=progress)
    path = save_primitive(primitive, folder)
    out.print(f"{path}: {len(primitive.vertices)} vertices, {len(primitive.modes)} modes", markup=False)


def _read_spec(path: Path | None) -> dict:
    """Fields of a CategorySpec from a JSON file; none without a file."""
    if path is None:
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise UnreadableFile(f"{path} is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise UnreadableFile(f"{path} holds a {type(content).__name__}; an object with fields of the spec is expected")
    return content


@gps.command()
def parts(
    names: Annotated[
        list[str] | None, typer.Argument(help="class or class.subcategory; left out, all that ship.")
    ] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder of the .safetensors, .ply and .json.")] = Path("gps"),
) -> None:
    """Decompose the mean of primitives again into convex parts, which takes minutes; their shape stays as it is."""
    from gfp_grasp.primitives import PrimitiveLibrary, save_primitive, with_parts

    library, rows = PrimitiveLibrary.shipped(), []
    names = names or list(library.names)
    for name in track("convex parts")(names, len(names)):
        primitive = with_parts(library.primitive(name))
        save_primitive(primitive, folder)
        mean_m, high_m = primitive.part_errors_m[-1]
        rows.append((name, str(len(primitive.parts)), f"{1000 * mean_m:.2f}", f"{1000 * high_m:.2f}"))
    table(("class", "parts", "off on average, mm", "for 95 %, mm"), rows)


@gps.command()
def prototypes(
    names: Annotated[
        list[str] | None, typer.Argument(help="class or class.subcategory; left out, all of the folder.")
    ] = None,
    folder: Annotated[Path, typer.Option("--gps", help="Folder of the primitives, which are written anew.")] = Path(
        "gps"
    ),
    shapes: Annotated[
        bool, typer.Option(help="Render procedural shapes instead of the members that the primitive's modes make.")
    ] = False,
    seed: Seed = 0,
) -> None:
    """Compute the prototypes by which the classifier that ships tells the classes of a folder apart."""
    from gfp_grasp.primitives import PrimitiveLibrary, save_primitive
    from gfp_grasp.train import procedural_members, with_prototypes

    library = PrimitiveLibrary(folder)
    names = names or list(library.names)
    for name in track("prototypes")(names, len(names)):
        meshes = procedural_members(name) if shapes else None
        save_primitive(with_prototypes(library.primitive(name), meshes=meshes, seed=seed), folder)
    out.print(f"{folder}: prototypes of {', '.join(names)}", markup=False)


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
def proposal(
    classes: Classes = None,
    data: Data = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder of the weights.")] = Path("gfp_grasp/weights"),
    sensor: Annotated[str, typer.Option(help="tabletop, or lidar for scans of traffic.")] = "tabletop",
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
    steps: Steps = None,
    views: Views = 4,
    limit: LimitOfEach = None,
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
    """The deformation network."""
    from gfp_grasp.deform import Variant
    from gfp_grasp.train import GFPNET_CONFIGS, train_gfpnet

    if variant not in GFPNET_CONFIGS:
        raise InvalidOption(f"--variant is {variant!r}; legal are {', '.join(GFPNET_CONFIGS)}")
    chosen = cast(Variant, variant)
    default = GFPNET_CONFIGS[chosen]
    config = replace(
        default, seed=seed, device=device, steps=steps or default.steps, rate=default.rate if rate is None else rate
    )
    with _bar(f"gfpnet {variant}", config.steps) as report:
        card = train_gfpnet(
            chosen,
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
