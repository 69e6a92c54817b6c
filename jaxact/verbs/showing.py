"""What long work is doing, and how much of it is left: on a terminal and in a notebook."""

from __future__ import annotations

import contextlib
import importlib.util
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

from jaxact.errors import UserError, shown

Told = Callable[..., None]
"""Called with what is being done, how much of it is done, and how much there is at most."""


def silent(text: str, done: int = 0, total: int = 0) -> None:
    """Tell nobody."""


def seen() -> bool:
    """Whether somebody can see what is shown."""
    # In a notebook rich draws with ipywidgets, and warns where they are missing.
    if "ipykernel" in sys.modules:
        return importlib.util.find_spec("ipywidgets") is not None
    return sys.stderr.isatty()


def check(progress: Any) -> None:
    """Raise UserError for what says neither whether progress is shown nor whom to tell."""
    if not (callable(progress) or progress in (True, False, None)):
        raise UserError(f"`progress` = {shown(progress)}; allowed: True, False, or a function")


@contextlib.contextmanager
def steps(progress: bool | Told = True) -> Iterator[Told]:
    """A function that shows what is being done now, for how long already, and what is left of it.

    Args:
        progress: False shows nothing, and nothing is shown either where nobody can see it; a
            function is told instead.
    """
    check(progress)
    if callable(progress):
        yield progress
        return
    if not progress or not seen():
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr="ipykernel" not in sys.modules)
    columns = (
        SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=20),
        TextColumn("{task.fields[left]}"), TimeElapsedColumn(),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("starting", total=None, left="")
        rate = _Rate()

        def say(text: str, done: int = 0, total: int = 0) -> None:
            left = rate.left(text, done, total)
            fields: dict[str, Any] = {"completed": done, "total": total or None, "left": left}
            # What is to come stands below, where it takes no room from bar and time.
            bars.update(task, description=text.replace(", then ", "\nthen ", 1), **fields)

        yield say


class _Rate:
    """How long the parts of what is being done took so far."""

    def __init__(self) -> None:
        self._text, self._since, self._first = "", 0.0, 0

    def left(self, text: str, done: int, total: int) -> str:
        """How many parts are done, and how long all others take if each takes as long."""
        now = time.monotonic()
        if text != self._text:
            self._text, self._since, self._first = text, now, done
        if not total:
            return ""
        counted = done - self._first
        if counted <= 0:
            return f"{done}/{total}"
        seconds = (now - self._since) / counted * (total - done)
        return f"{done}/{total}, about {_time(seconds)} at most"


def _time(seconds: float) -> str:
    """A time for people: rounded up, in seconds or minutes."""
    if seconds < 90.0:
        return f"{max(1, -int(-seconds // 1))} s"
    return f"{-int(-seconds // 60)} min"
