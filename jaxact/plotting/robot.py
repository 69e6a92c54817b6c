"""A robot's sensitivities, of all joints at once and of each, and which joints take part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxact.analysis.robot.changes import Change
from jaxact.analysis.robot.margins import RobotMargins
from jaxact.analysis.robot.modes import Mode
from jaxact.analysis.robot.multiloop import Curves
from jaxact.plotting import theme, ticks
from jaxact.plotting.page import page
from jaxact.plotting.response import number

# Joints whose curves are named in the legend: the least robust, or those that move most.
MOST_NAMED = 5
_DECADES = 1e6
_LOWEST = 0.02


def whole_robot(
    curves: Curves, margins: RobotMargins, *, title: str = "", footer: str = ""
) -> Figure:
    """Largest singular values of S and T, |S_ii| and |T_ii| of each joint, and two motions.

    The bars are the joints' shares in the kinetic energy of the least damped or fastest growing
    mode, of what shakes first with more delay, and of the response at the peak of the largest
    singular value of S.

    Args:
        curves, margins: of the same loop.
        title, footer: above and below.
    """
    with theme.applied():
        entries = 1 + len(_named(margins))
        paper = page(9.4, 5.6, title=title, footer=footer, entries=entries, entry_width=1.9)
        grid = paper.figure.add_gridspec(2, 2, width_ratios=(2.1, 1.0))
        upper = paper.figure.add_subplot(grid[0, 0])
        lower = paper.figure.add_subplot(grid[1, 0], sharex=upper)
        draw((upper, lower, paper.figure.add_subplot(grid[:, 1])), curves, margins)
        paper.legend(upper.get_legend_handles_labels()[0])
    return paper.figure


def draw(axes: Sequence[Axes], curves: Curves, margins: RobotMargins) -> None:
    """As `whole_robot`, on given axes: of S, of T, and of the joints' shares."""
    upper, lower, bars = axes
    named = _named(margins)
    _sensitivities(upper, curves, named, "S")
    _sensitivities(lower, curves, named, "T")
    _frequency_axis(upper, lower, curves)
    if margins.whole is not None:
        whole = margins.whole
        _peak(upper, whole.sensitivity_peak, whole.sensitivity_peak_frequency, "Ms")
        _peak(lower, whole.complementary_peak, whole.complementary_peak_frequency, "Mt")
    else:
        upper.set_title("unstable: its peaks say nothing", color=theme.VERMILION)
    _shares(bars, curves.names, margins)


def _named(margins: RobotMargins) -> list[int]:
    """The joints whose curves are named: those that shake first, or move most."""
    shares = margins.critical.participation
    return (margins.ranking or np.argsort(-shares, kind="stable").tolist())[:MOST_NAMED]


def _sensitivities(axes: Axes, curves: Curves, named: list[int], symbol: str) -> None:
    largest, own = (
        (curves.sensitivity, curves.own_sensitivity)
        if symbol == "S"
        else (curves.complementary, curves.own_complementary)
    )
    for joint in range(own.shape[1]):
        if joint not in named:
            axes.plot(curves.frequency, own[:, joint], color=theme.FAINT, linewidth=0.7, alpha=0.7)
    axes.plot(curves.frequency, largest, color=theme.BLACK, linewidth=2.0, label="all joints: σmax")
    for place, joint in enumerate(named):
        style = theme.style(place) | {"linewidth": 1.1, "label": curves.names[joint]}
        axes.plot(curves.frequency, own[:, joint], **style)
    top = float(np.nanmax(largest))
    axes.set_yscale("log")
    axes.set_ylim(_LOWEST, max(2.0, min(1.4 * top, 1e3)))
    ticks.label(axes.yaxis)
    axes.axhline(1.0, color=theme.INK, linewidth=0.9, zorder=1)
    axes.grid(visible=True, which="major")
    axes.set_ylabel(f"σmax({symbol}), |{symbol}ii|")


def _frequency_axis(upper: Axes, lower: Axes, curves: Curves) -> None:
    """From where anything happens to the Nyquist frequency."""
    high = float(curves.frequency[-1])
    low = max(float(curves.frequency[0]), high / _DECADES)
    for axes in (upper, lower):  # which a caller need not have made to share theirs
        axes.set_xscale("log")
        axes.set_xlim(low, high)
    ticks.label(lower.xaxis)
    lower.set_xlabel("frequency [rad/s]")
    upper.tick_params(labelbottom=False)


def _peak(axes: Axes, peak: float, at: float, symbol: str) -> None:
    """The peak, marked; at no frequency it is said only."""
    text = f"{symbol} {number(peak)}"
    if at > axes.get_xlim()[0]:
        axes.plot([at], [peak], "o", markersize=5.5, markerfacecolor="white", color=theme.BLACK)
        text += f" at {number(at)} rad/s"
    # Above the curves, whose peak may be anywhere.
    axes.set_title(text, loc="right", fontsize=8, pad=3.0)


def _shares(axes: Axes, names: tuple[str, ...], margins: RobotMargins) -> None:
    """Bars of the joints' shares, in the robot's order from above."""
    places = np.arange(len(names), dtype=float)
    critical = margins.critical
    kind = "least damped mode" if margins.stable else "fastest growing mode"
    motions: list[tuple[Mode | Change, str, str]] = [
        (critical, theme.BLUE, f"{kind}, {number(critical.frequency)} rad/s")
    ]
    later = margins.changes.more_delay
    if later is not None:
        label = f"shakes {number(1e3 * later.value)} ms later, {number(later.frequency)} rad/s"
        motions.append((later, theme.VERMILION, label))
    if margins.at_peak is not None:
        at_peak = margins.at_peak
        motions.append(
            (at_peak, theme.ORANGE, f"response at Ms, {number(at_peak.frequency)} rad/s")
        )
    height = 0.8 / len(motions)
    for row, (motion, colour, label) in enumerate(motions):
        offset = (row - 0.5 * (len(motions) - 1)) * height
        axes.barh(places + offset, 100.0 * motion.participation, height, color=colour, label=label)
    axes.set_yticks(places, names)
    axes.set_ylim(len(names) - 0.4, -0.6)
    axes.set_xlabel("share of the kinetic energy [%]")
    axes.grid(visible=True, axis="x")
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.2, fontsize=7.5)
