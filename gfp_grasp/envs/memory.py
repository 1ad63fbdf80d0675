"""Memory of what is over, given back to the system."""

import ctypes
import gc
import sys
from contextlib import suppress
from itertools import count

_EVERY = 32  # episodes, which leave up to 1 MB each; it takes 2 % of their time
_calls = count(1)  # of all environments of this process: a score has one for each row


def give_back_memory() -> None:
    """At every 32nd call, collect garbage and hand what the heap has free back to the system.

    Trimesh's meshes refer to themselves in circles, few objects with much memory, which Python counts but does not
    weigh: left to itself it collects them after thousands of meshes. And glibc keeps what was freed between two things
    that stay; on other systems that is left to the system.
    """
    if next(_calls) % _EVERY:
        return
    gc.collect()
    if sys.platform == "linux":
        with suppress(AttributeError, OSError):  # a libc without it, such as musl
            ctypes.CDLL(None).malloc_trim(0)
