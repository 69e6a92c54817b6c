"""Tables as text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table


def table(*heads: str, no_wrap: bool = False, **style: Any) -> Table:
    """A table with a line below its heads, whose first column is of names, the others of numbers.

    Args:
        heads: of the columns.
        no_wrap: whether no cell is broken into lines.
        style: of `rich.table.Table`.
    """
    from rich import box
    from rich.table import Table

    made = Table(box=box.SIMPLE_HEAD, pad_edge=False, **style)
    for place, head in enumerate(heads):
        made.add_column(head, justify="right" if place else "left", no_wrap=no_wrap)
    return made


def rendered(*parts: Any, width: int) -> str:
    """What `rich` prints of some parts at a width [characters], without spaces at its ends."""
    from rich.console import Console

    # What is in brackets is a unit, and what is between colons a name.
    console = Console(width=width, highlight=False, markup=False, emoji=False)
    with console.capture() as captured:
        for part in parts:
            console.print(part)
    return "\n".join(line.rstrip() for line in captured.get().rstrip().splitlines())
