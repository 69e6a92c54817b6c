"""What robustness costs, and the colours of every picture of a tuning."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxact.plotting import theme, ticks
from jaxact.plotting.page import page

BEFORE, AFTER = theme.VERMILION, theme.BLUE
HEIGHTS = (1.6, 1.0)
"""Of the panels of a front, the objective's and kd's, relative to each other."""
# Green comes here in the cycle of line styles, and blue is the objective's.
_FIRST = theme.CYCLE.index(theme.GREEN)


def front(
    peaks: np.ndarray,
    values: np.ndarray,
    kd: np.ndarray,
    *,
    label: str,
    kd_unit: str = "N s/m",
    groups: Sequence[str] = ("",),
    marked: tuple[float, float] | None = None,
    title: str = "",
    footer: str = "",
) -> Figure:
    """What robustness costs: the objective against the largest peak allowed, and kd below.

    Args:
        peaks: largest Ms and Mt allowed [-], rising, shape (points,).
        values: of the objective in its unit, NaN where infeasible, shape (points,).
        kd: of the groups of joints, shape (points, groups), or (points,) of a single joint.
        label: of the objective, with unit.
        kd_unit: of kd.
        groups: names of the groups; one without a name is not named.
        marked: a point (peak, value) to mark.
        title, footer: above and below.
    """
    with theme.applied():
        rows = np.reshape(kd, (len(peaks), -1)).T
        named = [name for name in groups if name]
        entries = len(named) + (1 if marked else 0)
        paper = page(6.4, 4.8, title=title, footer=footer, entries=entries)
        axes = paper.figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": HEIGHTS})
        handles = draw_front(axes, peaks, values, rows.T, label=label, kd_unit=kd_unit,
                             groups=groups, marked=marked)  # fmt: skip
        paper.figure.align_ylabels()
        paper.legend(handles)
    return paper.figure


def draw_front(
    axes: Sequence[Axes],
    peaks: np.ndarray,
    values: np.ndarray,
    kd: np.ndarray,
    *,
    label: str,
    kd_unit: str,
    groups: Sequence[str],
    marked: tuple[float, float] | None,
) -> list[Artist]:
    """As `front`, on given axes: of the objective, and of kd. Returns a legend."""
    upper, lower = axes
    upper.plot(peaks, values, marker="o", markersize=4, color=AFTER)
    handles: list[Artist] = []
    for index, (row, name) in enumerate(zip(kd.T, groups, strict=True)):
        color = theme.CYCLE[(_FIRST + index) % len(theme.CYCLE)]
        style = {"marker": theme.MARKERS[index // len(theme.CYCLE)], "markersize": 4,
                 "color": color}  # fmt: skip
        lower.plot(peaks, row, **style)
        if name:
            handles.append(Line2D([], [], **style, label=f"kd of {name}"))
    if marked is not None:
        upper.plot(*marked, marker="*", markersize=13, color=theme.YELLOW,
                   markeredgecolor="black", zorder=5)  # fmt: skip
        handles.append(star("the bound asked for"))
    upper.set_yscale("log")
    ticks.label(upper.yaxis)
    upper.set_ylabel(label)
    if kd.shape[1] > 1:
        lower.set_yscale("log")
        ticks.label(lower.yaxis)
    lower.set_ylabel(f"kd [{kd_unit}]")
    lower.set_xlabel("largest Ms and Mt allowed")
    for one in axes:
        one.grid(visible=True)
    return handles


def star(label: str) -> Artist:
    """Legend entry of the star that marks a result."""
    return Line2D(
        [], [], marker="*", color=theme.YELLOW, markersize=12, markeredgecolor="black", ls="none",
        label=label,
    )  # fmt: skip
