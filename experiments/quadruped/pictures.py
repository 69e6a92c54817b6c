"""The pictures: a map of stability, and how a joint moves."""

from __future__ import annotations

from collections.abc import Mapping

import cases
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import SymLogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from motions import Runs
from study import Situation

from jaxact.plotting import theme, wording
from jaxact.plotting.page import page

TITLES = {"stand": "on four feet", "three": "on three feet", "hang": "hanging"}
# Growth rates [1/s]: linear within the first, all colours used up at the second.
_LINEAR, _MOST = 1.0, 300.0


def stability_map(found: Mapping[str, Situation], rollout: float) -> Figure:
    """Growth rate over gain scale and delay: a row for each situation, a column an actuator.

    found: results by situation
    rollout: duration of the rollouts whose limits are marked [s]
    """
    norm = SymLogNorm(_LINEAR, vmin=-_MOST, vmax=_MOST, base=10)
    footer = (
        "Growth rate of the linearised loop; both gains of all joints times the gain scale; control"
        " at 1 kHz. Delay: half of it on measurements, half on commands. Circles: largest gain"
        f" scale at which nonlinear rollouts of {rollout:g} s still die out."
    )
    with theme.applied():
        paper = page(8.6, 2.35 * len(found) + 0.4, footer=footer, entries=3,
                      title="Where the quadruped is stable: gains, delay, actuator")  # fmt: skip
        grid = paper.figure.subplots(
            len(found), len(cases.ACTUATORS), sharex=True, sharey=True, squeeze=False
        )
        for row, (name, situation) in enumerate(found.items()):
            for column, actuator in enumerate(cases.ACTUATORS):
                axes = grid[row, column]
                _panel(axes, situation, column, norm)
                if row == 0:
                    axes.set_title(f"{wording.display_name(actuator)} actuator", pad=4)
            grid[row, 0].set_ylabel("delay [ms]")
            grid[row, -1].text(
                1.03, 0.5, TITLES[name], transform=grid[row, -1].transAxes, rotation=270,
                ha="left", va="center", fontsize=9.5,
            )  # fmt: skip
        for axes in grid[-1]:
            axes.set_xlabel("gain scale")
        bar = paper.figure.colorbar(
            ScalarMappable(norm, theme.diverging()), ax=grid, extend="both", fraction=0.05,
            pad=0.012, aspect=32, shrink=0.97,
        )  # fmt: skip
        bar.set_label("growth rate [1/s]")
        bar.set_ticks([-100, -10, -1, 0, 1, 10, 100])
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        bar.ax.yaxis.set_minor_locator(NullLocator())
        paper.legend(
            [
                Line2D([], [], color="black", label="limit of the linearised loop"),
                Line2D([], [], color="white", markerfacecolor="white", markeredgecolor="black",
                       marker="o", markersize=6, label="limit of nonlinear rollouts"),
                Line2D([], [], color=theme.INK, ls=(0, (4, 2)), lw=1.0,
                       label="nominal and tripled gains"),
            ]
        )  # fmt: skip
    return paper.figure


def _panel(axes, situation: Situation, column: int, norm: SymLogNorm) -> None:
    shown = situation.map
    growth = shown.growth_rates[column]
    axes.pcolormesh(
        _log_edges(shown.scales), _edges(1e3 * shown.delays), growth, cmap=theme.diverging(),
        norm=norm, rasterized=True,
    )  # fmt: skip
    if (growth > 0.0).any() and (growth < 0.0).any():
        # Squashed like the colours, so that the line stands where the sign changes.
        axes.contour(
            shown.scales, 1e3 * shown.delays, np.asarray(norm(growth)) - 0.5, levels=[0.0],
            colors="black", linewidths=1.4,
        )  # fmt: skip
    for scale in cases.SCALES:
        axes.axvline(scale, color=theme.INK, linestyle=(0, (4, 2)), linewidth=1.0)
    here = [one for one in situation.critical if one.actuator == cases.ACTUATORS[column]]
    axes.plot(
        [one.rollouts for one in here], [1e3 * one.delay for one in here], "o", clip_on=False,
        markerfacecolor="white", markeredgecolor="black", markersize=6, zorder=5,
    )  # fmt: skip
    axes.set_xscale("log")
    axes.set_xlim(shown.scales[0], shown.scales[-1])
    axes.set_ylim(0.0, 1e3 * shown.delays[-1])
    axes.xaxis.set_major_locator(FixedLocator([0.3, 0.5, 1, 2, 3, 5]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_locator(NullLocator())


def _edges(values: np.ndarray) -> np.ndarray:
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]])


def _log_edges(values: np.ndarray) -> np.ndarray:
    return np.exp(_edges(np.log(values)))


def traces(runs: Runs, joint: str, words: str, until: float) -> Figure:
    """A joint's position and force: bare on the left, with the drive on the right.

    joint: its name
    words: what it is, for people
    until: how much is shown [s]
    """
    actuator, delay = wording.display_name(runs.actuator), wording.quantity(runs.delay, "s")
    drive = f"{actuator} actuator, {delay} delay"
    columns = {"bare": runs.bare, f"{drive}, sensors": runs.drive}
    place = runs.joint(joint)
    push = runs.specification.push
    footer = "" if push is None else (
        f"Push on {push.body}: {np.linalg.norm(push.impulse):g} N s within"
        f" {1e3 * push.duration:g} ms from {push.time:g} s (grey). Sensors: the specification's"
        " noise, quantisation and bias."
    )  # fmt: skip
    with theme.applied():
        paper = page(8.6, 4.4, footer=footer, entries=2, title=f"{joint}, {words}")
        grid = paper.figure.subplots(2, 2, sharex=True, sharey="row")
        for axes, (name, pair) in zip(grid.T, columns.items(), strict=True):
            axes[0].set_title(name, pad=4)
            # the tripled ones below, as they may cover everything
            for number in (1, 0):
                path = pair[number].trajectory
                color = (theme.BLUE, theme.VERMILION)[number]
                moved = 1e3 * (path.position[:, place] - path.setpoint[0, place])
                axes[0].plot(path.time, moved, color=color, linewidth=1.1)
                axes[1].plot(path.time, path.force[:, place], color=color, linewidth=0.9)
            for each in axes:
                each.grid(visible=True)
                each.set_xlim(0.0, until)
                if push is not None:
                    each.axvspan(push.time, push.time + push.duration, color=theme.GRID, lw=0)
            axes[1].set_xlabel("time [s]")
        grid[0, 0].set_ylabel("position from posture [mrad]")
        grid[1, 0].set_ylabel("torque [N m]")
        paper.legend(
            [
                Line2D([], [], color=theme.BLUE, label="nominal gains"),
                Line2D([], [], color=theme.VERMILION, label="tripled gains"),
            ]
        )
        paper.figure.align_ylabels()
    return paper.figure
