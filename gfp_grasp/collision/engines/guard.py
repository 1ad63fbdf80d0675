"""Jobs for the engines: each runs in a child process, and up to two children are kept warm for the next job.

A child is started, asked, watched and killed, so that none is left behind. Messages are a JSON header and raw arrays,
so that nothing is unpickled.
"""

from __future__ import annotations

import atexit
import json
import os
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Protocol

import numpy as np

from gfp_grasp.errors import Cancelled

_LENGTH = struct.Struct("<Q")


def send_message(stream: IO[bytes], header: Mapping[str, object], arrays: Sequence[np.ndarray] = ()) -> None:
    """Write one message.

    Raises:
        OSError: Nobody reads at the other end.
    """
    arrays = [np.ascontiguousarray(array) for array in arrays]
    layout = [[array.dtype.str, list(array.shape)] for array in arrays]
    text = json.dumps({"header": dict(header), "arrays": layout}).encode()
    stream.write(_LENGTH.pack(len(text)) + text)
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


def receive_message(stream: IO[bytes]) -> tuple[dict[str, object], list[np.ndarray]]:
    """Read one message.

    Raises:
        EOFError: The stream ended before the message did.
    """
    (length,) = _LENGTH.unpack(_exactly(stream, _LENGTH.size))
    message = json.loads(_exactly(stream, length))
    arrays = []
    for kind, shape in message["arrays"]:
        count = int(np.prod(shape, dtype=np.int64))
        raw = _exactly(stream, count * np.dtype(kind).itemsize)
        arrays.append(np.frombuffer(raw, dtype=kind).reshape(shape))
    return message["header"], arrays


def _exactly(stream: IO[bytes], count: int) -> bytes:
    data = stream.read(count)
    if len(data) < count:
        raise EOFError(f"{len(data)} of {count} bytes came")
    return data


_START_LIMIT_S = 60.0
# How long a child may work on after its caller has called it off.
_POLL_S = 0.05


class CancelSign(Protocol):
    """What tells that a job is called off; a threading.Event is one."""

    def is_set(self) -> bool:
        """Whether it is."""
        ...


class ChildLostError(Exception):
    """The child crashed, ran out of time or memory, or could not be started. Caught within collision/."""

    def __init__(self, message: str, *, out_of_time: bool = False) -> None:
        super().__init__(message)
        self.out_of_time = out_of_time


@dataclass(eq=False)
class Child:
    process: subprocess.Popen
    engine: str
    memory_limit_mb: int | None
    log: IO[bytes]
    memory_limit_holds: bool = field(default=False)

    @staticmethod
    def start(engine: str, memory_limit_mb: int | None) -> Child:
        limit = [] if memory_limit_mb is None else [str(memory_limit_mb)]
        log = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the child
        try:
            process = subprocess.Popen(
                # -P: a file in the caller's folder that is called like one of our imports must not be run.
                [sys.executable, "-P", "-m", "gfp_grasp.collision.engines.worker", engine, *limit],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                env=_environment(),
                # Ctrl-C in a terminal reaches the whole group: only the parent shall hear it, and then end the child.
                start_new_session=True,
            )
        except (OSError, ValueError) as error:
            log.close()
            raise ChildLostError(f"{sys.executable!r} could not be started: {error}") from error
        child = Child(process, engine, memory_limit_mb, log)
        try:
            header, _ = child.ask(None, _START_LIMIT_S, None)
        except BaseException:
            child.kill()
            raise
        child.memory_limit_holds = bool(header["memory_limit"])
        return child

    def ask(
        self, message: tuple[dict, list[np.ndarray]] | None, limit_s: float, cancel: CancelSign | None
    ) -> tuple[dict, list[np.ndarray]]:
        # Killing from a thread bounds writing and reading alike, on every platform: both end when the pipe breaks.
        watch = _Watch(self.process, limit_s, cancel)
        try:
            answer = self._answer(message)
        except ChildLostError as error:
            watch.end()
            watch.tell(error)
            raise
        finally:
            watch.end()
        watch.tell(None)  # killed in the moment after its answer, it must not be used again
        return answer

    def _answer(self, message: tuple[dict, list[np.ndarray]] | None) -> tuple[dict, list[np.ndarray]]:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            if message is not None:
                send_message(self.process.stdin, *message)
            return receive_message(self.process.stdout)
        except (EOFError, OSError) as error:
            code = self.process.wait(10)
            raise ChildLostError(f"the child ended with {_exit_name(code)}{self._last_words()}") from error

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self.forget()

    def forget(self) -> None:
        for stream in (self.process.stdin, self.process.stdout):
            try:
                if stream is not None:
                    stream.close()
            except OSError:
                pass  # what was still to be written has nobody to read it
        self.log.close()

    def _last_words(self) -> str:
        self.log.seek(0)
        lines = self.log.read()[-400:].decode(errors="replace").split("\n")
        said = " ".join(line.strip() for line in lines if line.strip())
        return f": {said}" if said else ""


class _Watch:
    """A thread that kills a process when its time is over or its job is called off."""

    def __init__(self, process: subprocess.Popen, limit_s: float, cancel: CancelSign | None) -> None:
        self._process, self._limit_s, self._cancel = process, limit_s, cancel
        self._done = threading.Event()
        self._out_of_time = self._called_off = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def end(self) -> None:
        self._done.set()
        self._thread.join()

    def tell(self, cause: BaseException | None) -> None:
        """Raise what it killed the process for, if it did."""
        if self._called_off:
            raise Cancelled("called off while the child was at work; it was ended") from cause
        if self._out_of_time:
            raise ChildLostError(f"no answer within {self._limit_s:.3g} s", out_of_time=True) from cause

    def _run(self) -> None:
        end = time.monotonic() + self._limit_s
        while (left := end - time.monotonic()) > 0:
            if self._cancel is not None and self._cancel.is_set():
                self._called_off = True
                break
            if self._done.wait(min(left, threading.TIMEOUT_MAX if self._cancel is None else _POLL_S)):
                return
        else:
            self._out_of_time = True
        self._process.kill()


def _environment() -> dict[str, str]:
    home = str(Path(__file__).resolve().parents[3])
    path = [home, *(entry for entry in sys.path if entry)]
    # glibc reserves 64 MiB of address space for the heap of every thread, which a limit on address space would count.
    one = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    return {**os.environ, **one, "PYTHONPATH": os.pathsep.join(path), "MALLOC_ARENA_MAX": "2"}


def _exit_name(code: int) -> str:
    if code < 0:
        try:
            return signal.Signals(-code).name
        except ValueError:
            return f"signal {-code}"
    return f"exit status {code}"


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
