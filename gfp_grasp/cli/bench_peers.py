"""`gfp-grasp bench peers`: the package beside other completion networks."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.bench import gain_cells
from gfp_grasp.cli.bench_files import bench, kitti_table, margin_gain
from gfp_grasp.cli.terminal import JsonFile, Seed, Workers, err, read_json, save_json, table, track
from gfp_grasp.errors import InvalidOption

_OURS = "gfpnet"


@bench.command()
def peers(
    data: Annotated[
        Path | None, typer.Option(help="Folder of meshes <class>__<name>, in place of the procedural test split.")
    ] = None,
    kitti: Annotated[Path | None, typer.Option(help="Scans of KITTI, as bench kitti takes them.")] = None,
    views: Annotated[int, typer.Option(min=1, help="Views of each object.")] = 1,
    limit: Annotated[int, typer.Option(min=1, help="Most objects of each group; families take turns.")] = 60,
    names: Annotated[
        str | None, typer.Option("--peers", help="Peers, with commas between; left out, all that are trained.")
    ] = None,
    no_score: Annotated[bool, typer.Option("--no-score", help="Try no grasps.")] = False,
    json_file: JsonFile = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Keep what the --json file has of the same settings.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(dir_okay=False, help="Draw distances by class and by what is hidden to this .svg.")
    ] = None,
    shapes: Annotated[
        Path | None, typer.Option(dir_okay=False, help="Draw what each makes of one view of each group to this .png.")
    ] = None,
    workers: Workers = 1,
    seed: Seed = 0,
) -> None:
    """Other completion networks beside gfpnet: by class, by what is hidden, in cost, in grasps and on KITTI.

    Every peer is measured around what was seen, as a robot has it, and told the true box, as its paper has it. One
    whose weights are not there is left out, with a note. With --json, what is finished is in that file after each part,
    and --resume goes on from it: peers that were trained since are added, what came of other weights, primitives,
    meshes or scans is made again, and parts that are not asked for stay as they are.
    """
    from gfp_grasp.bench import PeersConfig, bench_peers, shapes_of_peers
    from gfp_grasp.drawing import draw_completions, write_peers
    from gfp_grasp.peers import PEERS

    if resume and json_file is None:
        raise InvalidOption("--resume goes on from the file of --json, which is missing")
    chosen = tuple(PEERS) if names is None else tuple(name.strip() for name in names.split(","))
    config = PeersConfig(chosen, views, limit, seed, data, kitti, with_score=not no_score)
    journals = None if json_file is None else json_file.with_name(f"{json_file.stem}.part")
    known = read_json(json_file) if resume else None
    if not resume:
        _remove(journals)
    report = bench_peers(
        config=config,
        known=known,
        workers=workers,
        progress=track,
        save=lambda so_far: save_json(json_file, so_far),
        journals=journals,
    )
    for left_out in report["left_out"]:
        err.print(f"note: {left_out['method']} is left out: {left_out['why']}", highlight=False, soft_wrap=True)
    for group, figures in report["groups"].items():
        headings = ("method", "CD, mm", "F", "ms", "failed", f"{_OURS} nearer by, mm", "95 % interval", "share", "won")
        paired = report["paired"][group]
        table(headings, [(name, *_cells(row, paired.get(name))) for name, row in figures.items()], title=group)
    if report["occlusion"]:
        _print_occlusion(report["occlusion"])
    if report["kitti"]:
        kitti_table(report["kitti"])
    if report["score"]:
        _print_score(report["score"])
    _print_cost(report["cost"])
    if picture is not None:
        write_peers(report["groups"], report["occlusion"], picture)
    if shapes is not None:
        draw_completions(shapes_of_peers(config), shapes)
    save_json(json_file, report)
    _remove(journals)


def _remove(journals: Path | None) -> None:
    """Remove the trials of grasps that a run wrote as they came, and their folder if there is nothing else in it."""
    if journals is not None and journals.is_dir():
        for journal in journals.glob("*.jsonl"):
            journal.unlink()
        with suppress(OSError):
            journals.rmdir()


def _cells(row: Mapping, paired: Mapping | None) -> tuple[str, ...]:
    gain = gain_cells(paired) if paired and paired["pairs"] else ("",) * 4
    return (_mm(row), f"{row['f_score']:.3f}", f"{row['ms']:.0f}", f"{row['failed']} of {row['views']}", *gain)


def _print_occlusion(occlusion: Mapping[str, Mapping]) -> None:
    methods = next(iter(occlusion.values()))
    cells = [(name, *(_mm(figures[name]) for figures in occlusion.values())) for name in methods]
    table(("CD, mm", *(f"{float(share):.0%}" for share in occlusion)), cells, title="hidden share of the object")


def _print_score(found: Mapping[str, Mapping]) -> None:
    beside = ("observed", _OURS, "oracle")
    cells = [
        (
            name,
            f"{row['successes']}/{row['attempts']}",
            f"{row['margin']:.2f} ({row['margin_ci95'][0]:.2f} to {row['margin_ci95'][1]:.2f})",
            *(margin_gain(found["paired"][name].get(other)) for other in beside),
        )
        for name, row in found["completers"].items()
    ]
    table(("completer", "held", "margin", *(f"less {other}'s" for other in beside)), cells, title="grasps")


def _print_cost(cost: Mapping[str, Mapping]) -> None:
    headings = ("method", "ms", "first, ms", "memory, MB", "weights, MB", "parameters", "primitives, MB")
    keys = ("ms", "first_ms", "memory_mb", "weights_mb", "parameters", "primitives_mb")
    cells = [(name, *("-" if row.get(key) is None else str(row[key]) for key in keys)) for name, row in cost.items()]
    table(headings, cells, title="one completion on one core")


def _mm(row: Mapping) -> str:
    return "-" if row["cd_m"] is None else f"{1000 * row['cd_m']:.2f}"
