"""Sensitivity |S| and complementary sensitivity |T| of one or several loops, peaks marked."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxact.plotting import theme, ticks
from jaxact.plotting.page import column, lines, page
from jaxact.plotting.response import LoopResponse, curve_styles, frequency_axis, number


def sensitivity(responses: Sequence[LoopResponse], *, title: str = "", footer: str = "") -> Figure:
    """|S(jw)| = |1/(1 + L)| and |T(jw)| = |L/(1 + L)|, with the peaks Ms and Mt.

    Args:
        responses: at least one loop; an unstable one is drawn faint, its peaks say nothing.
        title, footer: above and below.
    """
    with theme.applied():
        labels = column([_described(response) for response in responses], 7.4)
        paper = page(7.4, 5.6, title=title, footer=footer, entries=lines(labels), entry_width=7.4)
        upper, lower = paper.figure.subplots(2, 1, sharex=True)
        draw((upper, lower), responses, labels)
        paper.legend(upper.get_legend_handles_labels()[0])
    return paper.figure


def draw(axes: Sequence[Axes], responses: Sequence[LoopResponse], labels: Sequence[str]) -> None:
    """The same on given axes, without a legend.

    Args:
        axes: of |S| and of |T|.
        responses: at least one loop.
        labels: what each is called in a legend.
    """
    upper, lower = axes
    for response, label, line in zip(responses, labels, curve_styles(responses), strict=True):
        faint = {} if response.stable else {"alpha": 0.45, "linewidth": 1.0}
        upper.plot(response.frequency, np.abs(response.sensitivity), label=label, **(line | faint))
        lower.plot(response.frequency, np.abs(response.complementary), **(line | faint))
        _peak(upper, response, "sensitivity_peak", line["color"])
        _peak(lower, response, "complementary_peak", line["color"])
    _dress(upper, lower, responses)


def _described(response: LoopResponse) -> str:
    """`HyQ, 1 ms: Ms 1.2 at 90 rad/s, Mt 1.3 at 30 rad/s`."""
    if not response.stable:
        return f"{response.label}: unstable, its peaks say nothing"
    words = []
    for symbol, name in (("Ms", "sensitivity_peak"), ("Mt", "complementary_peak")):
        peak, at = response.margin(name), response.margin(f"{name}_frequency")
        if peak is not None:
            where = f" at {number(at)} rad/s" if at is not None else ""
            words.append(f"{symbol} {number(peak)}{where}")
    return f"{response.label}: {', '.join(words)}" if words else response.label


def _peak(axes: Axes, response: LoopResponse, name: str, color: object) -> None:
    peak, at = response.margin(name), response.margin(f"{name}_frequency")
    if peak is None or at is None or at <= 0.0:
        return
    axes.plot(
        [at], [peak], marker="o", markersize=5.5, markerfacecolor="white", color=color, zorder=5,
        clip_on=True,
    )  # fmt: skip


def _dress(upper: Axes, lower: Axes, responses: Sequence[LoopResponse]) -> None:
    for axes, symbol in ((upper, "S"), (lower, "T")):
        frequency_axis(axes, responses, label=axes is lower)
        curves = [r.sensitivity if symbol == "S" else r.complementary for r in responses]
        peak = max(float(np.nanmax(np.abs(curve))) for curve in curves)
        axes.set_yscale("log")
        axes.set_ylim(0.01, max(2.0, min(1.3 * peak, 100.0)))
        ticks.label(axes.yaxis)
        axes.axhline(1.0, color=theme.INK, linewidth=0.9, zorder=1)
        axes.set_ylabel(f"|{symbol}(jω)|")
