"""One thread of linear algebra for the length of a public call."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

from threadpoolctl import ThreadpoolController

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
