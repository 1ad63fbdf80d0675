"""Independent jobs over local processes, in order, with the same answer for any number of workers."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

from gfp_grasp.errors import InvalidOption

Job = TypeVar("Job")
Result = TypeVar("Result")


def pmap(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    *,
    workers: int = 1,
    progress: Callable[[Iterable[Result], int], Iterable[Result]] | None = None,
) -> list[Result]:
    """Map a function over jobs.

    Args:
        function: Of one job; importable by name where workers > 1.
        jobs: Picklable where workers > 1.
        workers: Processes; 1 runs in this one, 0 means one a core.
        progress: Wraps the stream of results, told how many there will be, e.g. a progress bar.

    Returns:
        The results in the order of the jobs.

    Raises:
        InvalidOption: workers is negative.
    """
    if workers < 0:
        raise InvalidOption(f"workers is {workers}; 0 (one a core) or a positive number is expected")
    workers = workers or os.cpu_count() or 1
    watch = progress or (lambda results, total: results)
    if workers == 1 or len(jobs) <= 1:
        return list(watch(map(function, jobs), len(jobs)))
    # Spawned, not forked: torch and MuJoCo hold threads that a fork would leave dead.
    with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=get_context("spawn")) as pool:
        return list(watch(pool.map(function, jobs), len(jobs)))
