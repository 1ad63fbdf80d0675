"""The child process in which an engine may abort, hang or run out of memory.

`python -m gfp_grasp.collision.engines.worker ENGINE [MIB]` reads jobs from its standard input and writes answers to its
standard output, as messages. CoACD logs to file descriptor 1 from C++, so that descriptor is turned away to the null
device before the engine is loaded, and the answers go out through a copy of it. When the parent goes away, its end of
the input closes and the child ends itself, even in the midst of a job.
"""

from __future__ import annotations

import inspect
import os
import queue
import sys
import threading
from collections.abc import Callable
from typing import IO

import numpy as np

from gfp_grasp.collision.engines.guard import receive_message, send_message

# Vertices, faces and options to hulls, and the options that were unknown.
Engine = Callable[[np.ndarray, np.ndarray, dict], tuple[list, list[str]]]


def main() -> None:
    """Answer jobs until the input ends."""
    jobs, answers = _take_over_streams()
    memory = _limit_memory(sys.argv[2:])
    run = {"coacd": _coacd, "vhacd": _vhacd}[sys.argv[1]]()
    send_message(answers, {"ready": True, "memory_limit": memory})
    waiting: queue.SimpleQueue = queue.SimpleQueue()
    threading.Thread(target=_read_jobs, args=(jobs, waiting), daemon=True).start()
    while True:
        options, (vertices, faces) = waiting.get()
        hulls, unknown = run(vertices, faces, options)
        arrays = [array for points, triangles in hulls for array in (np.asarray(points), np.asarray(triangles))]
        send_message(answers, {"num_parts": len(hulls), "unknown": unknown}, arrays)


def _coacd() -> Engine:
    import coacd  # type: ignore[import-untyped]

    coacd.set_log_level("error")
    known = set(inspect.signature(coacd.run_coacd).parameters)

    def run(vertices: np.ndarray, faces: np.ndarray, options: dict) -> tuple[list, list[str]]:
        # An older CoACD lacks some options; those left at their defaults are no loss.
        kept = {name: value for name, value in options.items() if name in known}
        return coacd.run_coacd(coacd.Mesh(vertices, faces), **kept), sorted(set(options) - known)

    return run


def _vhacd() -> Engine:
    import vhacdx  # type: ignore[import-untyped]

    def run(vertices: np.ndarray, faces: np.ndarray, options: dict) -> tuple[list, list[str]]:
        # Each face behind the number of its corners, as VTK's vtkPolyData has it.
        polygons = np.column_stack([np.full(len(faces), 3), faces]).astype(np.uint32).ravel()
        return vhacdx.compute_vhacd(vertices, polygons, **options), []

    return run


def _take_over_streams() -> tuple[IO[bytes], IO[bytes]]:
    jobs = os.fdopen(os.dup(0), "rb")
    answers = os.fdopen(os.dup(1), "wb")
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, 0)
    os.dup2(null, 1)
    if sys.platform == "win32":
        import msvcrt

        # Descriptors open in text mode there, and would turn every byte 10 into two.
        msvcrt.setmode(jobs.fileno(), os.O_BINARY)
        msvcrt.setmode(answers.fileno(), os.O_BINARY)
    return jobs, answers


def _limit_memory(arguments: list[str]) -> bool:
    """Limits the address space to the MiB in the first argument; whether that was possible."""
    try:
        import resource
    except ImportError:
        return False
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # an abort that is expected needs no core file
    if not arguments:
        return True
    limit = int(arguments[0]) * 2**20
    try:
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    except (ValueError, OSError):  # macOS knows the limit's name and refuses it; a hard limit may be lower already
        return False
    return True


def _read_jobs(jobs: IO[bytes], waiting: queue.SimpleQueue) -> None:
    try:
        while True:
            waiting.put(receive_message(jobs))
    except EOFError:
        os._exit(0)  # the main thread may be deep in C++, where no exception would reach it


if __name__ == "__main__":
    main()
