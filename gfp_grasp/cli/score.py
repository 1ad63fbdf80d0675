"""`gfp-grasp score`: what a completer's grasps do to the true object."""

from pathlib import Path
from typing import Annotated, cast

import typer

from gfp_grasp.cli.terminal import (
    Detector,
    Gps,
    JsonFile,
    Limit,
    Objects,
    Ray,
    Seed,
    Split,
    Workers,
    err,
    gps_option,
    out,
    table,
    track,
)

COMPLETERS = "observed,observed/top-down,mirror,gfs,registration,gfpnet-paper,gfpnet,oracle"


def score(
    objects: Objects,
    completers: Annotated[
        str, typer.Option(help="With commas between; your own: module:function; with a planner: gfpnet/top-down.")
    ] = COMPLETERS,
    views: Annotated[int, typer.Option(min=1, help="Views of each object.")] = 4,
    grasps: Annotated[int, typer.Option(min=1, help="So many of the best are tried until one holds.")] = 5,
    split: Split = "test",
    clutter: Annotated[int, typer.Option(min=0, help="So many other objects stand around each.")] = 0,
    limit: Limit = None,
    classes: Annotated[
        str | None, typer.Option(help="Classes of the folder's objects to score, with commas between; * is all.")
    ] = None,
    folders: Gps = None,
    detector: Detector = "tabletop",
    workers: Workers = 1,
    ray: Ray = None,
    json_file: JsonFile = None,
    picture: Annotated[
        Path | None, typer.Option(dir_okay=False, help="Draw the rows between their brackets to this .svg file.")
    ] = None,
    page: Annotated[
        Path | None, typer.Option("--report", help="Folder for a page of charts, failures and figures; index.html.")
    ] = None,
    seed: Seed = 0,
) -> None:
    """Try the best grasp of each completer in the simulator, on the true object and on what was completed.

    `observed` (the hull of the seen points) is the bracket below, `oracle` (the true mesh) the one above.
    With --json, rows are written beside that file as they come: the same command goes on where it was stopped.
    """
    from gfp_grasp.score import FIGURES, ScoreConfig, prepare_folder, write_picture, write_score_page
    from gfp_grasp.score import score as run

    config = ScoreConfig(
        views=views,
        grasps=grasps,
        seed=seed,
        split=split,
        clutter=clutter,
        limit=limit,
        classes=tuple(classes.split(",")) if classes else None,
        gps=gps_option(folders),
        detector=detector,
    )
    if page is not None:
        prepare_folder(page)  # refused now, not after a night's work
        json_file = json_file or page / FIGURES
    journal = None if json_file is None else json_file.with_name(f"{json_file.stem}.part.jsonl")
    names = tuple(name.strip() for name in completers.split(","))
    report = run(objects, names, config=config, workers=workers, ray=ray, journal=journal, progress=track("rows"))
    rows = report.table()
    headings = tuple(rows[0])
    table(headings, [tuple(row.values()) for row in rows])
    for key, why in (("no_grip", "no grasp fits the jaws"), ("too_heavy", "the gripper cannot carry it")):
        if left_out := cast("list[str]", report.settings.get(key)):
            err.print(f"note: left out, for {why}: {', '.join(left_out)}", highlight=False, soft_wrap=True)
    if json_file is not None and journal is not None:
        report.write(json_file)
        journal.unlink(missing_ok=True)
    if picture is not None:
        write_picture(report, picture)
    if page is not None:
        made = write_score_page(report, page, objects=objects, config=config, progress=track("failures"))
        out.print(f"open {made}", markup=False, highlight=False, soft_wrap=True)
