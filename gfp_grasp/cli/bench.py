"""`gfp-grasp bench`: what is found, fitted and completed, against the truth."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.terminal import (
    Gps,
    JsonFile,
    Limit,
    LimitOfEach,
    Most,
    Objects,
    Ray,
    Seed,
    Split,
    Workers,
    err,
    gps_option,
    out,
    read_json,
    save_json,
    table,
    track,
)
from gfp_grasp.errors import InvalidOption

bench = typer.Typer(
    name="bench", help="Measure detection, registration, completion, collision parts, trials.", no_args_is_help=True
)


@bench.command()
def completion(
    objects: Objects,
    methods: Annotated[str, typer.Option(help="Names with commas between; brief; or all.")] = "brief",
    views: Annotated[int, typer.Option(min=1, help="Views of each object.")] = 16,
    split: Split = "test",
    limit: Limit = None,
    given: Annotated[bool, typer.Option("--given-category", help="Tell the methods the true class.")] = False,
    noise_m: Annotated[float, typer.Option(min=0.0, help="Standard deviation of the depth noise.")] = 0.001,
    protocol: Annotated[str, typer.Option(help="standard, noisy, fallen, hidden or lidar.")] = "standard",
    folders: Gps = None,
    workers: Workers = 1,
    ray: Ray = None,
    json_file: JsonFile = None,
    picture: Annotated[Path | None, typer.Option(dir_okay=False, help="Draw the rows to this .svg file.")] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Keep what the --json file has of the same settings.")
    ] = False,
    seed: Seed = 0,
) -> None:
    """Completions against the truth, on random views."""
    from gfp_grasp.bench import BRIEF, METHODS, CompletionConfig, bench_completion
    from gfp_grasp.drawing import write_bars

    named = {"all": METHODS, "brief": BRIEF}
    chosen = named[methods] if methods in named else tuple(methods.split(","))
    config = CompletionConfig(views, seed, split, limit, given, noise_m, protocol, gps_option(folders))
    known = read_json(json_file) if resume else None
    report = bench_completion(
        objects, methods=chosen, config=config, known=known, workers=workers, ray=ray, progress=track("views")
    )
    near = "F at 50 mm" if protocol == "lidar" else "F at 5 mm"
    for category, figures in report["rows"].items():
        table(
            ("method", "CD, mm", near, "IoU", "size", "ms", "views", "failed"),
            [(name, *_figures(row)) for name, row in figures.items()],
            title=str(category),
        )
    gains = [
        (category, name, *gain_cells(figures))
        for category, methods_of in report["paired"].items()
        for name, figures in methods_of.items()
        if figures["pairs"]
    ]
    if gains:
        headings = ("class", "method", "gain, mm", "95 % interval", "gain", "views won")
        table(headings, gains, title="against the same fit undeformed", words=2)
    if picture is not None:
        write_bars(report["rows"], picture, title=f"Completion, {protocol} views")
    save_json(json_file, report)


@bench.command()
def primitives(
    data: Annotated[
        list[Path] | None,
        typer.Option(
            exists=True, file_okay=False, help="Folder of meshes <class>__<name>; may be given several times."
        ),
    ] = None,
    folders: Gps = None,
    workers: Workers = 1,
    json_file: JsonFile = None,
    pictures: Annotated[
        Path | None, typer.Option(exists=True, file_okay=False, help="Write primitives.png and modes.png there.")
    ] = None,
) -> None:
    """What each primitive costs and explains, and how near its modes come to whole real meshes."""
    from gfp_grasp.bench import bench_primitives
    from gfp_grasp.drawing import draw_modes, draw_primitives
    from gfp_grasp.primitives import PrimitiveLibrary

    library = PrimitiveLibrary.with_shipped(*(folders or []))
    report = bench_primitives(data or (), library=library, workers=workers, progress=track("meshes"))
    headings = ("primitive", "vertices", "modes", "variance", "held out, mm", "%", "drawn, mm", "parts", "off, mm", "s")
    table(headings, [(name, *_primitive_figures(row)) for name, row in report["rows"].items()])
    if report["fits"]:
        fits = [
            (f["mesh"], f["primitive"], *(f"{f[key]:.2f}" for key in ("length_m", "error_mm", "error_percent")))
            for f in report["fits"]
        ]
        table(("mesh", "primitive", "length, m", "off, mm", "%"), fits, words=2)
    if pictures is not None:
        draw_primitives(library, pictures / "primitives.png")
        draw_modes(library, pictures / "modes.png")
    save_json(json_file, report)


def _primitive_figures(row: Mapping) -> tuple[str, ...]:
    """Cells of one primitive; a figure that its card lacks is a dash."""
    forms = {
        "vertices": "d", "modes": "d", "variance_kept": ".2f", "generalization_mm": ".2f",
        "generalization_percent": ".2f", "specificity_mm": ".1f", "parts": "d",
    }  # fmt: skip
    cells = [format(row[key], form) if row[key] is not None else "-" for key, form in forms.items()]
    off = row["parts_error_mm"]
    return (*cells, "-" if off is None else f"{off[0]:.2f}", "-" if row["build_s"] is None else str(row["build_s"]))


@bench.command()
def registration(
    starts: Annotated[
        str, typer.Option(help="Some of proposal, box, pcrnet, with commas between.")
    ] = "proposal,box,pcrnet",
    views: Annotated[int, typer.Option(min=1, help="Views of each object.")] = 4,
    limit: LimitOfEach = None,
    mean_size: Annotated[bool, typer.Option("--mean-size", help="Starts have the mean size.")] = False,
    workers: Workers = 1,
    json_file: JsonFile = None,
    seed: Seed = 0,
) -> None:
    """Pose, size and shape of fits against the truth, with PCRNet's start and without."""
    from gfp_grasp.bench import RegistrationConfig, bench_registration

    config = RegistrationConfig(views, limit, seed, mean_size)
    chosen = tuple(starts.split(","))
    report = bench_registration(starts=chosen, config=config, workers=workers, progress=track("shapes"))
    rows = report["rows"]
    headings = ("class", "start", "axis, deg", "yaw, deg", "middle, mm", "size", "CD, mm", "wrong rest", "ms", "failed")
    table(headings, [(c, s, *_fit_figures(row)) for c, figures in rows.items() for s, row in figures.items()], words=2)
    save_json(json_file, report)


