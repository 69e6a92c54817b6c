"""One picture that is understood at once: the delay that published gains bear."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from jaxact.plotting import look

# Delay that is in the loop by where it closes [ms]: orders of magnitude, not measurements.
PLACES = ((0.1, 1.0, "in the motor's drive"), (2.0, 10.0, "on a host, over a bus"))
LOOKS = {
    "ideal": (look.BLUE, "o", "ideal actuator"),
    "hyq": (look.GREEN, "s", "HyQ's actuator"),
    "starleth": (look.VERMILION, "D", "StarlETH's actuator"),
}
LOW, HIGH = 0.1, 200.0


def write(found: list[dict[str, Any]], folder: Path) -> None:
    """Write delay_margins.png."""
    look.write(margins(found), folder / "delay_margins.png", title="delay that gains bear")


def margins(found: list[dict[str, Any]]) -> Figure:
    """Delay borne on a stand, one robot a line, the least at the top."""
    order = sorted(found, key=lambda row: row["stand"]["ideal"]["delay"] or 0.0)
    with look.look():
        figure = Figure(figsize=(8.6, 1.6 + 0.34 * len(order)), layout="constrained")
        axes = figure.add_subplot()
        for low, high, words in PLACES:
            axes.axvspan(low, high, color=look.GRID, alpha=0.6, linewidth=0.0)
            axes.text(np.sqrt(low * high), -0.85, words, ha="center", va="bottom", fontsize=8)
        for place, row in enumerate(order):
            delays = [row["stand"][name]["delay"] for name in LOOKS]
            known = [1e3 * delay for delay in delays if delay]
            if known:
                axes.plot([min(known), max(known)], [place, place], color=look.FAINT, linewidth=1.0)
            for (colour, marker, _), delay in zip(LOOKS.values(), delays, strict=True):
                if delay:
                    axes.plot([1e3 * delay], [place], marker, color=colour, markersize=6.0)
                else:  # it shakes without any delay
                    axes.plot([1.15 * LOW], [place], "x", color=colour, markersize=6.0)
            joint = row["stand"]["ideal"]["joint"]
            axes.text(HIGH * 0.95, place, joint, ha="right", va="center", fontsize=7.5)
        for colour, marker, words in LOOKS.values():
            axes.plot([], [], marker, color=colour, label=words)
        axes.plot([], [], "x", color=look.INK, label="shakes without any delay")
        axes.set_yticks(range(len(order)), [f"{r['robot']} ({r['publisher']})" for r in order])
        axes.set_ylim(len(order) - 0.4, -1.4)
        axes.set_xscale("log")
        axes.set_xlim(LOW, HIGH)
        ticks = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100]
        axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.grid(visible=True, axis="x")
        axes.set_xlabel("delay in the loop at which the robot on a stand begins to shake [ms]")
        axes.set_title("How much delay do the gains that robots ship with bear?")
        figure.legend(loc="outside lower center", ncols=4)
    return figure
