"""How much memory a process has, and the most that its program ever had."""

from __future__ import annotations

import re
import resource
import sys
from pathlib import Path


def resident_mb() -> float:
    """Memory of this process; the most it ever had where the system does not tell the present."""
    status = Path("/proc/self/statm")
    if status.is_file():
        return round(int(status.read_text().split()[1]) * resource.getpagesize() / 1e6, 1)
    return _most_mb()


def peak_mb() -> float:
    """The most memory that this program ever had.

    `getrusage` also counts what the process held that started it, and so is asked only where the system tells no other.
    """
    status = Path("/proc/self/status")
    told = re.search(r"^VmHWM:\s*(\d+) kB", status.read_text(), re.MULTILINE) if status.is_file() else None
    return round(int(told[1]) * 1024 / 1e6, 1) if told else _most_mb()


def _most_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1e6 if sys.platform == "darwin" else 1e3), 1)
