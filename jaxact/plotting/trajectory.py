"""One simulated loop over time: position, velocity, command and force on a shared time axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from jaxact.parameters import SETPOINT
from jaxact.plotting import theme, wording
from jaxact.plotting.axis_spans import note as at_rest
from jaxact.plotting.axis_spans import spans, widen
from jaxact.plotting.page import page

# A response this many times the step is not drawn any further.
DIVERGED = 20.0
# Of the panels of position, velocity and force, relative to each other.
HEIGHTS = (1.25, 0.85, 1.25)
# A step that is none, and what serves instead [rad or m].
_NONE, _STEP = 1e-6, 0.05


@dataclass(frozen=True)
class Joint:
    """One joint over time; every array has shape (steps,).

    Attributes:
        time: [s].
        setpoint, position: [m or rad].
        velocity: [m/s or rad/s].
        command, delayed_command, force: [N or N m].
    """

    time: np.ndarray
    setpoint: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    command: np.ndarray
    delayed_command: np.ndarray
    force: np.ndarray


def trajectory(
    run: Joint,
    *,
    title: str = "",
    footer: str = "",
    units: tuple[str, str] = ("m", "N"),
    resolution: float = 0.0,
) -> Figure:
    """Position with its setpoint, velocity, and command, delayed command and force.

    A motion that diverges is drawn until it is DIVERGED times as large as the step. Axes show at
    least what `jaxact.plotting.axis_spans` says, so that rounding does not look like a motion.

    Args:
        run: the joint's trajectory.
        title, footer: above and below.
        units: of the position and of the force; ("rad", "N m") for a rotary joint.
        resolution: of the encoder, 0 where it is not known [m or rad].
    """
    with theme.applied():
        figure = page(7.4, 6.0, title=title, footer=footer).figure
        panels = figure.subplots(3, 1, sharex=True, gridspec_kw={"height_ratios": HEIGHTS})
        draw(panels, run, units=units, resolution=resolution)
        figure.align_ylabels()
    return figure


def draw(
    axes: Sequence[Axes],
    run: Joint,
    *,
    units: tuple[str, str] = ("m", "N"),
    resolution: float = 0.0,
) -> None:
    """The same on given axes.

    Args:
        axes: of position, velocity and force.
        run, units, resolution: as for `trajectory`.
    """
    length, force = units
    kept, note = until_divergence(run)
    run = replace(run, **{item.name: getattr(run, item.name)[:kept] for item in fields(run)})
    top, middle, bottom = axes
    time, label = seconds_or_milliseconds(run.time)
    top.plot(time, run.setpoint, "--", color=theme.INK, linewidth=1.1, label=SETPOINT)
    top.plot(time, run.position, color=theme.BLUE, label="position")
    top.set_ylabel(f"position [{length}]")
    middle.plot(time, run.velocity, color=theme.BLUE)
    middle.axhline(0.0, color=theme.FAINT, linewidth=0.6, zorder=1)
    middle.set_ylabel(f"velocity [{length}/s]")
    _forces(bottom, time, run)
    bottom.set_ylabel(f"force [{force}]")
    bottom.set_xlabel(label)
    for panel in (top, bottom):
        panel.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, borderaxespad=0.2)
    for panel in axes:
        _dress(panel, time)
    least = spans(
        run.time, [run.position], run.setpoint, [run.command, run.force],
        unit=length, resolution=resolution,
    )  # fmt: skip
    for panel, span in ((top, least.position), (middle, least.velocity), (bottom, least.force)):
        widen(panel, span)
    note = note or at_rest(run.position, least.position, length)
    if note:
        top.text(
            0.01, 0.93, note, transform=top.transAxes, va="top", fontsize=8,
            color=theme.VERMILION, backgroundcolor="white",
        )  # fmt: skip


def _forces(axes: Axes, time: np.ndarray, run: Joint) -> None:
    """Command, delayed command and force, each thinner than the one below: none hides another.

    Held values are steps, the force is continuous.
    """
    held = {"drawstyle": "steps-post"}
    axes.plot(time, run.command, color=theme.SKY, linewidth=3.2, label="command", **held)
    axes.plot(
        time,
        run.delayed_command,
        color=theme.ORANGE,
        linewidth=1.8,
        label="delayed command",
        **held,
    )
    axes.plot(time, run.force, color=theme.BLACK, linewidth=0.9, label="force")
    axes.axhline(0.0, color=theme.FAINT, linewidth=0.6, zorder=1)


def until_divergence(run: Joint) -> tuple[int, str]:
    """How many steps to draw, and what to say of the rest, "" where there is none."""
    start = float(run.position[0])
    step = float(np.max(np.abs(run.setpoint - start)))
    # A joint that is to stay where it is has no step; what it does is measured by _STEP instead.
    span = max(step if step > _NONE else _STEP, 0.01 * abs(start))
    with np.errstate(invalid="ignore"):
        inside = np.abs(run.position - start) <= DIVERGED * span
    gone = np.flatnonzero(~inside)
    if gone.size == 0:
        return len(run.time), ""
    kept = max(int(gone[0]), 2)
    when = wording.quantity(float(run.time[min(kept, len(run.time) - 1)]), "s")
    far = f"{DIVERGED:g} times the step" if step > _NONE else f"{DIVERGED * span:.3g} rad or m"
    return kept, f"diverges: beyond {far} after {when}"


def seconds_or_milliseconds(seconds: np.ndarray) -> tuple[np.ndarray, str]:
    """Times as they are drawn, and the label of their axis: ms below half a second."""
    if seconds.size and seconds[-1] < 0.5:
        return seconds * 1e3, "time [ms]"
    return seconds, "time [s]"


def _dress(axes: Axes, time: np.ndarray) -> None:
    axes.grid(visible=True)
    axes.set_xlim(time[0], time[-1])
    axes.margins(y=0.08)
    low, high = axes.get_ylim()
    if max(abs(low), abs(high)) >= 1e5:
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
