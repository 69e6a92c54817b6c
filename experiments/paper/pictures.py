"""The study's figures 2, 3 and 4: continuous time on the left, sampled and simulated on the right.

Colour is the delay and the dash the damping ratio, in every picture over the natural frequency.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import study
from claims_on_motion import actuator_step
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

from jaxact.plotting import theme, wording
from jaxact.plotting.page import Page, page
from results import Results

_COLOURS = (theme.BLUE, theme.GREEN, theme.VERMILION)
_DASHES: tuple[Any, ...] = ((0, (5, 1.8)), "-")
_MARKS = ("o", "s")
_ROBOT_MARKS = {"hyq": "*", "starleth": "P"}
_SHADES = ("#0B3C7D", "#2A7FB8", "#3FA66B", "#D98B1F", "#A8321A")
_BARE: dict[str, Any] = {"color": theme.BLACK, "linestyle": "--", "linewidth": 1.0}
_COLUMNS = {
    "continuous": "continuous time, exact",
    "sampled": "control at 1 kHz: exact (lines), simulated (marks)",
}
_GAINS = f"kp {study.KP:g} N/m, kd {study.KD:g} N s/m, mass {study.MASS:g} kg"
_STUDY = "Neunert, Boaventura, Buchli, figure"


def steps(results: Results) -> Figure:
    """Figure 2: steps of the actuator's force and of the joint.

    Args:
        results: from `results.compute`.
    """
    with theme.applied():
        handles = [
            *(_shade(colour, wn) for colour, wn in zip(_SHADES, study.SHOWN, strict=True)),
            Line2D([], [], color=theme.BLACK, linestyle="--", label="no dynamics, no delay"),
        ]
        late = study.DELAYS[study.NOMINAL_DELAY]
        paper = page(
            8.6, 5.4, title="Steps of the actuator's force, and of the joint",
            entries=len(handles), entry_width=2.2,
            footer=f"{_STUDY} 2. {_GAINS}; {wording.quantity(late, 's')} of delay. Force: exact, "
            "after a step of its command. Joint: simulated, control at 1 kHz, after a step of the "
            "setpoint.",
        )  # fmt: skip
        grid = paper.figure.subplots(len(study.DAMPING_RATIOS), 2, sharex="col", squeeze=False)
        since = np.linspace(0.0, 0.08, 801)
        for z, zeta in enumerate(study.DAMPING_RATIOS):
            force, joint = grid[z]
            for s, colour in enumerate(_SHADES):
                acting = actuator_step(study.SHOWN[s], zeta, since - late)
                force.plot(1e3 * since, acting, color=colour)
                joint.plot(_since(results.shown_steps), results.shown_steps[z, s], color=colour)
            force.plot([0.0, 0.0, 80.0], [0.0, 1.0, 1.0], **_BARE)
            joint.plot(_since(results.robot_steps), results.robot_steps[0, 0], **_BARE)
            for axes, what in ((force, "force"), (joint, "position")):
                axes.set_title(f"ζ {zeta:g}")
                axes.set_ylabel(f"{what} / step [-]")
                axes.grid(visible=True)
            joint.set_xlim(0.0, 0.4)
            joint.set_ylim(0.0, 1.7)
        grid[-1, 0].set_xlabel("time [ms]")
        grid[-1, 1].set_xlabel("time [s]")
        paper.legend(handles)
    return paper.figure


def margins(results: Results) -> Figure:
    """Figure 3: gain margin, the phase margin that the study calls delay margin, the delay margin.

    Args:
        results: from `results.compute`.
    """
    with theme.applied():
        paper, grid = _sheet(
            3, 8.4, "Margins over the actuator's natural frequency",
            f"{_STUDY} 3. {_GAINS}. Gain margin: factor on both gains at which the loop turns "
            "unstable. What the study calls delay margin is a phase margin, in degrees; the delay "
            "margin is the delay that can be added. Marks: bisected on the growth rate of "
            "simulated loops. Thin lines at the right: no actuator dynamics (gain margin without "
            "delay ∞ in continuous time).",
        )  # fmt: skip
        rows = (
            ("gain_margin", "gain margin [-]", 1.0, _same),
            ("phase_margin", "phase margin [deg]", 0.0, np.degrees),
            ("delay_margin", "delay margin [ms]", 0.0, _milli),
        )
        for (name, label, least, scale), panels in zip(rows, grid, strict=True):
            for axes, kind in zip(panels, _COLUMNS, strict=True):
                _families(axes, results, kind, name, at_boundary=least, scale=scale)
                _ideal(axes, results, kind, name, scale)
                if kind == "sampled" and name in results.simulated_curves:
                    _simulated(axes, results, name, scale)
            panels[0].set_ylabel(label)
        for axes in grid[0]:
            _log_axis(axes, 1.0, 90.0, (1, 2, 3, 5, 10, 20, 30, 50))
        grid[1, 0].set_ylim(0.0, 62.0)
        grid[2, 0].set_ylim(0.0, 32.0)
        paper.legend(_legend())
    return paper.figure


def sensitivity_peak(results: Results) -> Figure:
    """Figure 4, over the natural frequency: the peak of |S|, and the frequency where it lies.

    Args:
        results: from `results.compute`.
    """
    with theme.applied():
        paper, grid = _sheet(
            2, 5.9, "Peak of the sensitivity over the actuator's natural frequency",
            f"{_STUDY} 4. {_GAINS}. Above: Ms, the peak of |S|. Below: the frequency of the peak; "
            "the dotted line is the study's 40 rad/s. A jump is a change from one local peak of "
            "|S| to another. Thin lines at the right: no actuator dynamics.",
            marks=False,
        )  # fmt: skip
        for column, kind in enumerate(_COLUMNS):
            upper, lower = grid[:, column]
            _families(upper, results, kind, "sensitivity_peak")
            _ideal(upper, results, kind, "sensitivity_peak")
            _log_axis(upper, 1.0, 12.0, (1, 1.2, 1.5, 2, 3, 5, 10))
            _families(lower, results, kind, "sensitivity_peak_frequency", jumps=True)
            _ideal(lower, results, kind, "sensitivity_peak_frequency")
            _log_axis(lower, 25.0, 300.0, (30, 40, 50, 70, 100, 150, 200, 300))
            lower.axhline(40.0, color=theme.INK, linewidth=0.9, linestyle=":", zorder=1.5)
            upper.set_title("sampled at 1 kHz, exact" if kind == "sampled" else _COLUMNS[kind])
        grid[0, 0].set_ylabel("sensitivity peak Ms [-]")
        grid[1, 0].set_ylabel("frequency of the peak [rad/s]")
        paper.legend(_legend(marks=False))
    return paper.figure


def sensitivity(results: Results) -> Figure:
    """Figure 4, over frequency: |S| for several natural frequencies.

    Args:
        results: from `results.compute`.
    """
    with theme.applied():
        handles = _sensitivity_legend()
        paper = page(
            9.4, 5.8, title="Sensitivity over frequency", entries=len(handles), entry_width=1.85,
            footer=f"{_STUDY} 4. {_GAINS}. Marks: measured from one simulated step response each, "
            "the command over kp times the setpoint. The dotted line is the study's 40 rad/s.",
        )  # fmt: skip
        rows, columns = len(study.DAMPING_RATIOS), len(study.DELAYS)
        grid = paper.figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for z, zeta in enumerate(study.DAMPING_RATIOS):
            for d, delay in enumerate(study.DELAYS):
                _sensitivities(grid[z, d], results, z, d)
                grid[z, d].set_title(f"ζ {zeta:g}, delay {wording.quantity(delay, 's')}")
            grid[z, 0].set_ylabel("|S| [-]")
        for axes in grid[-1]:
            axes.set_xlabel("frequency [rad/s]")
        paper.legend(handles)
    return paper.figure


def _sheet(
    rows: int, height: float, title: str, footer: str, *, marks: bool = True
) -> tuple[Page, np.ndarray]:
    """A page with `rows` of panels over the natural frequency, one column for each kind."""
    paper = page(
        8.6, height, title=title, footer=footer, entries=len(_legend(marks=marks)),
        entry_width=2.1 if marks else 2.8,
    )  # fmt: skip
    grid = paper.figure.subplots(rows, 2, sharex=True, sharey="row", squeeze=False)
    for axes, words in zip(grid[0], _COLUMNS.values(), strict=True):
        axes.set_title(words)
    for axes in grid.flat:
        axes.set_xscale("log")
        axes.set_xlim(45.0, 1000.0)
        axes.xaxis.set_major_locator(FixedLocator([50, 70, 100, 150, 200, 300, 400, 600, 800]))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.grid(visible=True, which="major")
    for axes in grid[-1]:
        axes.set_xlabel("actuator natural frequency ωn [rad/s]")
    return paper, grid


def _log_axis(axes: Axes, low: float, high: float, ticks: Sequence[float]) -> None:
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    axes.yaxis.set_major_locator(FixedLocator(ticks))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.yaxis.set_minor_locator(NullLocator())


def _since(positions: np.ndarray) -> np.ndarray:
    """Time of the control ticks [s]."""
    return np.arange(positions.shape[-1]) / study.CONTROL_RATE


def _shade(colour: str, wn: float) -> Line2D:
    return Line2D([], [], color=colour, label=f"ωn {wn:g} rad/s")


def _milli(seconds: np.ndarray) -> np.ndarray:
    return 1e3 * seconds


def _same(values: np.ndarray) -> np.ndarray:
    return values


Scale = Callable[[np.ndarray], np.ndarray]


def _families(
    axes: Axes,
    results: Results,
    kind: str,
    name: str,
    *,
    at_boundary: float | None = None,
    scale: Scale = _same,
    jumps: bool = False,
) -> None:
    """One curve for each damping ratio and delay, and the robots.

    Args:
        at_boundary: value where the loop is about to become unstable, None where it has no limit.
        jumps: interrupt the curves where they jump.
    """
    for z in range(len(study.DAMPING_RATIOS)):
        for d in range(len(study.DELAYS)):
            wn, values = results.natural_frequency, scale(results.curves[kind][name][z, d])
            if jumps:
                wn, values = _broken(wn, values)
            start = results.boundary[kind][z, d]
            if at_boundary is not None and math.isfinite(start):
                stable = wn > start
                wn = np.concatenate([[start], wn[stable]])
                values = np.concatenate([[at_boundary], values[stable]])
            axes.plot(wn, values, color=_COLOURS[d], linestyle=_DASHES[z], linewidth=1.5, zorder=3)
    for r, robot in enumerate(study.ROBOTS):
        if robot in _ROBOT_MARKS:
            values = scale(results.robots[kind][name][r])
            for d, value in enumerate(values):
                axes.plot(
                    results.robot_frequency[r], value, marker=_ROBOT_MARKS[robot], markersize=9.5,
                    color=_COLOURS[d], markeredgecolor=theme.INK, markeredgewidth=0.6, zorder=5,
                )  # fmt: skip


def _broken(wn: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A curve of positive values interrupted where it jumps by more than a quarter."""
    places = np.flatnonzero(np.abs(np.diff(np.log(values))) > 0.25) + 1
    return np.insert(wn, places, np.nan), np.insert(values, places, np.nan)


