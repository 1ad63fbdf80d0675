"""The demonstration from beginning to end."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from gfp_grasp.captures import read_capture
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.demo.demo_scene import (
    CLUTTER,
    ROOM,
    SINGLE,
    DemoScene,
    pick_objects,
)
from gfp_grasp.demo.jobs import EYES, recorded_scene, simulated_scene
from gfp_grasp.demo.page import write_page
from gfp_grasp.demo.room import room_scene
from gfp_grasp.demo.street import street_scene

STREET = "street"  # the scan that ships
Job = Callable[[], DemoScene]


def run_demo(
    out: Path,
    *,
    recordings: tuple[Path, ...] = (),
    street: bool = False,
    category: str | None = None,
    config: CompleteConfig | None = None,
    seed: int = 0,
    console: Console | None = None,
) -> tuple[DemoScene, ...]:
    """Show what the package does, on its own scenes or on a user's recordings.

    Args:
        out: Folder to write; index.html shows all of it.
        recordings: Clouds or captures, see captures.read_capture; none shows a clutter, a single object and a room.
        street: Recordings are whole LiDAR scans; without any, the street that ships is shown alone.
        category: Class of the recordings' objects; None lets the classifier choose.
        config: Switches of the completion, the library of classes among them.
        seed: Seed of every random choice.
        console: Console for tables and progress; None says nothing.

    Returns:
        The scenes of the page.

    Raises:
        GfpGraspError: A recording cannot be read, or nothing in it can be completed.
    """
    console = console or Console(quiet=True)
    start = time.perf_counter()
    if street:
        jobs = _street_jobs(recordings or (Path(STREET),), out, config, seed)
    else:
        jobs = _recorded_jobs(recordings, out, category, config, seed) or _simulated_jobs(out, config, seed)
    scenes, notes = [], []
    for name, job in jobs:
        with console.status(f"{name} ..."), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            scenes.append(job())
        notes += [f"{name}: {warning.message}" for warning in caught if warning.category is UserWarning]
        console.print(_table(scenes[-1]))
    for note in notes:
        console.print(f"note: {note}", style="yellow", markup=False)
    command = (
        "gfp-grasp demo"
        + " --street" * street
        + "".join(f" --capture {path.name}" for path in recordings)
        + f" --seed {seed}"
    )
    out.mkdir(parents=True, exist_ok=True)
    (out / "index.html").write_text(write_page(scenes, command=command, notes=notes), encoding="utf-8")
    console.print(f"{time.perf_counter() - start:.0f} s; open {out / 'index.html'}", markup=False)
    return tuple(scenes)


def _simulated_jobs(out: Path, config: CompleteConfig | None, seed: int) -> list[tuple[str, Job]]:
    clutter = partial(
        simulated_scene,
        "A clutter of four",
        "Four objects that no training has met, seen once through a simulated depth camera with its noise.",
        pick_objects(CLUTTER, seed=seed),
        eye=EYES["clutter"],
        folder=out / "clutter",
        config=config,
        seed=seed,
    )
    single = partial(
        simulated_scene,
        "A single mug",
        "A mug that no training has met either. The camera sees one side of it.",
        pick_objects(SINGLE, seed=seed),
        eye=EYES["single"],
        folder=out / "single",
        config=config,
        seed=seed,
    )
    room = partial(
        room_scene,
        "A room",
        "A table with five objects in a room: the floor and a second table are in view. The picture becomes one scene, "
        "which stands in MuJoCo.",
        pick_objects(ROOM, seed=seed),
        folder=out / "room",
        config=config,
        seed=seed,
    )
    return [("a clutter of four", clutter), ("a single mug", single), ("a room", room)]


def _recorded_jobs(
    recordings: tuple[Path, ...], out: Path, category: str | None, config: CompleteConfig | None, seed: int
) -> list[tuple[str, Job]]:
    captures = [(read_capture(path), path) for path in recordings]
    scene = partial(recorded_scene, category=category, config=config, seed=seed)
    return [(capture.name, partial(scene, capture, folder=out / path.stem)) for capture, path in captures]


def _street_jobs(scans: tuple[Path, ...], out: Path, config: CompleteConfig | None, seed: int) -> list[tuple[str, Job]]:
    captures = [(read_capture(path), path) for path in scans]
    captures = [(replace(one, name="A street") if str(path) == STREET else one, path) for one, path in captures]
    scene = partial(street_scene, config=config, seed=seed)
    return [(capture.name, partial(scene, capture, folder=out / path.stem)) for capture, path in captures]


def _table(scene: DemoScene) -> Table:
    table = Table(title=scene.title, title_justify="left", header_style="bold", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    columns = scene.columns
    for heading in columns.headings:
        table.add_column(heading, justify="left" if heading in columns.words else "right")
    for item in scene.items:
        cells = list(columns.row(item))
        if item.outcome is not None:
            colour, place = "green" if item.outcome.success else "red", columns.headings.index("best grasp")
            cells[place] = f"[{colour}]{cells[place]}[/]"
        table.add_row(*cells)
    return table
