"""`gfp-grasp complete`: a cloud or a picture in, completed shapes out."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from gfp_grasp.cli.terminal import Detector, Files, Gps, Seed, check_outputs, err, table, vector


def complete(
    cloud: Annotated[Path, typer.Argument(help="Cloud or .npz capture, metres; sample is one that ships.")],
    output: Annotated[
        list[Path], typer.Option("--output", "-o", help=".obj .ply .stl .glb, .xml (MJCF) or .urdf; may be repeated.")
    ],
    viewpoint: Annotated[str | None, typer.Option(help="Where the camera stood, x,y,z in metres.")] = None,
    up: Annotated[str | None, typer.Option(help="Normal of the support, x,y,z, or auto; z if left out.")] = None,
    support_height: Annotated[float | None, typer.Option(help="Height of the support along up, metres.")] = None,
    category: Annotated[str | None, typer.Option(help="Class of the object; left out, it is found.")] = None,
    folders: Gps = None,
    detector: Detector = "tabletop",
    files: Files = False,
    max_parts: Annotated[int, typer.Option(help="Most convex parts.")] = 80,
    max_vertices: Annotated[int | None, typer.Option(help="Most vertices of each part.")] = None,
    tolerance_mm: Annotated[
        float | None, typer.Option(help="As few parts as lie within this of the mesh, for 95 % of it.")
    ] = None,
    seed: Seed = 0,
) -> None:
    """Complete the object of a cloud, or every object of a depth picture. Several objects get numbered files."""
    from gfp_grasp.captures import complete_capture, read_capture
    from gfp_grasp.collision import CollisionConfig
    from gfp_grasp.complete import CompleteConfig
    from gfp_grasp.primitives import PrimitiveLibrary

    check_outputs(output)
    tolerance_m = None if tolerance_mm is None else tolerance_mm / 1000
    budget = CollisionConfig(max_parts, max_vertices, tolerance_m)
    config = CompleteConfig(library=PrimitiveLibrary.with_shipped(*(folders or ())), collision=budget)
    capture = read_capture(cloud)
    given: dict[str, object] = {}
    if viewpoint is not None:
        given["viewpoint"] = np.array(vector(viewpoint, "viewpoint"))
    if up is not None:
        given["up"] = None if up == "auto" else np.array(vector(up, "up"))
    if support_height is not None:
        given["support_height"] = support_height
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        warnings.simplefilter("always", RuntimeWarning)
        completions = complete_capture(
            replace(capture, **given), category=category, detector=detector, config=config, seed=seed
        )
        counts = [len(completion.parts) for completion in completions]
    for warning in caught:
        err.print(f"note: {warning.message}", style="yellow", markup=False, soft_wrap=True)
    rows = []
    for number, completion in enumerate(completions):
        for path in output:
            path = path if len(completions) == 1 else path.with_stem(f"{path.stem}_{number}")
            completion.export(path, assets="files" if files else "embedded")
        size_mm = " x ".join(f"{1000 * extent:.0f}" for extent in completion.mesh.extents)
        score = f"{completion.scores.get(completion.category, float('nan')):.2f}"
        seen, parts = f"{completion.observed.mean():.0%}", str(counts[number])
        milliseconds = f"{1000 * sum(completion.timings_s.values()):.0f}"
        rows.append((completion.category, score, size_mm, seen, parts, milliseconds))
    table(("class", "score", "size, mm", "seen", "parts", "time, ms"), rows)
