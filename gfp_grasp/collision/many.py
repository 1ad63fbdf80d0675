"""Several meshes decomposed side by side: threads that each wait for a guarded child."""

from __future__ import annotations

import atexit
import threading
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from queue import Empty, SimpleQueue

import trimesh

from gfp_grasp.collision.config import DecomposeConfig
from gfp_grasp.collision.decomposition import check_engine, decompose
from gfp_grasp.collision.engines.guard import CancelSign
from gfp_grasp.errors import GfpGraspError, InvalidOption
from gfp_grasp.types import CollisionMesh

# How long a cancelled thread is waited for: it may be repairing a mesh, which cannot be interrupted.
_PATIENCE_S = 5.0


def decompose_many(
    meshes: Iterable[trimesh.Trimesh],
    *,
    config: DecomposeConfig | None = None,
    workers: int = 2,
    cancel: CancelSign | None = None,
) -> Iterator[CollisionMesh | GfpGraspError]:
    """Decompose several meshes at once, as `decompose` does one.

    Needs no main guard in a script. Closing the iterator, letting go of it or Ctrl-C kills the children at work.

    Args:
        meshes: Metres, each in any frame.
        config: For all of them; None for the defaults.
        workers: Child processes at work at a time, at least 1.
        cancel: Once it is set, what is not done yet comes as Cancelled.

    Returns:
        For each mesh, in their order and as they are done: its parts, or the error that `decompose` has for it.

    Raises:
        InvalidOption: workers is below 1, or the engine's wheel is not installed.
    """
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise InvalidOption(f"workers is {workers!r}; a whole number, at least 1, is expected")
    config = config or DecomposeConfig()
    check_engine(config)
    return _stream(list(meshes), config, workers, cancel)


def _stream(
    meshes: list[trimesh.Trimesh], config: DecomposeConfig, workers: int, cancel: CancelSign | None
) -> Iterator[CollisionMesh | GfpGraspError]:
    stop = _Stop(cancel)
    jobs: SimpleQueue[tuple[Future, trimesh.Trimesh]] = SimpleQueue()
    futures = [Future() for _ in meshes]
    for job in zip(futures, meshes, strict=True):
        jobs.put(job)
    # Daemons, not an executor's threads: at the interpreter's end those would work off all that is left.
    threads = [threading.Thread(target=_work, args=(jobs, config, stop), daemon=True) for _ in meshes[:workers]]

    def end() -> None:
        stop.called_off.set()
        for thread in threads:
            if thread.ident is not None:
                thread.join(_PATIENCE_S)

    # A daemon that the interpreter's end finds at work holds what other libraries then miss, and say so.
    atexit.register(end)
    try:
        for thread in threads:
            thread.start()
        for future in futures:
            yield future.result()
    finally:
        atexit.unregister(end)
        end()


def _work(jobs: SimpleQueue, config: DecomposeConfig, stop: _Stop) -> None:
    while not stop.called_off.is_set():
        try:
            future, mesh = jobs.get_nowait()
        except Empty:
            return
        try:
            future.set_result(decompose(mesh, config=config, cancel=stop))
        except GfpGraspError as error:
            future.set_result(error)
        except BaseException as error:  # our own mistake: the caller's thread shall see it
            future.set_exception(error)
            raise


class _Stop:
    """A sign that is set when the stream has been closed or the caller's own sign is set."""

    def __init__(self, cancel: CancelSign | None) -> None:
        self.called_off = threading.Event()
        self._cancel = cancel

    def is_set(self) -> bool:
        return self.called_off.is_set() or (self._cancel is not None and self._cancel.is_set())
