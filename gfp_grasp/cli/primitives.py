"""`gfp-grasp gps`: what primitives are and how they are made."""

import json
from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.terminal import Gps, Seed, Workers, out, table, track, warnings_as_notes
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
