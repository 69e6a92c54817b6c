"""Step responses of one or several loops over each other: position, and force below."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from jaxact.plotting import theme
from jaxact.plotting.axis_spans import spans, widen
from jaxact.plotting.page import column, lines, page
from jaxact.plotting.trajectory import Joint, seconds_or_milliseconds

# Of the panels of position and force, relative to each other.
HEIGHTS = (1.5, 1.0)


@dataclass(frozen=True)
class StepResponse:
    """One loop's response, ready to be drawn.

    Attributes:
        label: name in the legend, with what is said of the response.
        run: its trajectory.
        stable: an unstable response is drawn thin, and does not set the picture's range.
    """

    label: str
    run: Joint
    stable: bool = True


def step(
    responses: Sequence[StepResponse],
    *,
    title: str = "",
    footer: str = "",
    units: tuple[str, str] = ("m", "N"),
    band: float = 0.02,
    until: float = math.inf,
) -> Figure:
    """Position against its setpoint, with the settling band, and force.

    Args:
        responses: at least one loop.
        title, footer: above and below.
        units: of the position and of the force.
        band: half width of the settling band as a fraction of the step [-].
        until: end of the time axis [s], where it is before the end of the runs.
    """
    with theme.applied():
        labels = column([response.label for response in responses], 7.4)
        paper = page(
            7.4, 5.2, title=title, footer=footer, entries=lines(labels) + 1, entry_width=7.4
        )
        heights = {"height_ratios": HEIGHTS}
        upper, lower = paper.figure.subplots(2, 1, sharex=True, gridspec_kw=heights)
        draw((upper, lower), responses, labels, units=units, band=band, until=until)
        paper.figure.align_ylabels()
        paper.legend(upper.get_legend_handles_labels()[0])
    return paper.figure


def draw(
    axes: Sequence[Axes],
    responses: Sequence[StepResponse],
    labels: Sequence[str],
    *,
    units: tuple[str, str] = ("m", "N"),
    band: float = 0.02,
    until: float = math.inf,
) -> None:
    """The same on given axes, without a legend.

    Args:
        axes: of position and force.
        responses: at least one loop.
        labels: what each is called in a legend.
        units, band, until: as for `step`.
    """
    upper, lower = axes
    longest = max((r.run.time for r in responses), key=lambda time: float(time[-1]))
    _, label = seconds_or_milliseconds(longest)
    scale = 1e3 if label == "time [ms]" else 1.0
    _setpoints(upper, [response.run for response in responses], scale, band)
    for index, response in enumerate(responses):
        line = theme.style(index) | ({} if response.stable else {"linewidth": 0.9})
        time = response.run.time * scale
        upper.plot(time, response.run.position, label=labels[index], zorder=3, **line)
        lower.plot(time, response.run.force, zorder=3, **line)
    calm = [r for r in responses if r.stable]
    if len(calm) < len(responses):
        _limit(upper, [r.run.position for r in calm] + [r.run.setpoint for r in responses])
        _limit(lower, [r.run.force for r in calm] or [responses[0].run.command[:1]])
    least = [
        spans(longest, [r.run.position], r.run.setpoint, [r.run.force], unit=units[0])
        for r in calm or responses
    ]
    widen(upper, max(span.position for span in least))
    widen(lower, max(span.force for span in least))
    upper.set_ylabel(f"position [{units[0]}]")
    lower.set_ylabel(f"force [{units[1]}]")
    lower.axhline(0.0, color=theme.FAINT, linewidth=0.6, zorder=1)
    lower.set_xlabel(label)
    lower.set_xlim(0.0, min(float(longest[-1]), until) * scale)
    for panel in axes:
        panel.grid(visible=True)


def _setpoints(axes: Axes, runs: Sequence[Joint], scale: float, band: float) -> None:
    """One setpoint and its band for each step: grey where loops share it, else in their colour."""
    steps: dict[tuple[float, float], list[int]] = {}
    for index, run in enumerate(runs):
        steps.setdefault((float(run.setpoint[-1]), float(run.position[0])), []).append(index)
    several = len(steps) > 1
    dashed = {"linestyle": "--", "linewidth": 1.0, "zorder": 2}
    for (final, start), loops in steps.items():
        own = several and len(loops) == 1
        color = str(theme.style(loops[0])["color"]) if own else theme.INK
        shade = theme.shade(color, 0.75) if own else "#E4E4E4"
        half, run = band * abs(final - start), runs[loops[0]]
        axes.axhspan(final - half, final + half, color=shade, alpha=0.6 if own else 1.0, zorder=0)
        if own:  # bands of different starts lie on each other
            axes.hlines([final - half, final + half], *run.time[[0, -1]] * scale, color, lw=0.6)
        axes.plot(run.time * scale, run.setpoint, color=color, **dashed)
    label = f"{'setpoints, bands' if several else 'setpoint, band'} of ±{band:.0%}"
    axes.plot([], [], color=theme.INK, label=label, **dashed)  # of the legend


def _limit(axes: Axes, arrays: list[np.ndarray]) -> None:
    values = np.concatenate([array[np.isfinite(array)] for array in arrays])
    low, high = float(values.min()), float(values.max())
    pad = 0.6 * max(high - low, 1e-9)
    axes.set_ylim(low - pad, high + pad)
