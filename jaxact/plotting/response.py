"""What the frequency pictures are given: one loop's curve, its margins, and how it is called."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from jaxact.plotting import theme, ticks


@dataclass(frozen=True)
class LoopResponse:
    """Frequency response of one open loop, ready to be drawn.

    Attributes:
        label: name in the legend.
        frequency: w [rad/s], rising, shape (n,).
        open_loop: L(jw), complex, shape (n,).
        phase: of L along the frequencies, unwrapped [deg], shape (n,).
        margins: values by the names of `jaxact margins`: gain_margin [-], phase_crossover [rad/s],
            phase_margin [deg], gain_crossover [rad/s], delay_margin [s], sensitivity_peak [-],
            sensitivity_peak_frequency [rad/s], complementary_peak [-], complementary_peak_frequency
            [rad/s], disk_margin [-]; infinite where there is no crossover, and missing or NaN where
            the loop is unstable.
        stable: whether the closed loop is.
        nyquist_frequency: pi/T of a sampled loop [rad/s], inf in continuous time.
        loop: number of the loop that this is a curve of; its curves share a colour. None: a loop of
            its own.
    """

    label: str
    frequency: np.ndarray
    open_loop: np.ndarray
    phase: np.ndarray
    margins: Mapping[str, float] = field(default_factory=dict)
    stable: bool = True
    nyquist_frequency: float = math.inf
    loop: int | None = None

    def margin(self, name: str) -> float | None:
        """A margin that can be drawn: finite, and the loop stable; None otherwise."""
        value = self.margins.get(name)
        if value is None or not self.stable or not math.isfinite(value):
            return None
        return float(value)

    @property
    def sensitivity(self) -> np.ndarray:
        """S = 1/(1 + L), shape (n,)."""
        return 1.0 / (1.0 + self.open_loop)

    @property
    def complementary(self) -> np.ndarray:
        """T = L/(1 + L), shape (n,)."""
        return self.open_loop / (1.0 + self.open_loop)


def curve_styles(responses: Sequence[LoopResponse]) -> list[dict[str, Any]]:
    """Colour, dash and width of every curve, as `Axes.plot` takes them.

    A loop has one colour and one dash. Where it is drawn both sampled and in continuous time, the
    latter is wide and pale, below the sampled curves, which get darker from the first to the last:
    curves that nearly coincide are all seen.
    """
    of_loop: dict[object, list[int]] = {}
    for index, response in enumerate(responses):
        own = ("alone", index) if response.loop is None else response.loop
        of_loop.setdefault(own, []).append(index)
    styles: list[dict[str, Any]] = [{} for _ in responses]
    for number, indices in enumerate(of_loop.values()):
        line = theme.style(number)
        sampled = [i for i in indices if math.isfinite(responses[i].nyquist_frequency)]
        for index in indices:
            styles[index] = {"zorder": 3} | line
            if len(indices) > 1 and index not in sampled:
                pale = theme.shade(str(line["color"]), 0.6)
                styles[index] = {"color": pale, "linestyle": "-", "linewidth": 3.4, "zorder": 2.5}
            elif len(sampled) > 1:
                darker = -0.6 * sampled.index(index) / (len(sampled) - 1)
                styles[index]["color"] = theme.shade(str(line["color"]), darker)
    return styles


def frequency_axis(axes: Axes, responses: Sequence[LoopResponse], *, label: bool = True) -> None:
    """Logarithmic, over all frequencies given, in rad/s."""
    axes.set_xscale("log")
    ends = [(float(r.frequency[0]), float(r.frequency[-1])) for r in responses]
    axes.set_xlim(min(low for low, _ in ends), max(high for _, high in ends))
    ticks.label(axes.xaxis)
    axes.grid(visible=True, which="major")
    if label:
        axes.set_xlabel("frequency [rad/s]")


def decibel(magnitude: np.ndarray | float) -> np.ndarray:
    """20 log10 |.| [dB]."""
    with np.errstate(divide="ignore"):
        return np.asarray(20.0 * np.log10(np.abs(magnitude)))


def number(value: float, digits: int = 3) -> str:
    """Three significant digits without a trailing dot or an exponent where it is readable."""
    return f"{value:.{digits}g}" if abs(value) < 1e4 else f"{value:.{digits - 1}e}"