def _ideal(axes: Axes, results: Results, kind: str, name: str, scale: Scale = _same) -> None:
    """Short lines at the right edge: the loop without actuator dynamics."""
    for d, value in enumerate(scale(results.robots[kind][name][study.ROBOTS.index("ideal")])):
        if math.isfinite(value):
            axes.plot(
                [850.0, 1000.0], [value, value], color=_COLOURS[d], linewidth=0.9, zorder=3,
            )  # fmt: skip


def _simulated(axes: Axes, results: Results, name: str, scale: Scale = _same) -> None:
    wn, found = results.natural_frequency[results.marked], scale(results.simulated_curves[name])
    for z in range(len(study.DAMPING_RATIOS)):
        for d in range(len(study.DELAYS)):
            axes.plot(
                wn, found[z, d], linestyle="none", marker=_MARKS[z], markersize=3.8,
                color=_COLOURS[d], markerfacecolor="white", markeredgewidth=0.9, zorder=4,
            )  # fmt: skip


def _legend(*, marks: bool = True) -> list[Artist]:
    handles: list[Artist] = [
        Line2D([], [], color=colour, label=f"delay {wording.quantity(delay, 's')}")
        for colour, delay in zip(_COLOURS, study.DELAYS, strict=True)
    ]
    for zeta, dash in zip(study.DAMPING_RATIOS, _DASHES, strict=True):
        handles.append(Line2D([], [], color=theme.INK, linestyle=dash, label=f"ζ {zeta:g}"))
    for robot, mark in _ROBOT_MARKS.items():
        handles.append(
            Line2D(
                [], [], linestyle="none", marker=mark, markersize=9.0, color=theme.FAINT,
                markeredgecolor=theme.INK, markeredgewidth=0.6, label=wording.display_name(robot),
            )
        )  # fmt: skip
    if marks:
        for zeta, mark in zip(study.DAMPING_RATIOS, _MARKS, strict=True):
            handles.append(
                Line2D(
                    [], [], linestyle="none", marker=mark, markersize=4.2, color=theme.INK,
                    markerfacecolor="white", markeredgewidth=0.9, label=f"simulated, ζ {zeta:g}",
                )
            )  # fmt: skip
    return handles


