"""The server behind the page: viser, started quietly and only where it is installed."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np

from gfp_grasp.captures import Capture, read_capture
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.detect import Detector
from gfp_grasp.drawing import first_look
from gfp_grasp.errors import InvalidOption
from gfp_grasp.transforms import rotation_about
from gfp_grasp.types import SensorProfile
from gfp_grasp.view.layers import Layers
from gfp_grasp.view.panels import Panels
from gfp_grasp.view.scene import ShownScene, scene_of_capture

HOST, PORT = "127.0.0.1", 8080
_LAST_PORT, _PORTS_TRIED = 65535, 100
# Aside of where the camera stood, so that seen and unseen surface both show.
_ASIDE_RAD = 0.7
_FROM = np.array([1.0, -0.8, 0.4])  # where nobody knows where the camera stood
_FIELD_RAD, _NEAREST_M, _AWAY_IN_SIZES = 0.8, 0.5, 1.8
_LEAST_STEEPNESS = 0.45  # sine of the angle above the support
_OWN = {"0.0.0.0": "127.0.0.1", "": "127.0.0.1", "::": "[::1]"}


def view_capture(
    capture: Capture | str | Path = "sample",
    *,
    category: str | None = None,
    detector: str | Detector | None = None,
    sensor: str | SensorProfile = "tabletop",
    config: CompleteConfig | None = None,
    seed: int = 0,
    host: str = HOST,
    port: int = PORT,
) -> Viewer:
    """Complete a recording, plan grasps on it, and serve a page that shows all of it.

    Args:
        capture: The recording, or its file as `read_capture` takes it; "sample" and "street" ship with the package.
        category: Class of its one object; None lets the classifier and the fits choose.
        detector: What finds the objects of a whole picture or scan, as `complete_capture` takes it.
        sensor: What saw it: "tabletop", or "lidar", whose wide clouds are whole scans.
        config: Switches of the completion, the library of classes among them.
        seed: Seed of every random choice.
        host: Address to listen at.
        port: Port to listen at, or the next one that is free; 0 takes any.

    Returns:
        The viewer, serving: `wait` for the user, and `stop` it.

    Raises:
        InvalidOption: Viser, an extra of this package, is not installed, or the address cannot be listened at.
        GfpGraspError: The recording cannot be read or completed.
    """
    check_viser()
    capture = capture if isinstance(capture, Capture) else read_capture(capture)
    shown = scene_of_capture(capture, category=category, detector=detector, sensor=sensor, config=config, seed=seed)
    viewer = Viewer(capture.name, host=host, port=port)
    viewer.show(shown)
    return viewer


class Viewer:
    """A page that is being served; as a context manager it is stopped at the end.

    Attributes:
        headroom_m: Height above the objects that the camera has in view at first.
        server: Viser's own, to which more can be added.
        panels: Switches and texts.
        layers: Nodes of what is shown; None before anything is.
    """

    headroom_m = 0.0

    def __init__(self, title: str, *, host: str = HOST, port: int = PORT) -> None:
        """Start to serve an empty page.

        Args:
            title: Above the panel.
            host: Address to listen at; 0.0.0.0 lets other machines in.
            port: To listen at; the next one that is free where it is taken; 0 takes any.

        Raises:
            InvalidOption: Viser is not installed, or the address cannot be listened at.
        """
        check_viser()
        port = free_port(host, port)
        import viser  # type: ignore[import-not-found]

        with _quietly():
            self.server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        self.server.gui.configure_theme(control_width="large", show_share_button=False)
        self.panels = Panels(self.server)
        self.layers: Layers | None = None
        self._over = threading.Event()

    @property
    def url(self) -> str:
        """Address of the page."""
        host = self.server.get_host()
        host = _OWN.get(host, f"[{host}]" if ":" in host else host)
        return f"http://{host}:{self.server.get_port()}"

    def show(self, shown: ShownScene) -> None:
        """Draw a scene in place of the one before."""
        with self.panels.lock, self.server.atomic():
            self.panels.clear()
            if self.layers is not None:
                self.layers.remove()
            self.layers = Layers(self.server, shown)
            self.panels.put(shown, self.layers)
        self._look_at(shown)

    def wait(self) -> None:
        """Serve until the process is interrupted, or the viewer stopped by another thread."""
        while not self._over.wait(1.0):  # a wait without end cannot be interrupted on every system
            pass

    def stop(self) -> None:
        """Stop serving."""
        self._over.set()
        with _quietly():
            self.server.stop()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.stop()

    def _look_at(self, shown: ShownScene) -> None:
        camera = self.server.initial_camera
        camera.fov, camera.up = _FIELD_RAD, shown.up
        if shown.street is not None:
            camera.position, camera.look_at = first_look(shown.street)
            return
        low, high = _bounds(shown)
        middle, size = (low + high) / 2 + self.headroom_m / 2 * shown.up, float(np.linalg.norm(high - low))
        size += self.headroom_m
        eye = None if shown.image is None else shown.image.T_world_camera[:3, 3]
        for item in shown.items:
            eye = item.completion.detection.cloud.viewpoint if eye is None else eye
        away = rotation_about(shown.up, _ASIDE_RAD) @ (_FROM if eye is None else eye - middle)
        away /= max(float(np.linalg.norm(away)), 1e-9)
        away += max(0.0, _LEAST_STEEPNESS - float(away @ shown.up)) * shown.up
        camera.look_at = middle
        camera.position = middle + max(_NEAREST_M, _AWAY_IN_SIZES * size) * away / np.linalg.norm(away)


def check_viser() -> None:
    """Refuse where the extra is missing, before any work is done.

    Raises:
        InvalidOption: Viser is not installed.
    """
    if importlib.util.find_spec("viser") is None:
        raise InvalidOption('the viewer needs viser, which is not installed: pip install "gfp-grasp[view]"')


def free_port(host: str, port: int) -> int:
    """The first port from one on that can be listened at; 0 for any is left to the system.

    Found out before viser starts, which goes on to try without end where none can be had.

    Args:
        host: Name or address of this machine.
        port: The first to be tried.

    Raises:
        InvalidOption: The host is not this machine, or no port is free.
    """
    if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port <= _LAST_PORT:
        raise InvalidOption(f"port is {port!r}; a whole number from 0 to {_LAST_PORT} is expected")
    try:
        family = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0][0]
        _listen(family, host, 0)
    except (OSError, UnicodeError) as error:
        raise InvalidOption(f"host is {host!r}, which is no address of this machine: {error}") from error
    for candidate in range(port, min(port + _PORTS_TRIED, _LAST_PORT + 1)):
        with contextlib.suppress(OSError):
            _listen(family, host, candidate)
            return candidate
    raise InvalidOption(f"no port from {port} on is free at {host}: name another, or 0 for any")


def _listen(family: int, host: str, port: int) -> None:
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        if os.name == "posix":  # as asyncio's servers do: a port that was let go a moment ago can be had again
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((host, port))


def _bounds(shown: ShownScene) -> tuple[np.ndarray, np.ndarray]:
    boxes = [mesh.bounds for mesh in (*(item.completion.mesh for item in shown.items), *shown.truths)]
    if not boxes:
        return np.full(3, -0.1), np.full(3, 0.1)
    return np.min([low for low, _ in boxes], axis=0), np.max([high for _, high in boxes], axis=0)


@contextlib.contextmanager
def _quietly() -> Iterator[None]:
    """Viser announces itself on stdout, which belongs to the program that calls."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
