"""`gfp-grasp decompose`: a mesh in, convex parts out, with the mass of the solid that they stand for."""

import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gfp_grasp.cli.terminal import Files, Seed, check_outputs, err, out, stages
from gfp_grasp.errors import InvalidMesh
from gfp_grasp.units import scale_advice

if TYPE_CHECKING:
    import trimesh

_WORTH_A_WORD_M = 5e-6  # distances that are not zero in hundredths of a millimetre
_SHELL_M = 0.002  # wall of a mesh that has no inside
_SIZES_M = (0.01, 1.0)  # longest side that is taken for metres where nobody says so, as in the environment


def decompose(
    mesh: Annotated[
        Path, typer.Argument(help="Mesh file: .obj .stl .ply .glb .gltf .off, or another that trimesh reads.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help=".xml (MJCF), .urdf, or a mesh of all parts.")],
    scale: Annotated[
        float | None,
        typer.Option(help="Metres of one unit of the file, 0.001 for millimetres; left out, what it says, or metres."),
    ] = None,
    density: Annotated[float, typer.Option(help="Density of the material, kg/m3.")] = 1000.0,
    engine: Annotated[str, typer.Option(help="coacd, or vhacd, which is an extra.")] = "coacd",
    threshold: Annotated[float, typer.Option(help="Concavity a part may keep, 0.01 to 1; smaller is finer.")] = 0.05,
    max_parts: Annotated[int | None, typer.Option(help="Most parts.")] = None,
    files: Files = False,
    time_limit: Annotated[float, typer.Option(help="Seconds for the repair and all attempts.")] = 300.0,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Neither read nor keep what was made before.")] = False,
    seed: Seed = 0,
) -> None:
    """Split a mesh into convex parts with CoACD or V-HACD, for a simulator."""
    import trimesh

    from gfp_grasp.collision import DecomposeConfig
    from gfp_grasp.collision import decompose as split
    from gfp_grasp.export import export_completion, legal_name, needs_parts
    from gfp_grasp.meshes import every_suffix, load_mesh, repair_mesh

    check_outputs([output])
    config = DecomposeConfig(
        threshold=threshold,
        max_convex_hull=-1 if max_parts is None else max_parts,
        time_limit_s=time_limit,
        engine=engine,  # pyright: ignore[reportArgumentType] - refused by name if it is another
        cache=not no_cache,
        seed=seed,
    )
    started = time.monotonic()
    given = load_mesh(mesh, suffixes=every_suffix(), scale=1.0 if scale is None else scale)
    if scale is None:
        _refuse_unit(mesh.name, given)
    with stages(time_limit) as tell:
        tell("repairing")
        repair = repair_mesh(given, time_limit_s=time_limit / 2)
        left_s = max(time_limit - (time.monotonic() - started), 1.0)
        collision = split(repair.solid, config=replace(config, time_limit_s=left_s), progress=tell)
    if repair.error_m > _WORTH_A_WORD_M:
        err.print(f"note: the mesh was repaired; the solid is off it by at most {1000 * repair.error_m:.2f} mm")
    parts = [part.to_trimesh() for part in collision.parts]
    mass = ""
    if needs_parts(output):
        is_open = repair.how == "remeshed" and not given.is_watertight
        shell_m = _SHELL_M if is_open else None
        if shell_m:
            err.print(f"note: the mesh is not closed; its mass is that of a {1000 * shell_m:.0f} mm shell")
        shown = given if is_open else repair.solid
        export_completion(
            shown,
            parts,
            output,
            name=legal_name(mesh.stem),
            density=density,
            shell_thickness_m=shell_m,
            assets="files" if files else "embedded",
        )
        volume = shown.area * shell_m if shell_m else shown.volume
        mass = f"; {density * volume:.3g} kg"
    else:
        export_completion(trimesh.util.concatenate(parts), parts, output)  # pyright: ignore[reportArgumentType]
    mean, high, largest = (f"{1000 * error:.2f}" for error in collision.error_m)
    errors = f"{mean} mm on average, {high} mm for 95 %, {largest} mm at most"
    cached = ", from the cache" if collision.notes["cached"] else ""
    out.print(f"{len(parts)} parts in {collision.seconds:.1f} s{cached}; off the mesh by {errors}{mass}")


def _refuse_unit(name: str, mesh: "trimesh.Trimesh") -> None:
    longest_m = float(mesh.extents.max())
    least_m, most_m = _SIZES_M
    if not least_m <= longest_m <= most_m:
        advice = scale_advice(longest_m, least_m=least_m, most_m=most_m)
        raise InvalidMesh(
            f"{name}: the mesh is {longest_m:.3g} m long, {least_m} to {most_m:g} m are expected: scale it to metres, "
            f"{advice}; --scale 1 takes it as it is"
        )
