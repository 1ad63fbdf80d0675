"""Jobs on a Ray cluster (the extra `gfp-grasp[cluster]`)."""

from __future__ import annotations

import importlib.util
import logging
import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from gfp_grasp.errors import InvalidOption
from gfp_grasp.parallel.processes import ATTEMPTS, Lost, given_up

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
