"""Independent jobs over processes of this machine or of a Ray cluster, with the same answer wherever they run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context
from typing import Any, TypeVar

from gfp_grasp.errors import InvalidOption, WorkerLost

Job = TypeVar("Job")
Result = TypeVar("Result")
Lost = Callable[[Any, WorkerLost], Any]
# A job that takes its process along so often, when it is alone in it, is given up.
ATTEMPTS = 3


def pmap(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    *,
    workers: int = 1,
    ray: str | None = None,
    progress: Callable[[Iterable[Result], int], Iterable[Result]] | None = None,
    keep: Callable[[Job, Result], None] | None = None,
    lost: Lost | None = None,
) -> list[Result]:
    """Map a function over jobs.

    A process that dies under a job (killed, or out of memory) is replaced, and what it had not finished is done again.

    Args:
        function: Of one job; importable by name where it runs in another process.
        jobs: Picklable where they run in another process.
        workers: Processes; 1 runs in this one, 0 means one a core. It says nothing to a cluster.
        ray: Address of a Ray cluster to run on instead, or "auto" for the one that this machine belongs to.
        progress: Wraps the stream of results, told how many there will be, e.g. a progress bar.
        keep: Called with each job and its result as they come, in no particular order, e.g. to write them down.
        lost: Makes the result of a job whose process died ATTEMPTS times.

    Returns:
        The results in the order of the jobs.

    Raises:
        InvalidOption: workers is negative, Ray is not installed, or there is no cluster at that address.
        WorkerLost: A job's process died ATTEMPTS times, and no `lost` was given.
    """
    if workers < 0:
        raise InvalidOption(f"workers is {workers}; 0 (one a core) or a positive number is expected")
    workers = workers or os.cpu_count() or 1
    if ray is not None:
        from gfp_grasp.cluster import over_cluster

        stream = over_cluster(function, jobs, ray, lost)
    elif workers == 1 or len(jobs) <= 1:
        stream = ((number, function(job)) for number, job in enumerate(jobs))
    else:
        stream = _over_processes(function, jobs, workers, lost)
    found: dict[int, Result] = {}

    def results() -> Iterator[Result]:
        for number, result in stream:
            found[number] = result
            if keep is not None:
                keep(jobs[number], result)
            yield result

    watch = progress or (lambda results, total: results)
    for _ in watch(results(), len(jobs)):
        pass
    return [found[number] for number in range(len(jobs))]


def _over_processes(
    function: Callable[[Job], Result], jobs: Sequence[Job], workers: int, lost: Lost | None
) -> Iterator[tuple[int, Result]]:
    """Numbers and results of jobs as they come."""
    waiting = dict(enumerate(jobs))
    while waiting:
        try:
            for number, result in _pooled(function, waiting, workers):
                del waiting[number]
                yield number, result
        except BrokenProcessPool:
            # A pool takes jobs in their order, one more than it has processes. Any of these may be the death of it, and
            # goes by itself, so that a bad one takes no other along.
            for number in list(waiting)[: workers + 1]:
                yield number, _alone(function, waiting.pop(number), lost)


def _pooled(function: Callable[[Job], Result], jobs: Mapping[int, Job], workers: int) -> Iterator[tuple[int, Result]]:
    # Spawned, not forked: torch and MuJoCo hold threads that a fork would leave dead.
    pool = ProcessPoolExecutor(min(workers, len(jobs)), mp_context=get_context("spawn"))
    try:
        numbers = {pool.submit(function, job): number for number, job in jobs.items()}
        for future in as_completed(numbers):
            yield numbers.pop(future), future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _alone(function: Callable[[Job], Result], job: Job, lost: Lost | None) -> Result:
    for _ in range(ATTEMPTS):
        with suppress(BrokenProcessPool):
            return next(_pooled(function, {0: job}, 1))[1]
    return given_up(job, lost)


def given_up(job: object, lost: Lost | None) -> Any:
    """The result of a job that no process survived.

    Raises:
        WorkerLost: Nobody makes one.
    """
    error = WorkerLost(
        f"{ATTEMPTS} processes died under {job!r}, killed or out of memory: try fewer workers, or leave it out"
    )
    if lost is None:
        raise error
    return lost(job, error)
