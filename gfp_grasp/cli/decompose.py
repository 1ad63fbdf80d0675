"""`gfp-grasp decompose`: a mesh in, convex parts out."""

from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.terminal import Files, Seed, check_outputs, err, out, stages

_SHELL_M = 0.002  # wall of a mesh without a volume


def decompose(
    mesh: Annotated[Path, typer.Argument(help="Mesh file, metres: any that trimesh reads.")],
    output: Annotated[Path, typer.Option("--output", "-o", help=".xml (MJCF), .urdf, or a mesh of all parts.")],
    engine: Annotated[str, typer.Option(help="coacd, or vhacd, which is an extra.")] = "coacd",
    threshold: Annotated[float, typer.Option(help="Concavity a part may keep, 0.01 to 1; smaller is finer.")] = 0.05,
    max_parts: Annotated[int | None, typer.Option(help="Most parts.")] = None,
    files: Files = False,
    time_limit: Annotated[float, typer.Option(help="Seconds for all attempts.")] = 300.0,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Neither read nor keep what was made before.")] = False,
    seed: Seed = 0,
) -> None:
    """Split a mesh into convex parts with CoACD or V-HACD, for a simulator."""
    import trimesh

    from gfp_grasp.collision import DecomposeConfig
    from gfp_grasp.collision import decompose as split
    from gfp_grasp.export import export_completion, legal_name, needs_parts
    from gfp_grasp.meshes import every_suffix, load_mesh

    check_outputs([output])
    config = DecomposeConfig(
        threshold=threshold,
        max_convex_hull=-1 if max_parts is None else max_parts,
        time_limit_s=time_limit,
        engine=engine,  # pyright: ignore[reportArgumentType] - refused by name if it is another
        cache=not no_cache,
        seed=seed,
    )
    solid = load_mesh(mesh, suffixes=every_suffix())
    if solid.is_watertight and solid.volume < 0:  # inside out
        solid.invert()
    with stages(time_limit) as tell:
        collision = split(solid, config=config, progress=tell)
    parts = [part.to_trimesh() for part in collision.parts]
    if needs_parts(output):
        name = legal_name(mesh.stem)
        shell_m = None if solid.is_volume else _SHELL_M
        if shell_m:
            err.print(f"note: the mesh is not closed; its mass is that of a {1000 * shell_m:.0f} mm shell")
        assets = "files" if files else "embedded"
        export_completion(solid, parts, output, name=name, shell_thickness_m=shell_m, assets=assets)
    else:
        export_completion(trimesh.util.concatenate(parts), parts, output)  # pyright: ignore[reportArgumentType]
    mean, high, largest = (f"{1000 * error:.2f}" for error in collision.error_m)
    errors = f"{mean} mm on average, {high} mm for 95 %, {largest} mm at most"
    cached = ", from the cache" if collision.notes["cached"] else ""
    out.print(f"{len(parts)} parts in {collision.seconds:.1f} s{cached}; off the mesh by {errors}")
