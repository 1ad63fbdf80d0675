"""Independent jobs over processes of this machine or of a Ray cluster, with the same answer wherever they run.

A Ray cluster needs the extra `gfp-grasp[cluster]`.
"""

from __future__ import annotations

import importlib.util
import logging
import os
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

from gfp_grasp.errors import InvalidOption
from gfp_grasp.parallel.processes import ATTEMPTS, Lost, given_up, over_processes

Job = TypeVar("Job")
Result = TypeVar("Result")
# Jobs handed over for each core of the cluster: enough that none waits, few enough that a lost node repeats little.
_AHEAD = 4
_KNOCK_S = 5.0


def over_cluster(
    function: Callable[[Job], Result], jobs: Sequence[Job], address: str, lost: Lost | None = None
) -> Iterator[tuple[int, Result]]:
    """Numbers and results of jobs as they come.

    The package must be installed on every node, in the same version. A job whose process or node dies is done again by
    Ray, on another node if need be.

    Args:
        function: A function of one job; importable by name on every node.
        jobs: Picklable.
        address: "auto" for the cluster that this machine belongs to, or host:port of its head.
        lost: Makes the result of a job whose process died ATTEMPTS times; None raises WorkerLost.

    Raises:
        InvalidOption: Ray is not installed, or there is no cluster at that address.
        WorkerLost: A job's process died ATTEMPTS times, and no `lost` was given.
    """
    ours, ray = _connected(address)

    @ray.remote(max_retries=ATTEMPTS - 1, num_cpus=1)
    def run(job):  # a partial is no function to Ray
        return function(job)

    room = max(1, int(_AHEAD * ray.cluster_resources().get("CPU", 1)))
    waiting, running = list(enumerate(jobs))[::-1], {}
    try:
        while waiting or running:
            while waiting and len(running) < room:
                number, job = waiting.pop()
                running[run.remote(job)] = number
            for done in ray.wait(list(running))[0]:
                number = running.pop(done)
                try:
                    result = ray.get(done)
                except ray.exceptions.RayTaskError as error:  # the job's own error, which is to be seen as it was
                    raise error.as_instanceof_cause() from None
                except ray.exceptions.RayError:
                    result = given_up(jobs[number], lost)
                yield number, result
    finally:
        for reference in running:
            ray.cancel(reference, force=True)
        if ours:
            ray.shutdown()


def _connected(address: str) -> tuple[bool, Any]:
    """Whether this call made the connection, and Ray."""
    if importlib.util.find_spec("ray") is None:
        raise InvalidOption("Ray is not installed: pip install 'gfp-grasp[cluster]', or leave --ray out")
    import ray

    if ray.is_initialized():
        return False, ray
    try:
        if address != "auto":
            _knock(address)
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    except (ConnectionError, ValueError, RuntimeError, OSError) as error:
        raise InvalidOption(
            f"there is no Ray cluster at {address!r} ({error}): start one with `ray start --head`, or give host:port"
        ) from error
    return True, ray


def _knock(address: str) -> None:
    """See whether anybody is at host:port, on which Ray itself would wait for minutes.

    Raises:
        OSError: Nobody.
        ValueError: That is no host:port.
    """
    host, _, port = address.rpartition("://")[2].rpartition(":")
    socket.create_connection((host, int(port)), timeout=_KNOCK_S).close()


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
