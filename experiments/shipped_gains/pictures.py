"""One picture that is understood at once: the delay that published gains bear."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxact.plotting import theme

# Delay that is in the loop by where it closes [ms]: orders of magnitude, not measurements.
PLACES = ((0.1, 1.0, "usual in a motor's drive"), (2.0, 10.0, "usual on a host, over a bus"))
LOOKS = {
    "ideal": (theme.BLUE, "o", "ideal actuator (bar)"),
    "hyq": (theme.GREEN, "s", "HyQ's actuator"),
    "starleth": (theme.VERMILION, "D", "StarLETH's actuator"),
}
LOW, HIGH = 0.1, 100.0
BAR = "#BFD9EC"


def write(found: list[dict[str, Any]], folder: Path) -> None:
    """Write delay_margins.png."""
    theme.write(margins(found), folder / "delay_margins.png", title="delay that gains bear")


def margins(found: list[dict[str, Any]]) -> Figure:
    """Delay borne on a stand, one robot a line, the least at the top."""
    order = sorted(found, key=lambda row: row["stand"]["ideal"]["delay"] or 0.0)
    with theme.applied():
        figure = Figure(figsize=(10.4, 2.1 + 0.36 * len(order)), layout="constrained")
        figure.set_layout_engine("constrained", rect=(0.0, 0.0, 0.96, 1.0))
        axes = figure.add_subplot()
        _places(axes, len(order))
        for place, row in enumerate(order):
            _robot(axes, place, row)
        _columns(axes, order)
        axes.set_yticks(range(len(order)), [f"{r['robot']} ({r['publisher']})" for r in order])
        axes.set_ylim(len(order) - 0.4, -1.1)
        axes.set_xscale("log")
        axes.set_xlim(LOW, HIGH)
        ticks = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.tick_params(axis="y", length=0)
        axes.set_xlabel("delay in the loop at which the robot on a stand begins to shake [ms]")
        figure.suptitle(
            "How much delay in the loop do the gains bear that robots ship with?",
            fontsize=11, fontweight="bold",
        )  # fmt: skip
        _legend(figure, axes)
    return figure


def _places(axes: Axes, rows: int) -> None:
    """Where the PD loop may close, and the delay that is usual there."""
    for low, high, words in PLACES:
        axes.axvspan(low, high, color=theme.GRID, alpha=0.55, linewidth=0.0, zorder=0)
        axes.text(np.sqrt(low * high), -0.75, words, ha="center", va="center", fontsize=8)
    for place in range(rows):
        axes.axhline(place + 0.5, color="white", linewidth=0.8, zorder=0.5)


def _robot(axes: Axes, place: int, row: dict[str, Any]) -> None:
    """One line: a bar up to what is borne with an ideal actuator, marks for the others."""
    ideal, left = row["stand"]["ideal"]["delay"], 1.18 * LOW
    if ideal:
        axes.barh(place, 1e3 * ideal - LOW, left=LOW, height=0.5, color=BAR, zorder=1)
    for name, (colour, marker, _) in LOOKS.items():
        delay, shakes = row["stand"][name]["delay"], row["stand"][name]["frequency"] is not None
        if delay:
            axes.plot([1e3 * delay], [place], marker, color=colour, markersize=6.0, zorder=3)
        elif shakes:  # without any delay
            axes.plot([left], [place], "x", color=colour, markersize=6.0, zorder=3)
            left *= 1.3
    tuned = row["tuned"]
    if tuned["delay"] and tuned["certified"]:
        axes.plot([1e3 * tuned["delay"]], [place], "*", color=theme.YELLOW, markersize=10.0,
                  markeredgecolor=theme.INK, markeredgewidth=0.7, zorder=2.5)  # fmt: skip


def _columns(axes: Axes, order: list[dict[str, Any]]) -> None:
    """Which joint shakes first, and how stiff tuned gains are."""
    for at, heading, text in (
        (1.02, "shakes first", lambda row: row["stand"]["ideal"]["joint"]),
        (1.24, "stiffness\nif tuned", stiffness),
    ):
        axes.text(at, -0.75, heading, transform=axes.get_yaxis_transform(), fontsize=8,
                  fontweight="bold", va="center")  # fmt: skip
        for place, row in enumerate(order):
            axes.text(at, place, text(row), transform=axes.get_yaxis_transform(), fontsize=8,
                      va="center")  # fmt: skip


def stiffness(row: dict[str, Any]) -> str:
    """Of the tuned gains, as a multiple of the published."""
    tuned = row["tuned"]
    return f"× {tuned['stiffness']:.2g}" if tuned["certified"] else "none found"


def _legend(figure: Figure, axes: Axes) -> None:
    for colour, marker, words in LOOKS.values():
        axes.plot([], [], marker, color=colour, label=words)
    axes.plot([], [], "x", color=theme.INK, label="shakes without any delay")
    axes.plot([], [], "*", color=theme.YELLOW, markersize=10.0, markeredgecolor=theme.INK,
              markeredgewidth=0.7, label="gains tuned for Ms ≤ 2 at 5 ms, ideal")  # fmt: skip
    figure.legend(loc="outside lower center", ncols=5)
