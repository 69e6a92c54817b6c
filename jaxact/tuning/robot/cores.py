"""Stacks of small matrices, shared between the cores of a processor.

NumPy lets go of the interpreter while it decomposes a stack, one matrix after the other: in parts,
the results are the same to the last bit.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any, TypeVar

import numpy as np

Item = TypeVar("Item")
Result = TypeVar("Result")

# Multiplications of all matrices together below which threads are not worth it.
_LEAST = 3e6


def number() -> int:
    """CPU cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(number() - 1, 1), thread_name_prefix="matrices")


def stacked(work: Callable[..., np.ndarray], *stacks: np.ndarray) -> np.ndarray:
    """What work gives for stacks of matrices of the same length, a part on each core.

    Args:
        work: from parts of the stacks to an array with as many rows.
        stacks: shape (k, ...) each; the first one's matrices say how much there is to do.
    """
    first = stacks[0]
    parts = min(number(), len(first))
    if parts < 2 or first.size * first.shape[-1] < _LEAST:
        return work(*stacks)
    ends = np.linspace(0, len(first), parts + 1).astype(int)
    pieces = [
        tuple(stack[a:b] for stack in stacks) for a, b in zip(ends[:-1], ends[1:], strict=True)
    ]
    return np.concatenate(each(lambda piece: work(*piece), pieces))


def each(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """What work gives for each item, in their order; the items are taken by whoever is free."""
    if number() < 2 or len(items) < 2:
        return [work(item) for item in items]
    left: list[Any] = list(enumerate(items))[::-1]
    found: list[Any] = [None] * len(items)

    def take() -> None:
        while left:
            try:
                place, item = left.pop()
            except IndexError:  # another one was faster
                return
            found[place] = work(item)

    others = [_pool().submit(take) for _ in range(number() - 1)]
    try:
        take()
    except BaseException:
        left.clear()
        raise
    for other in others:
        other.result()
    return found
