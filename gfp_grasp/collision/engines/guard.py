"""Jobs for the engines: each runs in a child process, and up to two children are kept warm for the next job."""

from __future__ import annotations

import atexit
import os
import threading

import numpy as np

from gfp_grasp.collision.engines.child import CancelSign, Child, ChildLostError
from gfp_grasp.errors import Cancelled

__all__ = ["CancelSign", "ChildLostError", "close_workers", "idle_pids", "run_guarded"]

# Starting costs 0.3 s; two idle children are what a threaded caller can use without hoarding memory.
_MAX_IDLE = 2
_idle: list[Child] = []
_lock = threading.Lock()


def run_guarded(
    vertices: np.ndarray,
    faces: np.ndarray,
    options: dict,
    *,
    time_limit_s: float,
    memory_limit_mb: int | None,
    engine: str = "coacd",
    cancel: CancelSign | None = None,
) -> tuple[list[tuple[np.ndarray, np.ndarray]], dict[str, object]]:
    """Run an engine once in a child process.

    Args:
        vertices: (v, 3) float64.
        faces: (f, 3) integer.
        options: Keyword arguments of coacd.run_coacd or vhacdx.compute_vhacd.
        time_limit_s: The child is killed after this many seconds.
        memory_limit_mb: Address space of the child in MiB, or None.
        engine: "coacd" or "vhacd".
        cancel: Once set, the child is killed.

    Returns:
        Vertices and faces of each hull, and what the child said: whether the memory limit holds, options unknown to it.

    Raises:
        ChildLostError: No answer came; the message says why. The child is gone, and reaped.
        Cancelled: `cancel` was set. The child is gone, and reaped.
    """
    if cancel is not None and cancel.is_set():
        raise Cancelled("called off before the child was asked")
    child = _take(engine, memory_limit_mb)
    try:
        message = {**options}, [vertices.astype(np.float64), faces.astype(np.int32)]
        header, arrays = child.ask(message, time_limit_s, cancel)
    except BaseException:  # KeyboardInterrupt too: a child that is busy must not outlive its caller's interest
        child.kill()
        raise
    _give_back(child)
    hulls = [(points, triangles) for points, triangles in zip(arrays[::2], arrays[1::2], strict=True)]
    return hulls, {"memory_limit": child.memory_limit_holds, "unknown_options": header["unknown"]}


def close_workers() -> None:
    """End the idle children; the next job starts a new one. Runs by itself when the interpreter ends."""
    with _lock:
        children = _idle.copy()
        _idle.clear()
    for child in children:
        child.kill()


def idle_pids() -> set[int]:
    """Process ids of the living children that wait for the next job."""
    with _lock:
        return {child.process.pid for child in _idle if child.process.poll() is None}


def _take(engine: str, memory_limit_mb: int | None) -> Child:
    with _lock:
        for child in list(_idle):
            if child.process.poll() is not None:
                _idle.remove(child)
                child.forget()
            elif (child.engine, child.memory_limit_mb) == (engine, memory_limit_mb):
                _idle.remove(child)
                return child
    return Child.start(engine, memory_limit_mb)


def _give_back(child: Child) -> None:
    with _lock:
        if len(_idle) < _MAX_IDLE:
            _idle.append(child)
            return
    child.kill()


def _forget_after_fork() -> None:
    # The children belong to the process that started them: two that talk over one pipe would read each other's answers.
    global _lock
    _lock = threading.Lock()
    for child in _idle:
        child.process.returncode = 0  # else subprocess warns that it still runs
        child.forget()
    _idle.clear()


atexit.register(close_workers)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_after_fork)
