"""The page of one picture: title above, legend and small print below, panels between."""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path

from jaxact.plotting import theme

_LETTERS_PER_INCH = 16.5
_HANDLE = 0.5  # of a legend [inch], with the room beside it
_LEGEND_LINE, _FOOTER_LINE = 0.185, 0.15


@dataclass(frozen=True)
class Page:
    """A figure with room reserved below its panels.

    Attributes:
        figure: the figure; panels added to it stay clear of title, legend and footer.
        columns: entries of the legend side by side.
        legend_bottom: lower edge of the legend as a fraction of the height.
    """

    figure: Figure
    columns: int
    legend_bottom: float

    def legend(self, handles: Sequence[Artist]) -> None:
        """Draw the legend into its room."""
        if not handles:
            return
        self.figure.legend(
            handles=list(handles), loc="lower center", bbox_to_anchor=(0.5, self.legend_bottom),
            ncols=min(len(handles), self.columns), handlelength=2.6, columnspacing=1.6,
            borderaxespad=0.0, borderpad=0.0, labelspacing=0.45,
        )  # fmt: skip


def page(
    width: float,
    height: float,
    *,
    title: str = "",
    footer: str = "",
    entries: int = 0,
    entry_width: float = 2.3,
) -> Page:
    """A page whose panels, with their labels, get width x height.

    Args:
        width, height: of the panels [inch].
        title: above, wrapped to at most two lines, "" for none.
        footer: small print below, wrapped to the width, "" for none.
        entries: how many entries the legend will have.
        entry_width: room of one entry [inch]; fewer stand side by side where it is large.
    """
    letters = int(width * _LETTERS_PER_INCH)
    lines = [part for line in footer.splitlines() for part in textwrap.wrap(line, letters)]
    columns = max(1, int(width / entry_width))
    small_print = 0.07 + _FOOTER_LINE * len(lines)
    strip = small_print + _LEGEND_LINE * math.ceil(entries / columns) + 0.01
    heading = _heading(title, width)
    top = 0.16 + 0.18 * len(heading) if heading else 0.06
    total = height + strip + top
    figure = Figure(figsize=(width, total))
    figure.set_layout_engine(
        "constrained", rect=(0, strip / total, 1, 1 - (strip + top) / total),
        w_pad=0.05, h_pad=0.04, wspace=0.01, hspace=0.01,
    )  # fmt: skip
    if heading:
        figure.suptitle(
            "\n".join(heading), x=0.5, y=1 - 0.09 / total, fontsize=11, fontweight="bold", va="top",
        )  # fmt: skip
    if lines:
        figure.text(
            0.5, 0.05 / total, "\n".join(lines), ha="center", va="bottom", fontsize=7.5,
            color=theme.SMALL_PRINT, linespacing=1.25,
        )  # fmt: skip
    return Page(figure, columns, small_print / total)


def column(labels: Sequence[str], width: float) -> list[str]:
    """Labels of a legend of one column, those that are too long broken into lines.

    The legend takes as many entries of room as there are lines, see `lines`.

    Args:
        width: of the panels [inch].
    """
    return ["\n".join(_broken(label, 72.0 * (width - _HANDLE))) for label in labels]


def lines(labels: Sequence[str]) -> int:
    """How many lines these labels take."""
    return sum(label.count("\n") + 1 for label in labels)


def _broken(label: str, room: float) -> list[str]:
    """Lines that fit into a width [points], broken after commas and colons."""
    lines = [""]
    for part in re.split(r"(?<=[,:]) ", label):
        longer = f"{lines[-1]} {part}" if lines[-1] else part
        if not lines[-1] or _width(longer) <= room:
            lines[-1] = longer
        else:
            lines.append(f"    {part}")
    return lines


def _width(text: str) -> float:
    """Of one line in a legend [points]."""
    font = FontProperties(family=theme.RC["font.sans-serif"], size=theme.RC["legend.fontsize"])
    return float(text_to_path.get_text_width_height_descent(text, font, ismath=False)[0])


def _heading(title: str, width: float) -> list[str]:
    letters = int(width * 10.5)
    lines = textwrap.wrap(title, letters)
    if len(lines) <= 2:
        return lines
    return [lines[0], textwrap.shorten(" ".join(lines[1:]), letters, placeholder=" …")]
