"""`gfp-grasp demo` and `gfp-grasp view`: pages that show what the package makes of a picture."""

import webbrowser
from pathlib import Path
from typing import Annotated

import typer

from gfp_grasp.cli.terminal import Seed, err, out
from gfp_grasp.errors import InvalidOption


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


def view(
    capture: Annotated[
        Path | None, typer.Argument(help="Cloud or .npz capture, metres; left out: sample, which ships.")
    ] = None,
    objects: Annotated[
        str | None,
        typer.Option(help="Instead: episodes with a family (cup, mug, bottle; several: cup,mug), mesh file or folder."),
    ] = None,
    category: Annotated[str | None, typer.Option(help="Class of the object in the capture.")] = None,
    host: Annotated[str, typer.Option(help="Address to listen at; 0.0.0.0 lets other machines in.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port, or the next that is free; 0 takes any.")] = 8080,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = False,
    seed: Seed = 0,
) -> None:
    """Serve a page that shows a capture, or episodes of the environment, with all that is made of them."""
    from gfp_grasp.view import view_capture, view_episodes

    if objects is not None and (capture is not None or category is not None):
        raise InvalidOption("--objects draws episodes of its own: give either it, or a capture (and its --category)")
    with err.status("completing and planning ..."):
        if objects is not None:
            viewer = view_episodes(objects, seed=seed, host=host, port=port)
        else:
            viewer = view_capture(capture or "sample", category=category, seed=seed, host=host, port=port)
    with viewer:
        out.print(f"{viewer.url} shows it; Ctrl-C ends", markup=False)
        if browser:
            webbrowser.open(viewer.url)
        try:
            viewer.wait()
        except KeyboardInterrupt:
            return
