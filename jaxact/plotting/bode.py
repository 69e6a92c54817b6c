"""Bode plot of one or several loops, with the gain and the phase margins drawn in."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from jaxact.errors import UserError
from jaxact.plotting import theme, wording
from jaxact.plotting.page import column, lines, page
from jaxact.plotting.response import LoopResponse, curve_styles, decibel, frequency_axis, number

# The phase of a delay falls without end; below this it is cut off [deg].
LOWEST_PHASE = -450.0


def bode(responses: Sequence[LoopResponse], *, title: str = "", footer: str = "") -> Figure:
    """Magnitude [dB] and phase [deg] of L(jw); margins as bars from the curve to 0 dB and -180 deg.

    Args:
        responses: at least one loop.
        title, footer: above and below.
    """
    with theme.applied():
        labels = column([_described(response) for response in responses], 7.4)
        paper = page(7.4, 5.6, title=title, footer=footer, entries=lines(labels), entry_width=7.4)
        magnitude, phase = paper.figure.subplots(2, 1, sharex=True)
        draw((magnitude, phase), responses, labels)
        paper.legend(magnitude.get_legend_handles_labels()[0])
    return paper.figure


def draw(axes: Sequence[Axes], responses: Sequence[LoopResponse], labels: Sequence[str]) -> None:
    """The same on given axes, without a legend.

    Args:
        axes: of the magnitude and of the phase.
        responses: at least one loop.
        labels: what each is called in a legend.
    """
    magnitude, phase = axes
    for response, label, line in zip(responses, labels, curve_styles(responses), strict=True):
        magnitude.plot(response.frequency, decibel(response.open_loop), label=label, **line)
        phase.plot(response.frequency, response.phase, **line)
        _gain_margin(magnitude, phase, response, line["color"])
        _phase_margin(magnitude, phase, response, line["color"])
    _dress(magnitude, phase, responses)


def _described(response: LoopResponse) -> str:
    """`HyQ, 1 ms: gain margin 16.5 (24.3 dB), phase margin 54.8°`."""
    if not response.stable:
        return f"{response.label}: unstable, no margins"
    gain, phase = response.margin("gain_margin"), response.margin("phase_margin")
    words = [
        f"gain margin {number(gain)} ({float(decibel(gain)):.1f} dB)" if gain else "gain margin ∞",
        f"phase margin {phase:.1f}°" if phase is not None else "phase margin ∞",
    ]
    delay = response.margin("delay_margin")
    if delay is not None:
        words.append(f"delay margin {wording.quantity(delay, 's')}")
    return f"{response.label}: {', '.join(words)}"


def _gain_margin(magnitude: Axes, phase: Axes, response: LoopResponse, color: object) -> None:
    """From |L| up to 0 dB at the phase crossover."""
    at, gain = response.margin("phase_crossover"), response.margin("gain_margin")
    if at is None or gain is None:
        return
    _bar(magnitude, at, -float(decibel(gain)), 0.0, color)
    phase.axvline(at, color=color, linewidth=0.7, linestyle=":", zorder=1)


def _phase_margin(magnitude: Axes, phase: Axes, response: LoopResponse, color: object) -> None:
    """From the phase down to the nearest odd multiple of -180 deg at the gain crossover."""
    at, margin = response.margin("gain_crossover"), response.margin("phase_margin")
    if at is None or margin is None:
        return
    there = float(np.interp(np.log(at), np.log(response.frequency), response.phase))
    _bar(phase, at, there, there - margin, color)
    magnitude.axvline(at, color=color, linewidth=0.7, linestyle=":", zorder=1)


def _bar(axes: Axes, at: float, start: float, end: float, color: object) -> None:
    axes.plot([at, at], [start, end], color=color, linewidth=2.6, solid_capstyle="butt", zorder=4)
    axes.plot(
        [at], [start], marker="o", markersize=4.5, markerfacecolor="white", color=color, zorder=5
    )


def _dress(magnitude: Axes, phase: Axes, responses: Sequence[LoopResponse]) -> None:
    frequency_axis(magnitude, responses, label=False)
    frequency_axis(phase, responses)
    magnitude.axhline(0.0, color=theme.INK, linewidth=0.9, zorder=2)
    levels = np.concatenate([decibel(r.open_loop) for r in responses])
    levels = levels[np.isfinite(levels)]
    if not levels.size:
        raise UserError("the open loop is zero: with no gains there is nothing to draw")
    magnitude.set_ylim(max(levels.min(), -80.0) - 4.0, min(levels.max(), 120.0) + 4.0)
    magnitude.yaxis.set_major_locator(MultipleLocator(20.0))
    magnitude.set_ylabel("|L| [dB]")
    lowest = max(min(float(np.nanmin(r.phase)) for r in responses), LOWEST_PHASE)
    highest = max(float(np.nanmax(r.phase)) for r in responses)
    phase.set_ylim(lowest - 15.0, min(highest, 360.0) + 15.0)
    span = highest - lowest
    phase.yaxis.set_major_locator(MultipleLocator(45.0 if span < 380.0 else 90.0))
    for turn in range(-3, 1):
        level = -180.0 + 360.0 * turn
        if lowest - 15.0 <= level <= highest + 15.0:
            phase.axhline(level, color=theme.INK, linewidth=0.9, zorder=2)
    phase.set_ylabel("phase of L [deg]")
    for response in responses:
        if np.isfinite(response.nyquist_frequency):
            for axes in (magnitude, phase):
                axes.axvline(response.nyquist_frequency, color=theme.FAINT, linewidth=0.8, ls="-.")
