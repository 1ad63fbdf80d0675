"""One child process that runs an engine: started, asked, watched and killed, so that none is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Protocol

import numpy as np

from gfp_grasp.collision.engines import pipe
from gfp_grasp.errors import Cancelled

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
                pipe.send(self.process.stdin, *message)
            return pipe.receive(self.process.stdout)
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
