"""Ctrl-C, SIGTERM and SIGHUP: an end in one line, with the exit code of the signal, at any moment.

While a verb works, the first signal raises an exception where it arrives, so that locks are let go
of and what is done is kept. Before and after that, and from the second signal on, the process ends
at once: results are written whole or not at all, and only what is not finished is removed.

An exception that a signal raises inside a callback of a compiled library is printed or dropped by
it, or comes out as another one. Long work therefore also asks `check` from time to time.
"""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False  # `typing` takes longer to import than all of this
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType, TracebackType
    from typing import TypeVar

    Result = TypeVar("Result")

_NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_NOTHING = "interrupted; nothing unfinished was kept"


class Terminated(BaseException):
    """The process was asked to end (SIGTERM, SIGHUP)."""


_received: list[int] = []
_phase = {"working": False, "over": False, "accepted": False, "held": False}
_words = {"farewell": _NOTHING}


def listen() -> None:
    """Take the signals from now on; one that is ignored (`nohup`) stays ignored."""
    for number in _NUMBERS:
        if number == signal.SIGHUP and signal.getsignal(number) == signal.SIG_IGN:
            continue
        signal.signal(number, _arrived)
    sys.unraisablehook = _unraisable
    sys.excepthook = _uncaught


def taken(work: Callable[[], int]) -> int:
    """The exit code of some work; where a signal has ended it, the process ends here.

    Args:
        work: raises what a signal raises, or says that it was interrupted; returns the exit code.
    """
    import gc

    try:
        _phase["working"] = True
        result = work()
        over()
    except BaseException:
        if not _received:
            raise
        leave()
    if result and result == code():
        leave(None)
    _tidy()
    # Taking the interpreter down, Python would look for garbage in all that goes with the process:
    # a third of a second after JAX was used.
    gc.freeze()
    return result


def over() -> None:
    """The work has ended, and nothing that arrives now changes how."""
    _phase["over"] = True


def accept() -> None:
    """The work has taken the signal and goes on to its end; a second one ends the process."""
    _phase["accepted"] = True


def to_the_end(work: Callable[[], Result]) -> Result:
    """What some short work gives, such as writing results; interrupted, it is done once more."""
    try:
        return work()
    except KeyboardInterrupt:
        accept()
        return work()


def keep(farewell: str) -> None:
    """What to say where there is no time to look what was kept."""
    _words["farewell"] = farewell


def farewell() -> str:
    """That the command was interrupted, and what was kept."""
    return _words["farewell"]


def code() -> int:
    """Exit code of the signal that has arrived, 0 where none has."""
    return 128 + _received[0] if _received else 0


def check() -> None:
    """Raise what a signal that has arrived should have raised, unless it is seen to already."""
    seen_to = isinstance(sys.exc_info()[1], KeyboardInterrupt | Terminated)
    if _received and not (seen_to or _phase["accepted"]):
        raise KeyboardInterrupt if _received[0] == signal.SIGINT else Terminated


def leave(words: str | None = "") -> None:
    """End the process at once with the code of its signal.

    Devices may be computing still, and would crash while the interpreter is taken down.

    Args:
        words: what to say, in one line; "": that it was interrupted; None: nothing, it is said
            already.
    """
    over()
    try:
        if words is not None:
            os.write(2, f"jaxact: {words or farewell()}\n".encode(errors="replace"))
        if sys.stdout is not None:
            sys.stdout.flush()
    except (OSError, ValueError, RuntimeError):
        pass  # the terminal has gone, or the signal came while it was written to
    _tidy()
    os._exit(code())


def undivided(work: Callable[[], None]) -> None:
    """Do something short at a stretch: a signal that arrives meanwhile does what it does after."""
    before = len(_received)
    _phase["held"] = True
    try:
        work()
    finally:
        _phase["held"] = False
        if len(_received) > before:
            _answer()


def _tidy() -> None:
    """Remove temporary folders; where that module is not imported whole, there are none."""
    getattr(sys.modules.get("jaxact.files"), "remove_unfinished", int)()


def _arrived(number: int, frame: FrameType | None) -> None:
    if _phase["over"]:
        return
    _received.append(number)
    if not _phase["held"]:
        _answer()


def _answer() -> None:
    if not _phase["working"] or len(_received) > 1:
        leave()
    check()


def _unraisable(lost: sys.UnraisableHookArgs) -> None:
    """Say nothing of a signal that was swallowed: `check` raises it again."""
    if not issubclass(lost.exc_type, KeyboardInterrupt | Terminated):
        sys.__unraisablehook__(lost)


def _uncaught(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """What nobody has caught: a signal between two phases, or a mistake of ours."""
    if _received:
        leave()
    sys.__excepthook__(kind, error, trace)
