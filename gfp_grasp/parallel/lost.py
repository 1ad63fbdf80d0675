"""Jobs that no process survives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from gfp_grasp.errors import WorkerLost

Lost = Callable[[Any, WorkerLost], Any]
# A job that takes its process along so often, when it is alone in it, is given up.
ATTEMPTS = 3


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
