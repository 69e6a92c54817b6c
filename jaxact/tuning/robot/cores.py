"""Work on small matrices, shared between the cores of a processor.

NumPy lets go of the interpreter while it decomposes a stack, one matrix after the other: in parts,
the results are the same to the last bit. Of many small steps threads of one process do hardly any
at once; where a search is long, other processes take some.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from typing import Any, TypeVar

import numpy as np

from jaxact.analysis.robot.processes import HELPER, Helpers, helping

Item = TypeVar("Item")
Result = TypeVar("Result")

# Multiplications of all matrices together below which threads are not worth it.
_LEAST = 3e6
# Parts that each core takes of many items, and processes that help at most: a search has little to
# share at once, and each of them has to start.
_PARTS, _MOST = 3, 7
# What helps in this block.
_helpers: ContextVar[Helpers | None] = ContextVar("helpers", default=None)


def number() -> int:
    """CPU cores that this process may use, of which a helper has one."""
    if HELPER in os.environ:
        return 1
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


@contextmanager
def helped(*, worthwhile: bool) -> Iterator[None]:
    """Other processes take a part of what is `spread` in a block, where it is long enough."""
    if not worthwhile or number() < 2 or _helpers.get() is not None:
        yield
        return
    with helping(min(number() - 1, _MOST), _computing, None) as helpers:
        before = _helpers.set(helpers)
        try:
            yield
        finally:
            _helpers.reset(before)


def spread(
    work: Callable[..., Result], tasks: Sequence[tuple[Any, ...]]
) -> Generator[Result, None, None]:
    """What work gives for the arguments of each task, in their order, by whoever is free.

    Args:
        work: a function of a module.
        tasks: the arguments of each call; what nobody asks for is not begun.
    """
    helpers = _helpers.get()
    if helpers is None:
        yield from (work(*task) for task in tasks)
    else:
        yield from helpers.each([(work, task) for task in tasks])


def many(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """What work, which can be sent, gives for each of many small items, in their order."""
    if _helpers.get() is None:
        return each(work, items)
    size = max(1, math.ceil(len(items) / (_PARTS * min(number(), 1 + _MOST))))
    parts = [(work, items[first : first + size]) for first in range(0, len(items), size)]
    return [one for found in spread(_of_all, parts) for one in found]


def _of_all(work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    return [work(item) for item in items]


def _computing(_: None) -> Callable[[tuple[Callable[..., Any], tuple[Any, ...]]], Any]:
    """What computes a task of `spread`, which spreads nothing itself."""

    def compute(task: tuple[Callable[..., Any], tuple[Any, ...]]) -> Any:
        before = _helpers.set(None)
        try:
            work, given = task
            return work(*given)
        finally:
            _helpers.reset(before)

    return compute