def _sensitivities(axes: Axes, results: Results, z: int, d: int) -> None:
    for s, colour in enumerate(_SHADES):
        for kind, dash in (("continuous", (0, (4, 1.6))), ("sampled", "-")):
            axes.plot(
                results.frequency, results.sensitivity[kind][z, d, s], color=colour,
                linestyle=dash, linewidth=1.0 if kind == "continuous" else 1.3, zorder=3,
            )  # fmt: skip
        axes.plot(
            results.measured_frequency, results.measured_sensitivity[z, d, s], linestyle="none",
            marker="o", markersize=3.2, color=colour, markerfacecolor="white",
            markeredgewidth=0.8, zorder=4,
        )  # fmt: skip
    axes.axvline(40.0, color=theme.INK, linewidth=0.9, linestyle=":", zorder=1.5)
    axes.axhline(1.0, color=theme.FAINT, linewidth=0.8, zorder=1.5)
    axes.set_xscale("log")
    axes.set_xlim(results.frequency[0], results.frequency[-1])
    _log_axis(axes, 0.02, 30.0, (0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20))
    axes.xaxis.set_major_locator(FixedLocator([3, 10, 30, 100, 300, 1000]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(visible=True, which="major")


def _sensitivity_legend() -> list[Artist]:
    """Natural frequencies in the upper row, the three kinds below them: filled column by column."""
    upper = [_shade(colour, wn) for colour, wn in zip(_SHADES, study.SHOWN, strict=True)]
    lower = [
        Line2D([], [], color=theme.INK, ls=(0, (4, 1.6)), lw=1.0, label="continuous time"),
        Line2D([], [], color=theme.INK, lw=1.3, label="sampled at 1 kHz"),
        Line2D(
            [], [], linestyle="none", marker="o", markersize=4.0, color=theme.INK,
            markerfacecolor="white", label="simulated",
        ),
    ]  # fmt: skip
    pairs = [handle for pair in zip(upper, lower, strict=False) for handle in pair]
    return [*pairs, *upper[len(lower) :]]


PICTURES: dict[str, Callable[[Results], Figure]] = {
    "figure_2_steps": steps,
    "figure_3_margins": margins,
    "figure_4_sensitivity": sensitivity,
    "figure_4_sensitivity_peak": sensitivity_peak,
}
