"""A recording in the viewer."""

from __future__ import annotations

from pathlib import Path

from gfp_grasp.captures import Capture, read_capture
from gfp_grasp.view.server import HOST, PORT, Viewer, check_viser
from gfp_grasp.view.sight import sight_of_capture


def view_capture(
    capture: Capture | str | Path = "sample",
    *,
    category: str | None = None,
    seed: int = 0,
    host: str = HOST,
    port: int = PORT,
) -> Viewer:
    """Complete a recording, plan grasps on it, and serve a page that shows all of it.

    Args:
        capture: The recording, or its file as `read_capture` takes it; "sample" ships with the package.
        category: Class of its one object; None lets the classifier and the fits choose.
        seed: Of every random choice.
        host: Address to listen at.
        port: To listen at, or the next that is free; 0 takes any.

    Returns:
        The viewer, serving: `wait` for the user, and `stop` it.

    Raises:
        InvalidOption: Viser, an extra of this package, is not installed, or the address cannot be listened at.
        GfpGraspError: The recording cannot be read or completed.
    """
    check_viser()
    capture = capture if isinstance(capture, Capture) else read_capture(capture)
    sight = sight_of_capture(capture, category=category, seed=seed)
    viewer = Viewer(capture.name, host=host, port=port)
    viewer.show(sight)
    return viewer
