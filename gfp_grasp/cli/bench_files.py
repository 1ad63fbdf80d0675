"""`gfp-grasp bench` over files that others made: scans of traffic with boxes, and scores that stand side by side."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.bench_physics import bench
from gfp_grasp.cli.terminal import JsonFile, Limit, Workers, save_json, table, track
from gfp_grasp.errors import InvalidOption


@bench.command()
def kitti(
    data: Annotated[Path, typer.Option(help="KITTI's object or tracking layout, or .npz files of scans and tracks.")],
    rows: Annotated[str | None, typer.Option(help="Methods, with commas between; left out, all.")] = None,
    frames: Annotated[int, typer.Option(min=2, help="Consecutive scans of each track.")] = 12,
    limit: Limit = None,
    shapes: Annotated[
        Path | None,
        typer.Option(help="Whole shapes that MMD looks among: ModelNet40, or meshes; left out, procedural ones."),
    ] = None,
    workers: Workers = 1,
    json_file: JsonFile = None,
) -> None:
    """Things of traffic found in scans and completed, measured as papers on KITTI measure them."""
    from gfp_grasp.bench import KittiConfig, bench_kitti

    config = KittiConfig(frames=frames, limit=limit, shapes=shapes)
    if rows:
        config = replace(config, rows=tuple(rows.split(",")))
    report = bench_kitti(data, config=config, workers=workers, progress=track("things"))
    kitti_table(report["rows"])
    cells = [
        (name, title, *(str(row.get(key, "-")) for key in ("things", "recall_0.5", "precision_0.5", "recall_0.7")))
        for name, ranges in report.get("detection", {}).items()
        for title, row in ranges.items()
        if row["things"]
    ]
    if cells:
        table(
            ("class", "distance", "things", "recall, IoU 0.5", "precision", "recall, IoU 0.7"), cells, title="detection"
        )
    save_json(json_file, report)


@bench.command()
def study(
    scores: Annotated[
        list[str], typer.Argument(help="JSON of gfp-grasp score, one FILE or NAME=FILE for each set of objects.")
    ],
    json_file: JsonFile = None,
    picture: Annotated[Path | None, typer.Option(dir_okay=False, help="Draw the margins to this .svg file.")] = None,
) -> None:
    """What completion is worth: scores of several sets of objects side by side, and all of them together."""
    from gfp_grasp.drawing import write_margins
    from gfp_grasp.score import study as side_by_side

    named = [score.partition("=") for score in scores]
    sets = {name if file else Path(name).stem: file or name for name, _, file in named}
    if len(sets) < len(scores):
        raise InvalidOption(f"{len(scores)} scores have {len(sets)} names: give each one of its own, as NAME=FILE")
    report = side_by_side(sets)
    rivals = ("oracle", "gfpnet")
    for name, found in report["sets"].items():
        cells = [
            (
                method,
                f"{figures['successes']}/{figures['attempts']}",
                f"{figures['margin']:.2f} ({figures['margin_ci95'][0]:.2f} to {figures['margin_ci95'][1]:.2f})",
                *(margin_gain(found["paired"][method].get(other)) for other in rivals),
                ", ".join(f"{reason} {count}" for reason, count in found["broken_promises"][method].items()) or "-",
            )
            for method, figures in found["completers"].items()
        ]
        beside = (f"less {other}'s" for other in rivals)
        table(("completer", "held", "margin", *beside, "held in the completed world alone"), cells, title=name)
    if picture is not None:
        write_margins({name: found["completers"] for name, found in report["sets"].items()}, picture)
    save_json(json_file, report)


def kitti_table(rows: Mapping[str, Mapping]) -> None:
    """Print what is completed of KITTI's scans."""
    headings = ("method", "things", "refused", "class right", "size", "fidelity, m", "MMD, m", "consistency, m", "s")
    names = ("things", "refused", "class_right", "size_error", "fidelity_m", "mmd_m", "consistency_m", "seconds")
    table(headings, [(name, *(str(row.get(key, "-")) for key in names)) for name, row in rows.items()])


def margin_gain(pair: Mapping | None) -> str:
    """A pair's difference in margin with its interval; a dash for a method beside itself."""
    if pair is None:
        return "-"
    return f"{pair['margin']:+.2f} ({pair['margin_ci95'][0]:+.2f} to {pair['margin_ci95'][1]:+.2f})"
