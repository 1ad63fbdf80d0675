"""`gfp-grasp demo` and `gfp-grasp view`: pages that show what the package makes of a picture."""

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gfp_grasp.cli.terminal import Gps, Seed, err, gps_option, out
from gfp_grasp.errors import InvalidOption

if TYPE_CHECKING:
    from gfp_grasp.complete import CompleteConfig


def demo(
    folder: Annotated[Path, typer.Option("--out", help="Folder to write; open its index.html.")] = Path("out"),
    cloud: Annotated[list[Path] | None, typer.Option(help="Your own cloud of one object; may be repeated.")] = None,
    capture: Annotated[
        list[Path] | None, typer.Option(help="Your own .npz capture, or sample; may be repeated.")
    ] = None,
    category: Annotated[str | None, typer.Option(help="Class of the object in your recordings.")] = None,
    folders: Gps = None,
    seed: Seed = 0,
) -> None:
    """Complete and grasp objects of a clutter and a single one, or of your own recordings, and show it in a page."""
    from gfp_grasp.demo import run_demo  # loads simulator and networks, which --help does without

    recordings = (*(cloud or ()), *(capture or ()))
    run_demo(folder, recordings=recordings, category=category, config=_config(folders), seed=seed, console=out)


def view(
    capture: Annotated[
        Path | None, typer.Argument(help="Cloud or .npz capture, metres; left out: sample, which ships.")
    ] = None,
    objects: Annotated[
        str | None,
        typer.Option(help="Instead: episodes with procedural families or all of them, a mesh file, or a folder."),
    ] = None,
    category: Annotated[str | None, typer.Option(help="Class of the object in the capture.")] = None,
    folders: Gps = None,
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
            viewer = view_episodes(objects, gps=gps_option(folders), seed=seed, host=host, port=port)
        else:
            viewer = view_capture(
                capture or "sample", category=category, config=_config(folders), seed=seed, host=host, port=port
            )
    with viewer:
        out.print(f"{viewer.url} shows it; Ctrl-C ends", markup=False)
        if browser:
            webbrowser.open(viewer.url)
        try:
            viewer.wait()
        except KeyboardInterrupt:
            return


def _config(folders: list[Path] | None) -> "CompleteConfig":
    """The default completion, with the classes of a user's folders among those that there are."""
    from gfp_grasp.complete import CompleteConfig
    from gfp_grasp.primitives import PrimitiveLibrary

    return CompleteConfig(library=PrimitiveLibrary.with_shipped(*(folders or ())))
