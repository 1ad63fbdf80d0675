"""Consoles, progress bars and options that several commands share."""

import json
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from rich.columns import Columns
from rich.console import Console, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from gfp_grasp.errors import InvalidOption
from gfp_grasp.export import SUFFIXES
from gfp_grasp.journal import read_figures, write_whole

Result = TypeVar("Result")
Track = Callable[[Iterable[Result], int], Iterable[Result]]

Seed = Annotated[int, typer.Option(min=0, help="Seed of every random choice; the same seed gives the same answer.")]
Workers = Annotated[int, typer.Option(min=0, help="Number of processes; 0 is one a core.")]
Ray = Annotated[str | None, typer.Option(help="Run on a Ray cluster: auto (this machine's), or host:port of its head.")]
Limit = Annotated[int | None, typer.Option(min=1, help="Most objects; families take turns.")]
LimitOfEach = Annotated[int | None, typer.Option("--limit", min=1, help="Most objects of each class.")]
Most = Annotated[int, typer.Option("--limit", min=1, help="Most objects; families take turns.")]
Split = Annotated[str, typer.Option(help="Split of the procedural families: train, val or test.")]
Objects = Annotated[
    str,
    typer.Option(
        help="Procedural families with commas between, household for all of them, unknown for things of no class; "
        "a mesh file; a folder."
    ),
]
Files = Annotated[bool, typer.Option("--files", help="Write the meshes of .xml to files beside it, not into itself.")]
Gps = Annotated[
    list[Path] | None,
    typer.Option("--gps", help="Folder of primitives of your own (gps build --out); may be given several times."),
]
Detector = Annotated[
    str, typer.Option(help="What finds objects in a picture: votes, tabletop, or your own module:function.")
]
JsonFile = Annotated[Path | None, typer.Option("--json", dir_okay=False, help="Write all figures to this file.")]

out = Console()
if not out.is_terminal:
    out.width = 120  # a file or a log has no width of its own
err = Console(stderr=True)


def say_error(message: str) -> None:
    """One line on stderr."""
    err.print(" ".join(message.split()), style="red", markup=False, highlight=False, soft_wrap=True)


def track(description: str) -> Track:
    """A progress bar on stderr around a stream of results."""

    def wrap(results: Iterable[Result], total: int) -> Iterator[Result]:
        columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
        with Progress(*columns, TimeRemainingColumn(), console=err) as progress:
            task = progress.add_task(description, total=total)
            for result in results:
                progress.advance(task)
                yield result

    return wrap


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], *, title: str = "", words: int = 1) -> None:
    """Print a table whose first `words` columns are words and whose others are figures."""
    made = Table(title=title or None, title_justify="left", header_style="bold")
    for i, heading in enumerate(headings):
        made.add_column(heading, justify="left" if i < words else "right")
    for row in rows:
        made.add_row(*row)
    out.print(made)


@contextmanager
def stages(limit_s: float) -> Iterator[Callable[[str], None]]:
    """A bar on stderr that fills with time, up to a limit, and names the stage that it is told."""
    with Progress(TextColumn("{task.description}"), _TimeBar(), TextColumn(""), console=err) as progress:
        task = progress.add_task("", total=limit_s)
        yield lambda stage: progress.update(task, description=stage)


class _TimeBar(ProgressColumn):
    def render(self, task: Task) -> RenderableType:
        elapsed, limit = task.elapsed or 0.0, task.total or 1.0
        bar = ProgressBar(total=limit, completed=min(elapsed, limit), width=40)
        return Columns([bar, Text(f"{elapsed:.0f} of {limit:g} s")])


def vector(text: str | None, name: str) -> list[float] | None:
    """Three numbers from "x,y,z".

    Raises:
        InvalidOption: Something else.
    """
    if text is None:
        return None
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 3:
        raise InvalidOption(f"--{name} is {text!r}; three numbers are expected, e.g. 0.3,-0.2,0.5")
    return numbers


def direction(unit: Iterable[float]) -> str:
    """A unit vector for a note, to two decimals."""
    return f"({', '.join(f'{round(value, 2) + 0.0:g}' for value in unit)})"


def check_outputs(paths: Sequence[Path]) -> None:
    """Refuse a file that could not be written, before any work is done for it.

    Raises:
        InvalidOption: A path has an unknown suffix, is a folder, or lies in a folder that cannot be written.
    """
    for path in paths:
        if path.suffix.lower() not in SUFFIXES:
            raise InvalidOption(f"{path}: suffix {path.suffix!r} is not among {', '.join(SUFFIXES)}")
        folder = next(parent for parent in path.absolute().parents if parent.exists())
        if path.is_dir() or not folder.is_dir() or not os.access(folder, os.W_OK):
            raise InvalidOption(f"{path} cannot be written: a file in a folder that is yours is expected")


def read_json(path: Path | None) -> dict[str, Any] | None:
    """Figures that a command wrote before; None where it wrote none.

    Raises:
        UnreadableFile: The file holds something else.
    """
    return read_figures(path) if path is not None and path.is_file() else None


def gps_option(folders: Sequence[Path] | None) -> str:
    """Folders of primitives as the environment and the score take them, in one text."""
    return os.pathsep.join(str(folder.resolve()) for folder in folders or ())


def save_json(path: Path | None, content: object) -> None:
    """Write figures to the file that the user named, if any; trials, of which there are many, one a line."""
    if path is None:
        return
    if not isinstance(content, Mapping) or "trials" not in content:
        write_whole(path, json.dumps(content, indent=1) + "\n")
        return
    head = json.dumps({name: value for name, value in content.items() if name != "trials"}, indent=1)
    trials = ",\n".join(json.dumps(trial) for trial in content["trials"])
    write_whole(path, f'{head[:-2]},\n "trials": [\n{trials}\n ]\n}}\n')


@contextmanager
def warnings_as_notes() -> Iterator[None]:
    """Warnings of the work within are printed as notes, one line each, when it is done."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        warnings.simplefilter("always", RuntimeWarning)
        yield
    for warning in caught:
        err.print(f"note: {warning.message}", style="yellow", markup=False, soft_wrap=True)