@bench.command()
def detection(
    data: Annotated[Path | None, typer.Option(help="Folder with captures/, for real tables.")] = None,
    views: Annotated[int, typer.Option(min=1, help="Views of each procedural shape.")] = 4,
    pictures: Annotated[
        Path | None, typer.Option(dir_okay=False, help="Paint what is found in captures/room_*.npz into this file.")
    ] = None,
    confusion: Annotated[
        Path | None, typer.Option(dir_okay=False, help="Draw which class is named for which into this .svg file.")
    ] = None,
    workers: Workers = 1,
    json_file: JsonFile = None,
) -> None:
    """Objects found on tables, in clutter and in rooms by every detector, and classes told apart."""
    from gfp_grasp.bench import bench_detection, paint_rooms

    if data is not None and not (data / "captures").is_dir():
        raise InvalidOption(f"--data is {data}; a folder with captures/ in it is expected")
    if pictures is not None and data is None:
        raise InvalidOption("--pictures paints captures of the folder --data, which is missing")
    with err.status("detecting ..."):
        report = bench_detection(data, num_views=views, workers=workers)
        if data is not None and pictures is not None:
            paint_rooms(data, pictures)
    if confusion is not None:
        from gfp_grasp.drawing import write_confusion

        found = report["procedural_test"]
        title = f"Class named, of {found['views']} views of the test split where one answer is right"
        write_confusion(found["confusion_rows_true"], found["columns_named"], confusion, title=title)
    out.print_json(json.dumps(report))
    save_json(json_file, report)


