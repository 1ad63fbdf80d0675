"""`gfp-grasp gps`: the generic primitives, what they are and how they are made."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.terminal import Limit, Seed, out, table, track

gps = typer.Typer(name="gps", help="Generic primitives: list, show, build.", no_args_is_help=True)


@gps.command("list")
def list_all() -> None:
    """The primitives that ship with the package."""
    from gfp_grasp.primitives import list_primitives, load_primitive

    rows = []
    for name in list_primitives():
        primitive = load_primitive(name)
        extents_mm = 1000 * (primitive.vertices.max(axis=0) - primitive.vertices.min(axis=0))
        size = " x ".join(f"{extent:.0f}" for extent in extents_mm)
        counts = (len(primitive.vertices), len(primitive.modes), len(primitive.parts))
        rows.append((name, size, *map(str, counts), primitive.licence))
    table(("class", "mean, mm", "vertices", "modes", "parts", "licence"), rows, words=1)


@gps.command()
def show(category: Annotated[str, typer.Argument(help="Class.")]) -> None:
    """The card of a primitive: how it was built, from what, and its figures."""
    from gfp_grasp.primitives import load_primitive

    out.print_json(json.dumps(dict(load_primitive(category).card), default=str))


@gps.command()
def build(
    category: Annotated[str, typer.Argument(help="Name of the class.")],
    meshes: Annotated[
        Path | None, typer.Option(help="Folder of meshes of the class; left out, its procedural training split.")
    ] = None,
    folder: Annotated[Path, typer.Option("--out", help="Folder of the .safetensors, .ply and .json.")] = Path("gps"),
    orientation: Annotated[
        str | None, typer.Option(help="What is known of the meshes: placed, upright or any. Of a folder: any.")
    ] = None,
    licence: Annotated[str, typer.Option(help="Of the meshes, for the card.")] = "",
    limit: Limit = None,
    seed: Seed = 0,
) -> None:
    """Build the primitive of any class from a set of its meshes."""
    from gfp_grasp.primitives import BuildConfig, build_primitive, save_primitive
    from gfp_grasp.scenes import load_objects

    sources = load_objects(meshes if meshes is not None else category, split="train", limit=limit)
    loaded = [source.load_mesh() for source in track("meshes")(sources, len(sources))]
    config = BuildConfig(
        orientation=orientation or ("any" if meshes else "placed"),  # pyright: ignore[reportArgumentType]
        licence=licence or ("" if meshes else "Apache-2.0"),
    )
    primitive = build_primitive(loaded, category, config=config, seed=seed, progress=track(f"primitive of {category}"))
    command = "gfp-grasp " + " ".join(sys.argv[1:])
    primitive = replace(primitive, card={**primitive.card, "command": command})
    path = save_primitive(primitive, folder)
    out.print(f"{path}: {len(primitive.vertices)} vertices, {len(primitive.modes)} modes", markup=False)
