"""A robot's sensitivities before and after tuning, in every situation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxact.plotting import theme, ticks
from jaxact.plotting.page import page
from jaxact.plotting.tuning import AFTER, BEFORE

_LOWEST, _HIGHEST = 0.05, 50.0


@dataclass(frozen=True)
class Band:
    """Largest singular values over frequency, of all loops of a situation.

    Attributes:
        name: of the situation.
        frequency: w [rad/s], rising, shape (f,).
        sensitivity, complementary: of S and T of each loop [-], shape (l, f).
    """

    name: str
    frequency: np.ndarray
    sensitivity: np.ndarray
    complementary: np.ndarray


def sensitivities(
    before: Sequence[Band], after: Sequence[Band], *, max_peak: float, title: str = "",
    footer: str = "",
) -> Figure:  # fmt: skip
    """Largest singular values of S and T, from the lowest to the highest of each situation's loops.

    Args:
        before, after: of every situation; before may be empty.
        max_peak: the bound that is drawn, inf for none.
        title, footer: above and below.
    """
    number = len(after)
    with theme.applied():
        handles = _handles(before, max_peak)
        width = max(5.2, 3.1 * number + 0.6)
        paper = page(width, 4.9, title=title, footer=footer, entries=len(handles), entry_width=1.5)
        grid = paper.figure.subplots(2, number, sharex="col", sharey=True, squeeze=False)
        draw(grid, before, after, max_peak=max_peak)
        paper.legend(handles)
    return paper.figure


def draw(
    grid: np.ndarray, before: Sequence[Band], after: Sequence[Band], *, max_peak: float
) -> list[Artist]:
    """As `sensitivities`, on given axes: S above T, a column a situation. Returns a legend."""
    for column in range(len(after)):
        for bands, color in ((before, BEFORE), (after, AFTER)):
            if bands:
                _band(grid[:, column], bands[column], color)
        grid[0, column].set_title(after[column].name)
        grid[1, column].set_xlabel("frequency [rad/s]")
    for row, symbol in zip(grid, "ST", strict=True):
        row[0].set_ylabel(f"σmax({symbol})")
        for axes in row:
            if np.isfinite(max_peak):
                axes.axhline(max_peak, color=theme.INK, linestyle="--", linewidth=1.0)
            axes.grid(visible=True, which="major")
    return _handles(before, max_peak)


def _handles(before: Sequence[Band], max_peak: float) -> list[Artist]:
    handles: list[Artist] = [Patch(color=AFTER, alpha=0.7, label="after")]
    if before:
        handles.append(Patch(color=BEFORE, alpha=0.7, label="before"))
    if np.isfinite(max_peak):
        handles.append(Line2D([], [], color=theme.INK, ls="--", lw=1.0, label="largest allowed"))
    return handles


def _band(axes, band: Band, color: str) -> None:
    for panel, values in zip(axes, (band.sensitivity, band.complementary), strict=True):
        panel.fill_between(
            band.frequency, values.min(axis=0), values.max(axis=0), color=color, alpha=0.35,
            linewidth=0.0,
        )  # fmt: skip
        panel.plot(band.frequency, values.max(axis=0), color=color, linewidth=1.5)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xlim(band.frequency[0], band.frequency[-1])
        panel.set_ylim(_LOWEST, _HIGHEST)
        ticks.label(panel.xaxis)
        ticks.label(panel.yaxis)
