"""`gfp-grasp demo`."""

from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.terminal import Seed, out


def demo(
    folder: Annotated[Path, typer.Option("--out", help="Folder to write; open its index.html.")] = Path("out"),
    cloud: Annotated[list[Path] | None, typer.Option(help="Your own cloud of one object; may be repeated.")] = None,
    capture: Annotated[
        list[Path] | None, typer.Option(help="Your own .npz capture, or sample; may be repeated.")
    ] = None,
    category: Annotated[str | None, typer.Option(help="Class of the object in your recordings.")] = None,
    seed: Seed = 0,
) -> None:
    """Complete and grasp objects of a clutter and a single one, or of your own recordings, and show it in a page."""
    from gfp_grasp.demo import run_demo  # loads simulator and networks, which --help does without

    run_demo(folder, recordings=(*(cloud or ()), *(capture or ())), category=category, seed=seed, console=out)
