"""Files that a command reads once, however often their content is asked for.

Outside of a command they are read whenever they are asked for, as a notebook's may have changed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Hashable, Iterator
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")

# What was read within `once` by what it is, None outside of it.
_READ: ContextVar[dict[Hashable, object] | None] = ContextVar("read", default=None)


@contextlib.contextmanager
def once() -> Iterator[None]:
    """Read each thing once from here to the end of the block."""
    token = _READ.set({})
    try:
        yield
    finally:
        _READ.reset(token)


def kept(key: Hashable, read: Callable[[], T]) -> T:
    """What `read` returns, or returned for the same key within `once`."""
    known = _READ.get()
    if known is None:
        return read()
    if key not in known:
        known[key] = read()
    return known[key]  # type: ignore[return-value]
