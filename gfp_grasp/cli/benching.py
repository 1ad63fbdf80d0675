"""`gfp-grasp bench`: the figures of the README, measured."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.terminal import JsonFile, Limit, Objects, Seed, Split, Workers, err, out, save_json, table, track
from gfp_grasp.errors import InvalidOption

bench = typer.Typer(name="bench", help="Measure detection, registration and completion.", no_args_is_help=True)


@bench.command()
def completion(
    objects: Objects,
    methods: Annotated[str | None, typer.Option(help="Names with commas between; left out, all.")] = None,
    views: Annotated[int, typer.Option(min=1, help="Of each object.")] = 16,
    split: Split = "test",
    limit: Limit = None,
    given: Annotated[bool, typer.Option("--given-category", help="Tell the methods the true class.")] = False,
    noise_m: Annotated[float, typer.Option(min=0.0, help="Standard deviation of the depth noise.")] = 0.001,
    workers: Workers = 1,
    json_file: JsonFile = None,
    seed: Seed = 0,
) -> None:
    """Chamfer distance and F-score of completions against the truth, on random views."""
    from gfp_grasp.bench.completion import METHODS, CompletionBench, bench_completion

    chosen = tuple(methods.split(",")) if methods else METHODS
    config = CompletionBench(views, seed, split, limit, given, noise_m)
    report = bench_completion(objects, methods=chosen, config=config, workers=workers, progress=track("views"))
    rows = report["rows"]
    assert isinstance(rows, Mapping)
    for category, figures in rows.items():
        table(
            ("method", "CD, mm", "F at 5 mm", "ms", "views", "failed"),
            [(name, *_figures(row)) for name, row in figures.items()],
            title=str(category),
        )
    paired = report["paired"]
    assert isinstance(paired, Mapping)
    gains = [
        (category, name, *_gain(figures))
        for category, methods_of in paired.items()
        for name, figures in methods_of.items()
        if figures["pairs"]
    ]
    if gains:
        headings = ("class", "method", "gain, mm", "95 % interval", "gain", "views won")
        table(headings, gains, title="against the same fit undeformed", words=2)
    save_json(json_file, report)


@bench.command()
def detection(
    data: Annotated[Path | None, typer.Option(help="Folder with captures/, for real tables.")] = None,
    views: Annotated[int, typer.Option(min=1, help="Of each procedural shape.")] = 4,
    workers: Workers = 1,
    json_file: JsonFile = None,
) -> None:
    """Objects found on tables, and classes told apart."""
    from gfp_grasp.bench.detection import measure

    if data is not None and not (data / "captures").is_dir():
        raise InvalidOption(f"--data is {data}; a folder with captures/ in it is expected")
    with err.status("detecting ..."):
        report = measure(data, num_views=views, workers=workers)
    out.print_json(json.dumps(report))
    save_json(json_file, report)


@bench.command()
def registration(
    starts: Annotated[str, typer.Option(help="box, pcrnet, or both with a comma between.")] = "box,pcrnet",
    views: Annotated[int, typer.Option(min=1, help="Of each object.")] = 4,
    limit: Limit = None,
    mean_size: Annotated[bool, typer.Option("--mean-size", help="Starts have the mean size.")] = False,
    workers: Workers = 1,
    json_file: JsonFile = None,
    seed: Seed = 0,
) -> None:
    """Pose, size and shape of fits against the truth, with PCRNet's start and without."""
    from gfp_grasp.bench.registration import RegistrationBench, bench_registration

    config = RegistrationBench(views, limit, seed, mean_size)
    chosen = tuple(starts.split(","))
    report = bench_registration(starts=chosen, config=config, workers=workers, progress=track("shapes"))
    rows = report["rows"]
    assert isinstance(rows, Mapping)
    headings = ("class", "start", "axis, deg", "yaw, deg", "middle, mm", "size", "CD, mm", "wrong rest", "ms", "failed")
    table(headings, [(c, s, *_fit_figures(row)) for c, figures in rows.items() for s, row in figures.items()], words=2)
    save_json(json_file, report)


def _fit_figures(row: Mapping) -> tuple[str, ...]:
    def text(key: str, style: str, factor: float = 1.0) -> str:
        return "" if row[key] is None else format(factor * row[key], style)

    degrees, millimetres = (text("axis_deg", ".1f"), text("yaw_deg", ".1f")), text("offset_m", ".1f", 1000)
    rest = (text("size", ".1%"), text("cd_m", ".1f", 1000), text("wrong_rest", ".0%"), text("ms", ".0f"))
    return (*degrees, millimetres, *rest, f"{row['failed']} of {row['views']}")


def _gain(paired: Mapping) -> tuple[str, ...]:
    low, high = (1000 * end for end in paired["ci95_m"])
    interval = f"{low:.3f} to {high:.3f}"
    return f"{1000 * paired['gain_m']:.3f}", interval, f"{paired['gain_share']:.1%}", f"{paired['wins']:.0%}"


def _figures(row: Mapping) -> tuple[str, ...]:
    millimetres = row.get("cd_m")
    cd = "" if millimetres is None else f"{1000 * millimetres:.2f}"
    score, time_ms = row.get("f_score"), row.get("ms")
    return (
        cd,
        "" if score is None else f"{score:.3f}",
        "" if time_ms is None else f"{time_ms:.0f}",
        str(row.get("views", "")),
        str(row.get("failed", "")),
    )
