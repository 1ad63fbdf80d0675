"""`gfp-grasp gps`: the generic primitives, what they are and how they are made."""

import json
from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.terminal import Seed, out, table, track

gps = typer.Typer(name="gps", help="Generic primitives: list, show, build.", no_args_is_help=True)


@gps.command("list")
def list_all() -> None:
    """The primitives that ship with the package."""
    from gfp_grasp.primitives import list_primitives, load_kinds

    rows = []
    for primitive in (p for name in list_primitives() for p in load_kinds(name)):
        extents_mm = 1000 * (primitive.vertices.max(axis=0) - primitive.vertices.min(axis=0))
        size = " x ".join(f"{extent:.0f}" for extent in extents_mm)
        counts = (len(primitive.vertices), len(primitive.modes), len(primitive.parts))
        rows.append((primitive.name, size, *map(str, counts), primitive.licence))
    table(("class", "mean, mm", "vertices", "modes", "parts", "licence"), rows, words=1)


@gps.command()
def show(category: Annotated[str, typer.Argument(help="Class, or class.kind.")]) -> None:
    """The card of a primitive: how it was built, from what, and its figures."""
    from gfp_grasp.primitives import load_primitive

    out.print_json(json.dumps(dict(load_primitive(category).card), default=str))


@gps.command()
def build(
    category: Annotated[str, typer.Argument(help="Name of the class.")],
    meshes: Annotated[Path | None, typer.Option(help="Folder of its meshes; left out, its procedural shapes.")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder of the .safetensors, .ply and .json.")] = Path("gps"),
    orientation: Annotated[str, typer.Option(help="What is known of a folder's meshes: placed, upright, any.")] = "any",
    licence: Annotated[str, typer.Option(help="Of a folder's meshes, for the card.")] = "",
    kind: Annotated[str, typer.Option(help="Of its procedural shapes alone, e.g. stemmed of cup.")] = "",
    limit: Annotated[int, typer.Option(min=1, help="So many procedural shapes.")] = 120,
    seed: Seed = 0,
) -> None:
    """Build the primitive of any class from a set of its meshes, and measure it on some that are held out."""
    from gfp_grasp.primitives import BuildConfig, save_primitive
    from gfp_grasp.train import build_from_folder, build_from_shapes

    progress = track(f"primitive of {category}")
    if meshes is None:
        primitive = build_from_shapes(category, kind, members=limit, seed=seed, progress=progress)
    else:
        config = BuildConfig(orientation=orientation, licence=licence)  # pyright: ignore[reportArgumentType]
        primitive = build_from_folder(meshes, category, seed=seed, config=config, progress=progress)
    path = save_primitive(primitive, folder)
    out.print(f"{path}: {len(primitive.vertices)} vertices, {len(primitive.modes)} modes", markup=False)


@gps.command()
def parts(
    names: Annotated[list[str] | None, typer.Argument(help="class or class.kind; left out, all that ship.")] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder of the .safetensors, .ply and .json.")] = Path("gps"),
) -> None:
    """Decompose the mean of primitives again into convex parts, which takes minutes; their shape stays as it is."""
    from gfp_grasp.primitives import list_primitives, load_kinds, load_primitive, save_primitive, with_parts

    names = names or [primitive.name for category in list_primitives() for primitive in load_kinds(category)]
    rows = []
    for name in track("convex parts")(names, len(names)):
        primitive = with_parts(load_primitive(name))
        save_primitive(primitive, folder)
        mean_m, high_m = primitive.part_errors_m[-1]
        rows.append((name, str(len(primitive.parts)), f"{1000 * mean_m:.2f}", f"{1000 * high_m:.2f}"))
    table(("class", "parts", "off on average, mm", "for 95 %, mm"), rows, words=1)
