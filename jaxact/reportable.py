"""Results that have a report of themselves, `result.report("file.html")`.

Reports are written by a layer above those that results come from: it says here who writes them, and
results ask here.
"""

from __future__ import annotations

import html
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

_HEIGHT = 900  # of the page in a notebook [px]


@dataclass(frozen=True)
class Report:
    """A report that was written; a path, and in a notebook the page itself.

    Attributes:
        path: of the file.
        text: what is in it.
    """

    path: Path
    text: str = field(repr=False)

    def __fspath__(self) -> str:
        """The path, for whatever opens files."""
        return os.fspath(self.path)

    def _repr_html_(self) -> str:
        # A frame of its own, which may run its script and touch nothing of the notebook.
        return (
            f'<iframe sandbox="allow-scripts" title="{html.escape(self.path.name)}" width="100%"'
            f' height="{_HEIGHT}" srcdoc="{html.escape(self.text)}"></iframe>'
        )


_writers: list[Callable[..., Report]] = []


def written_by(writer: Callable[..., Report]) -> None:
    """Say who writes reports: called as `jaxact.report`, whatever the result."""
    _writers[:] = [writer]


class Reportable:
    """A result that a report can be of."""

    def report(
        self, out: str | os.PathLike[str] = "report.html", *, title: str = "", command: str = ""
    ) -> Report:
        """Write a report of it, one HTML file that one can click: `jaxact.report(self, out)`.

        Args:
            out: HTML file to write; one that is there is replaced.
            title: above the page, "" for what the result says.
            command: that made it, to be shown.

        Returns:
            Where it is; as the last line of a notebook's cell, the page itself.

        Raises:
            UserError: the file cannot be written, or a report cannot be of this result.
        """
        return _writers[0](self, out, title=title, command=command)
