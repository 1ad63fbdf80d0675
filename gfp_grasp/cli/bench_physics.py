"""`gfp-grasp bench` in MuJoCo: readiness, collision parts, hollow things, trials, resets, and broken meshes."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.bench_networks import bench
from gfp_grasp.cli.terminal import (
    JsonFile,
    Most,
    Objects,
    Seed,
    Workers,
    out,
    read_json,
    save_json,
    table,
    track,
)
from gfp_grasp.errors import InvalidOption


@bench.command()
def ready(
    data: Annotated[Path | None, typer.Option(help="Folder with meshes/, for real objects as well.")] = None,
    completers: Annotated[str, typer.Option(help="Names with commas between; all; your own: module:function.")] = "all",
    views: Annotated[int, typer.Option(min=1, help="Views of single objects, which take turns.")] = 18,
    scenes: Annotated[int, typer.Option(min=1, help="Scenes of three to five objects.")] = 8,
    workers: Workers = 1,
    json_file: JsonFile = None,
    pages: Annotated[
        list[Path] | None,
        typer.Option("--page", help="Markdown file whose tables are written anew; may be given several times."),
    ] = None,
    seed: Seed = 0,
) -> None:
    """What robotics asks of a completed mesh: true, apart from its neighbours, standing, robust and quick.

    Every completer gets the depth picture and the object's true pixels; what it answers goes into a file for MuJoCo.
    The table has Chamfer distances (mean of both ways; median and mean, mm), the deepest cut into a neighbour in a
    scene and the share of objects that cut by more than 1 mm, the same before the scene parts its objects, tilt and
    travel after 2 s and the share that stays under 5 degrees and 5 mm, median distance and that share with 30, 50 and
    70 % of the pixels hidden, and seconds (median and 95 %). What has no answer counts as a miss in every share.
    """
    from gfp_grasp.bench import ReadyConfig, bench_ready, check_pages, ready_cells, ready_headings, write_pages
    from gfp_grasp.completers import COMPLETERS

    if pages and json_file is None:
        raise InvalidOption("--page names the file of its figures: give --json FILE, too")
    check_pages(pages or ())
    report = bench_ready(
        data,
        completers=COMPLETERS if completers == "all" else tuple(completers.split(",")),
        config=ReadyConfig(views, scenes, seed),
        workers=workers,
        progress=track("views and scenes"),
    )
    for group, rows in report["rows"].items():
        table(ready_headings(rows), [ready_cells(name, row) for name, row in rows.items()], title=group)
    save_json(json_file, report)
    if json_file is not None:
        write_pages(report, json_file, pages or ())


@bench.command()
def collision(
    objects: Objects = "all",
    methods: Annotated[str, typer.Option(help="Names with commas between; or all.")] = "all",
    limit: Most = 4,
    truth: Annotated[bool, typer.Option("--truth", help="Decompose the true meshes as well.")] = False,
    workers: Workers = 1,
    json_file: JsonFile = None,
    seed: Seed = 0,
) -> None:
    """Convex parts: time, truth and speed in MuJoCo, carried ones beside those of CoACD and V-HACD."""
    from gfp_grasp.bench import PARTS_METHODS, bench_collision

    chosen = PARTS_METHODS if methods == "all" else tuple(methods.split(","))
    report = bench_collision(
        objects, methods=chosen, limit=limit, truth=truth, seed=seed, workers=workers, progress=track("objects")
    )
    rows = report["rows"]
    for mesh, classes in rows.items():
        for category, figures in classes.items():
            table(
                ("method", "ms", "parts", "vertices", "off, mm", "for 95 %", "IoU", "steps/s", "objects", "failed"),
                [(name, *_part_figures(row)) for name, row in figures.items()],
                title=f"{category}, {mesh} meshes",
            )
    save_json(json_file, report)


@bench.command()
def hollow(
    objects: Objects = "all",
    limit: Most = 20,
    workers: Workers = 1,
    json_file: JsonFile = None,
    seed: Seed = 0,
) -> None:
    """Marbles in completed cups, mugs on a peg, bottles on a table, in MuJoCo."""
    from gfp_grasp.bench import bench_hollow

    report = bench_hollow(objects, limit=limit, seed=seed, workers=workers, progress=track("objects"))
    out.print_json(json.dumps(report["rows"]))
    save_json(json_file, report)


@bench.command()
def trial(
    objects: Objects = "all",
    limit: Most = 24,
    grasps: Annotated[int, typer.Option(min=1, help="Attempts on each object.")] = 4,
    completer: Annotated[str, typer.Option(help="Completes in the whole episodes that are timed.")] = "gfpnet",
    workers: Workers = 1,
    json_file: JsonFile = None,
    seed: Seed = 0,
) -> None:
    """Outcomes of grasps at the time step, at half and at a quarter of it; creep; attempts and episodes a second."""
    from gfp_grasp.bench import bench_trial

    report = bench_trial(
        objects,
        limit=limit,
        grasps=grasps,
        completer=completer,
        seed=seed,
        workers=workers,
        progress=track("objects"),
    )
    out.print_json(json.dumps({key: value for key, value in report.items() if key != "trials"}))
    save_json(json_file, report)


@bench.command()
def resets(
    objects: Objects = "all",
    count: Annotated[int, typer.Option("--resets", min=10, help="Resets of one environment.")] = 10_000,
    completer: Annotated[
        str, typer.Option(help="Name of a completer; a cheap one measures the environment.")
    ] = "mirror",
    limit: Most = 20,
    json_file: JsonFile = None,
    seed: Seed = 0,
) -> None:
    """Memory of the environment over many resets."""
    from gfp_grasp.bench import bench_resets

    report = bench_resets(objects, resets=count, completer=completer, limit=limit, seed=seed, progress=track("resets"))
    out.print_json(json.dumps(report))
    save_json(json_file, report)


@bench.command()
def hostile(
    count: Annotated[int, typer.Option(min=0, help="Meshes that are checked and repaired or hulled.")] = 10_000,
    coacd: Annotated[int, typer.Option(min=0, help="Meshes that are decomposed.")] = 1000,
    workers: Annotated[int, typer.Option(min=1, help="Number of processes.")] = 1,
    json_file: JsonFile = None,
    resume: Annotated[bool, typer.Option("--resume", help="Keep what the --json file has of the same seed.")] = False,
    seed: Seed = 0,
) -> None:
    """Broken meshes through checks, repair and CoACD: exit status 1 if any crashed, hung or gave something invalid."""
    from gfp_grasp.bench import HostileConfig, bench_hostile

    known = read_json(json_file) if resume else None
    report = bench_hostile(
        config=HostileConfig(count, coacd, seed),
        known=known,
        workers=workers,
        progress=track("meshes"),
        save=lambda so_far: save_json(json_file, so_far),
    )
    save_json(json_file, report)
    rows, bad = report["rows"], report["bad"]
    for step, kinds in rows.items():
        told = [(kind, ", ".join(f"{name} {n}" for name, n in sorted(of.items()))) for kind, of in kinds.items()]
        table(("kind", "outcomes"), told, title=str(step), words=2)
    out.print(", ".join(f"{name} {n}" for name, n in bad.items()))
    if any(bad.values()):
        raise typer.Exit(1)


def _part_figures(row: Mapping) -> tuple[str, ...]:
    counts = (str(row["objects"]), str(row["failed"]))
    if "ms" not in row:
        return ("-",) * 7 + counts
    steps = "-" if row["steps_per_s"] is None else f"{row['steps_per_s']:.0f}"
    mean, high = (f"{error:.2f}" for error in row["error_mm"])
    return (
        f"{row['ms']:.1f}",
        f"{row['parts']:.0f}",
        f"{row['vertices']:.0f}",
        mean,
        high,
        f"{row['iou']:.3f}",
        steps,
        *counts,
    )
