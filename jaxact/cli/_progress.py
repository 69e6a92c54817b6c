"""What long work is doing: a bar with rate and time left, or its phases; on a terminal only."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator

from jaxact.cli import _signals


@contextlib.contextmanager
def bar(total: int, *, quiet: bool = False) -> Iterator[Callable[[int, int], None]]:
    """A function of (loops done, loops in all) that moves the bar on standard error.

    Args:
        total: loops in all.
        quiet: show nothing; nothing is shown either where standard error is not a terminal.
    """
    if quiet or not sys.stderr.isatty():
        yield lambda done, total: _signals.check()
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TextColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Rate(ProgressColumn):
        """Loops per second so far."""

        def render(self, task: Task) -> Text:
            return Text(f"{task.speed:,.0f} loops/s" if task.speed else "")

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        Rate(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("compiling", total=total or None)

        def move(done: int, total: int) -> None:
            _signals.check()
            progress.update(task, description="simulating", completed=done, total=total)

        yield move


@contextlib.contextmanager
def phases(*, quiet: bool = False) -> Iterator[Callable[..., None]]:
    """A function that shows what is being done now, for how long already, and what is left of it.

    Args:
        quiet: show nothing; nothing is shown either where standard error is not a terminal.
    """
    from jaxact.verbs import showing

    with showing.steps(not quiet) as shown:

        def say(text: str, done: int = 0, total: int = 0) -> None:
            _signals.check()
            shown(text, done, total)

        yield say
