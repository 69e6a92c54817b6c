"""Ctrl-C and SIGTERM: raised where they arrive, and again if they were swallowed there.

An exception that a signal raises inside a callback of a compiled library is printed or dropped by
it. Long work therefore also asks `check` from time to time.
"""

from __future__ import annotations

import signal
import sys
from types import FrameType


class Terminated(BaseException):
    """The process was asked to end (SIGTERM)."""


_received: list[int] = []


def listen() -> None:
    """Raise KeyboardInterrupt on Ctrl-C and Terminated on SIGTERM from now on."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _arrived)
    sys.unraisablehook = _unraisable


def check() -> None:
    """Raise what a signal that has arrived should have raised."""
    if _received:
        raise Terminated if _received[0] == signal.SIGTERM else KeyboardInterrupt


def _unraisable(lost: sys.UnraisableHookArgs) -> None:
    """Say nothing of a signal that was swallowed: `check` raises it again."""
    if not issubclass(lost.exc_type, KeyboardInterrupt | Terminated):
        sys.__unraisablehook__(lost)


def _arrived(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    check()
