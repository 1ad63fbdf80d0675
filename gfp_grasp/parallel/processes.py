"""Processes and threads of this machine: jobs over processes, and one thread of linear algebra for a public call."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from functools import lru_cache
from multiprocessing import get_context, parent_process
from typing import Any, TypeVar

from threadpoolctl import ThreadpoolController

from gfp_grasp.errors import WorkerLost

_LIBRARIES = ("numpy", "scipy.linalg", "sklearn", "torch")  # each brings a pool of its own


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep numpy, scipy, scikit-learn and torch to one thread; also a decorator, `@one_thread()`.

    The matrices of the package are small: several threads wait for each other, on busy cores for seconds. And GNU
    OpenMP, once its pool has started, does not survive a fork: a worker forked after a completion would hang.

    A library that is imported within the call is not limited. Functions that evaluate a network, which may be the
    first to import torch, open this context again.
    """
    with _pools(tuple(name in sys.modules for name in _LIBRARIES)).limit(limits=1):
        yield


@lru_cache(maxsize=2 ** len(_LIBRARIES))
def _pools(loaded: tuple[bool, ...]) -> ThreadpoolController:
    """The pools of the libraries that are loaded: to find them takes 8 ms, to limit them less than 0.1 ms."""
    return ThreadpoolController()


Job = TypeVar("Job")
Result = TypeVar("Result")
# Makes the result of a job whose process died ATTEMPTS times.
Lost = Callable[[Any, WorkerLost], Any]
# A job that has killed its own process so many times is given up.
ATTEMPTS = 3


def over_processes(
    function: Callable[[Job], Result], jobs: Sequence[Job], workers: int, lost: Lost | None
) -> Iterator[tuple[int, Result]]:
    """Numbers and results of jobs as they come.

    A process that dies under a job is replaced, and what it had not finished is done again.

    Args:
        function: A function of one job; importable by name.
        jobs: Picklable.
        workers: Number of processes.
        lost: Makes the result of a job whose process died ATTEMPTS times; None raises WorkerLost.

    Raises:
        WorkerLost: A job's process died ATTEMPTS times, and no `lost` was given.
    """
    waiting = dict(enumerate(jobs))
    while waiting:
        try:
            for number, result in _pooled(function, waiting, workers):
                del waiting[number]
                yield number, result
        except BrokenProcessPool:
            # A pool takes jobs in their order, one more than it has processes. Any of these may have killed it, so each
            # of them runs in a process of its own, where it can take no other job along.
            for number in list(waiting)[: workers + 1]:
                yield number, _alone(function, waiting.pop(number), lost)


def _pooled(function: Callable[[Job], Result], jobs: Mapping[int, Job], workers: int) -> Iterator[tuple[int, Result]]:
    # Spawned, not forked: torch and MuJoCo hold threads that a fork would leave dead.
    pool = ProcessPoolExecutor(min(workers, len(jobs)), mp_context=get_context("spawn"), initializer=_end_with_parent)
    try:
        numbers = {pool.submit(function, job): number for number, job in jobs.items()}
        for future in as_completed(numbers):
            yield numbers.pop(future), future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _end_with_parent() -> None:
    """End this process when its parent has ended: it would wait for jobs for ever and keep its memory."""
    parent = parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()


def _alone(function: Callable[[Job], Result], job: Job, lost: Lost | None) -> Result:
    for _ in range(ATTEMPTS):
        with suppress(BrokenProcessPool):
            return next(_pooled(function, {0: job}, 1))[1]
    return given_up(job, lost)


def given_up(job: object, lost: Lost | None) -> Any:
    """The result that `lost` makes of a job that no process survived.

    Raises:
        WorkerLost: `lost` is None.
    """
    error = WorkerLost(
        f"{ATTEMPTS} processes died under {job!r}, killed or out of memory: try fewer workers, or leave it out"
    )
    if lost is None:
        raise error
    return lost(job, error)