@bench.command()
def openset(
    members: Annotated[int, typer.Option(min=1, help="Objects of each household class.")] = 8,
    mixtures: Annotated[int, typer.Option(min=1, help="Things of each kind that is of no class.")] = 24,
    picture: Annotated[
        Path | None, typer.Option(dir_okay=False, help="Draw the operating curve to this .svg file.")
    ] = None,
    workers: Workers = 1,
    json_file: JsonFile = None,
) -> None:
    """Things of classes and of none told apart: the operating curve, and how near to the truth the answers come."""
    from gfp_grasp.bench import bench_openset
    from gfp_grasp.drawing import write_operating_curve
    from gfp_grasp.train import OpenSetConfig

    report = bench_openset(config=OpenSetConfig(members, mixtures), workers=workers, progress=track("things"))
    for views, rows in report["rows"].items():
        headings = ("things", "views", "unknown", "class, mm", "class-free, mm", "answer, mm", "hull, mm")
        cells = [
            (
                sort,
                str(row["views"]),
                f"{row['unknown']:.1%}",
                *(_of_hull(row[k]) for k in ("class", "classfree", "answer", "hull")),
            )
            for sort, row in rows.items()
        ]
        table(headings, cells, title=f"{views} views")
    if picture is not None:
        write_operating_curve(report["curve"], report["threshold"], picture)
    save_json(json_file, report)


def _of_hull(figures: Mapping) -> str:
    return f"{1000 * figures['cd_m']:.2f} ({figures['of_hull']:.2f})"


@bench.command()
def speed(
    objects: Objects = "all",
    limit: Most = 30,
    calls: Annotated[int, typer.Option(min=0, help="Completions that memory is watched over.")] = 0,
    json_file: JsonFile = None,
    seed: Seed = 0,
) -> None:
    """Milliseconds by stage, registrations beside each other, and memory over many calls."""
    from gfp_grasp.bench import bench_speed

    report = bench_speed(objects, limit=limit, calls=calls, seed=seed, progress=track("clouds"))
    out.print_json(json.dumps(report))
    save_json(json_file, report)


@bench.command()
def stability(
    objects: Objects = "all",
    motions: Annotated[int, typer.Option(min=1, help="Rigid motions about up, in all.")] = 200,
    limit: Most = 20,
    workers: Workers = 1,
    json_file: JsonFile = None,
    seed: Seed = 0,
) -> None:
    """The same call twice, and clouds that were moved."""
    from gfp_grasp.bench import bench_stability

    report = bench_stability(
        objects, motions=motions, limit=limit, seed=seed, workers=workers, progress=track("objects")
    )
    out.print_json(json.dumps(report))
    save_json(json_file, report)


def _figures(row: Mapping) -> tuple[str, ...]:
    def text(key: str, style: str, factor: float = 1.0) -> str:
        return "" if row.get(key) is None else format(factor * row[key], style)

    errors = (text("cd_m", ".2f", 1000), text("f_score", ".3f"), text("iou", ".3f"), text("scale_error_median", ".1%"))
    return (*errors, text("ms", ".0f"), str(row["views"]), str(row["failed"]))


def gain_cells(paired: Mapping) -> tuple[str, ...]:
    """A paired gain in mm, its interval, its share and the share of views won."""
    low, high = (1000 * end for end in paired["ci95_m"])
    interval = f"{low:.3f} to {high:.3f}"
    return f"{1000 * paired['gain_m']:.3f}", interval, f"{paired['gain_share']:.1%}", f"{paired['wins']:.0%}"


def _fit_figures(row: Mapping) -> tuple[str, ...]:
    def text(key: str, style: str, factor: float = 1.0) -> str:
        return "" if row[key] is None else format(factor * row[key], style)

    degrees, millimetres = (text("axis_deg", ".1f"), text("yaw_deg", ".1f")), text("offset_m", ".1f", 1000)
    rest = (text("size", ".1%"), text("cd_m", ".1f", 1000), text("wrong_rest", ".0%"), text("ms", ".0f"))
    return (*degrees, millimetres, *rest, f"{row['failed']} of {row['views']}")
