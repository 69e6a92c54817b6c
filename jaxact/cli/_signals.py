"""Ctrl-C and SIGTERM: raised where they arrive, and again if they were swallowed there.

An exception that a signal raises inside a callback of a compiled library is printed or dropped by
it. Long work therefore also asks `check` from time to time.
"""

from __future__ import annotations

import signal
from types import FrameType


class Terminated(BaseException):
    """The process was asked to end (SIGTERM)."""


_received: list[int] = []


def listen() -> None:
    """Raise KeyboardInterrupt on Ctrl-C and Terminated on SIGTERM from now on."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _arrived)


def check() -> None:
    """Raise what a signal that has arrived should have raised."""
    if _received:
        raise Terminated if _received[0] == signal.SIGTERM else KeyboardInterrupt


def _arrived(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    check()
