"""The demonstration from beginning to end."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from gfp_grasp.captures import read_capture
from gfp_grasp.demo.page import write_page
from gfp_grasp.demo.props import CLUTTER, SINGLE, pick_objects
from gfp_grasp.demo.recorded import recorded_story
from gfp_grasp.demo.simulated import EYES, simulated_story
from gfp_grasp.demo.story import HEADINGS, Story, row


def run_demo(
    out: Path,
    *,
    recordings: tuple[Path, ...] = (),
    category: str | None = None,
    seed: int = 0,
    console: Console | None = None,
) -> tuple[Story, ...]:
    """Show what the package does, on its own scenes or on a user's recordings.

    Args:
        out: Folder to write; index.html shows all of it.
        recordings: Clouds or captures, see captures.read_capture; none shows a clutter and a single object.
        category: Of the recordings' objects; None lets the classifier choose.
        seed: Of everything.
        console: Where tables and progress go; None says nothing.

    Returns:
        What is in the page.

    Raises:
        GfpGraspError: A recording cannot be read, or nothing in it can be completed.
    """
    console = console or Console(quiet=True)
    start = time.perf_counter()
    tellers = _recorded(recordings, out, category, seed) if recordings else _simulated(out, seed)
    stories, notes = [], []
    for name, tell in tellers:
        with console.status(f"{name} ..."), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            stories.append(tell())
        notes += [f"{name}: {warning.message}" for warning in caught if warning.category is UserWarning]
        console.print(_table(stories[-1]))
    for note in notes:
        console.print(f"note: {note}", style="yellow", markup=False)
    command = "gfp-grasp demo" + "".join(f" --capture {path.name}" for path in recordings) + f" --seed {seed}"
    out.mkdir(parents=True, exist_ok=True)
    (out / "index.html").write_text(write_page(stories, command=command, notes=notes), encoding="utf-8")
    console.print(f"{time.perf_counter() - start:.0f} s; open {out / 'index.html'}", markup=False)
    return tuple(stories)


def _simulated(out: Path, seed: int) -> list[tuple[str, Callable[[], Story]]]:
    def clutter() -> Story:
        text = "Four objects that no training has met, seen once through a simulated depth camera with its noise."
        sources = pick_objects(CLUTTER, seed=seed)
        return simulated_story(
            "A clutter of four", text, sources, eye=EYES["clutter"], folder=out / "clutter", seed=seed
        )

    def single() -> Story:
        text = "A mug that no training has met either. The camera sees one side of it."
        sources = pick_objects(SINGLE, seed=seed)
        return simulated_story("A single mug", text, sources, eye=EYES["single"], folder=out / "single", seed=seed)

    return [("a clutter of four", clutter), ("a single mug", single)]


def _recorded(
    recordings: tuple[Path, ...], out: Path, category: str | None, seed: int
) -> list[tuple[str, Callable[[], Story]]]:
    captures = [read_capture(path) for path in recordings]
    return [
        (
            capture.name,
            lambda capture=capture, path=path: recorded_story(
                capture, folder=out / path.stem, category=category, seed=seed
            ),
        )
        for capture, path in zip(captures, recordings, strict=True)
    ]


def _table(story: Story) -> Table:
    table = Table(title=story.title, title_justify="left", header_style="bold", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in HEADINGS:
        table.add_column(heading, justify="left" if heading in ("object", "class", "best grasp") else "right")
    for item in story.items:
        colour = "" if item.outcome is None else ("green" if item.outcome.success else "red")
        cells = list(row(item))
        if colour:
            cells[HEADINGS.index("best grasp")] = f"[{colour}]{cells[HEADINGS.index('best grasp')]}[/]"
        table.add_row(*cells)
    return table
