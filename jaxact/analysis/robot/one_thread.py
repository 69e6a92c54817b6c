"""A robot's matrices on one thread of the linear algebra that NumPy and SciPy bring along.

They are too small for several. OpenBLAS would start one for each core, which wait by spinning, on
cores where JAX and other processes compute, and of which the last bits of a result depend. The
command line sets their number before NumPy starts; in somebody else's process it is limited while a
robot's margins are computed.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

# What OpenBLAS reads: a number that the user has chosen stays.
CHOSEN = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "GOTO_NUM_THREADS")


class _Limit:
    """The number is the process's: the first who asks sets it, the last one puts it back."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._asking = 0
        self._limit: Any = None

    def take(self) -> None:
        import scipy.linalg  # noqa: F401  its OpenBLAS, too, is there to be limited
        from threadpoolctl import threadpool_limits

        with self._lock:
            if not self._asking:
                self._limit = threadpool_limits(limits=1, user_api="blas")
            self._asking += 1

    def give_back(self) -> None:
        with self._lock:
            self._asking -= 1
            if not self._asking:
                self._limit.restore_original_limits()


_limit = _Limit()


@contextmanager
def one_thread() -> Iterator[None]:
    """One thread of linear algebra while a block runs, or as many as the environment says."""
    if any(name in os.environ for name in CHOSEN):
        yield
        return
    _limit.take()
    try:
        yield
    finally:
        _limit.give_back()
