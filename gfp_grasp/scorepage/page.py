"""The page of a score, with its pictures beside it. It asks nothing of any network."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from gfp_grasp import __version__
from gfp_grasp.errors import CannotWrite
from gfp_grasp.journal import write_whole
from gfp_grasp.primitives import list_primitives
from gfp_grasp.report import Report
from gfp_grasp.scorepage.failures import Exhibit, choose_failures
from gfp_grasp.scorepage.sections import charts_section, failures_section, figures_section, settings_section
from gfp_grasp.scorepage.words import escaped

Progress = Callable[[Iterable[Any], int], Iterable[Any]]
FILE, FIGURES = "index.html", "score.json"


def prepare_folder(directory: str | Path) -> Path:
    """Make the folder of a page and see that it can be written, before anything is scored for it.

    Raises:
        CannotWrite: It cannot.
    """
    directory = Path(directory)
    probe = directory / f".{FILE}.probe"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise CannotWrite(
            f"no page can be written to {directory.name or directory} ({error.strerror or error}): name a folder that "
            "can be made or written"
        ) from error
    return directory


def write_score_page(
    report: Report,
    directory: str | Path,
    *,
    objects: str | Path,
    split: str | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write index.html with its pictures, and score.json beside it.

    Failures that are worth a look (`gfp_grasp.scorepage.failures.RULE`) are made again from their seeds, which takes
    some seconds each.

    Args:
        report: What `gfp_grasp.score.score` returned.
        directory: Made if it is not there.
        objects: What was scored, as `score` took it.
        split: Of procedural families; None is the report's.
        progress: Wraps the stream of failures, told how many there will be.

    Returns:
        The page.

    Raises:
        CannotWrite: The folder, or a file in it.
        InvalidOption: The objects are not those of the report.
    """
    folder = prepare_folder(directory)
    report.write(folder / FIGURES)
    exhibits: tuple[Exhibit, ...] = ()
    chosen = choose_failures(report)
    if chosen:
        from gfp_grasp.scorepage.gallery import make_exhibits  # loads the simulator

        split = str(report.settings["split"]) if split is None else split
        exhibits = make_exhibits(chosen, report, folder, objects=objects, split=split, progress=progress)
    write_whole(folder / FILE, _page(report, exhibits, command=_command(report.settings, folder.resolve().name)))
    return folder / FILE


def _page(report: Report, exhibits: Sequence[Exhibit], *, command: str) -> str:
    own, settings = files("gfp_grasp"), report.settings
    css = "".join(own.joinpath(room, "page.css").read_text(encoding="utf-8") for room in ("demo", "scorepage"))
    objects = escaped(settings["objects"]).replace(",", ", ")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">
<title>gfp_grasp: what completions are worth</title>
<style>
{css}</style>
</head>
<body>
<main>
<h1>What completions are worth to a gripper</h1>
<p class="lead">Objects: {escaped(settings["num_objects"])} of {objects}. Views of each: {escaped(settings["views"])}.
Each row completes the same single views; the best grasp planned on its completion was tried in MuJoCo, on the true
object and on the completion itself.</p>
{charts_section(report)}
{failures_section(report, exhibits)}
{figures_section(report, link=FIGURES)}
{settings_section(settings, command=command)}
<footer>
<p>Made by gfp_grasp {escaped(__version__)}. Files and folders of objects go by their names alone: run the command where
they lie. One attempt is made again by <code>GfpGraspEnv(objects=..., completer=...)</code> and
<code>reset(seed=..., options={{"object": number}})</code>, with the seed shown beside it and the object's number in
<code>env.sources</code>.</p>
</footer>
</main>
</body>
</html>
"""


def _command(settings: Mapping[str, Any], directory: str) -> str:
    """That makes the page again, in the folder where the objects lie."""
    words = [
        "gfp-grasp",
        "score",
        "--objects",
        str(settings["objects"]),
        "--completers",
        ",".join(settings["completers"]),
    ]
    for name in ("views", "grasps", "seed", "split", "clutter"):
        words += [f"--{name}", str(settings[name])] if name in settings else []
    met = settings["num_objects"] + len(settings.get("ungraspable", ()))  # the limit counts what is left out, too
    words += ["--limit", str(met)]
    if set(settings["classes"]) != {*list_primitives(), ""}:
        words += ["--classes", ",".join(settings["classes"])]
    return shlex.join([*words, "--report", directory])
