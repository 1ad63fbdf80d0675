"""Independent jobs over processes of this machine or of a Ray cluster, with the same answer wherever they run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

from gfp_grasp.errors import InvalidOption
from gfp_grasp.parallel.processes import Lost, over_processes

Job = TypeVar("Job")
Result = TypeVar("Result")
# Wraps a stream of results, told how many there will be; a progress bar, say.
Progress = Callable[[Iterable[Any], int], Iterable[Any]]


def pmap(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    *,
    workers: int = 1,
    ray: str | None = None,
    progress: Progress | None = None,
    keep: Callable[[Job, Result], None] | None = None,
    lost: Lost | None = None,
) -> list[Result]:
    """Map a function over jobs.

    A process that dies under a job (killed, or out of memory) is replaced, and what it had not finished is done again.

    Args:
        function: A function of one job; importable by name where it runs in another process.
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
        from gfp_grasp.parallel.cluster import over_cluster

        stream = over_cluster(function, jobs, ray, lost)
    elif workers == 1 or len(jobs) <= 1:
        stream = ((number, function(job)) for number, job in enumerate(jobs))
    else:
        stream = over_processes(function, jobs, workers, lost)
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
