"""Labels of logarithmic axes: always several, and written as a reader would."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from matplotlib.axis import Axis
from matplotlib.ticker import Formatter, Locator, LogLocator, MaxNLocator, NullFormatter

# Labels of each decade, from few to many: the first that gives ENOUGH of them is taken.
_OF_A_DECADE = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0))
ENOUGH, _MOST = 4, 9
# Numbers in between are written out, 0.0001 to 10000; others as powers of ten.
_WRITTEN_OUT = 1e-4, 1e5


class LogTicks(Locator):
    """Ticks of a logarithmic axis: decades where there are many, else 3, or 2 and 5, of each too.

    An axis of a small part of a decade gets round numbers.
    """

    def __call__(self) -> Sequence[float]:
        """Ticks within the axis as it is shown."""
        return self.tick_values(*self.axis.get_view_interval())  # type: ignore[union-attr]

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        """Ticks between two positive numbers, rising."""
        low, high = sorted((vmin, vmax))
        if not (low > 0.0 and math.isfinite(high) and high > low):
            return []
        decades = np.arange(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        for labelled in _OF_A_DECADE:
            ticks = _within(np.outer(10.0**decades, labelled).ravel(), low, high)
            if len(ticks) >= ENOUGH:
                return ticks[:: math.ceil(len(ticks) / _MOST)] if len(labelled) == 1 else ticks
        round_numbers = MaxNLocator(nbins=6, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high)
        return _within(round_numbers, low, high)


class LogLabels(Formatter):
    """Numbers of a logarithmic axis, times a factor: `30`, or powers of ten where they are long."""

    def __init__(self, factor: float = 1.0) -> None:
        self._factor = factor

    def __call__(self, x: float, pos: int | None = None) -> str:
        """One number."""
        del pos
        return self.format_ticks([x])[0]

    def format_ticks(self, values: Sequence[float]) -> list[str]:  # type: ignore[override]
        """All numbers of the axis, in one way."""
        shown = [float(value) * self._factor for value in values]
        low, high = _WRITTEN_OUT
        if not all(low * (1 - 1e-9) <= value < high for value in shown):
            return [_power(value) for value in shown]
        for digits in range(6, 16):
            words = [f"{value:.{digits}g}" for value in shown]
            if len(set(words)) == len(set(shown)):
                break
        return words


def label(axis: Axis, *, factor: float = 1.0) -> None:
    """Give a logarithmic axis its labels, and ticks without labels in between.

    Args:
        axis: `axes.xaxis`, `axes.yaxis` or that of a colour bar, with its scale set.
        factor: from its numbers to those that are written, 1e3 for milliseconds.
    """
    axis.set_major_locator(LogTicks())
    axis.set_major_formatter(LogLabels(factor))
    axis.set_minor_locator(LogLocator(base=10.0, subs=np.arange(2.0, 10.0), numticks=30))
    axis.set_minor_formatter(NullFormatter())


def _within(ticks: Iterable[float], low: float, high: float) -> list[float]:
    return [float(tick) for tick in ticks if low * (1 - 1e-9) <= tick <= high * (1 + 1e-9)]


def _power(value: float) -> str:
    """`10^5`, `3 x 10^5` as mathtext."""
    if value <= 0.0:
        return f"{value:g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    leading = value / 10.0**exponent
    factor = "" if abs(leading - 1.0) < 1e-6 else rf"{leading:.4g}\times"
    return rf"$\mathdefault{{{factor}10^{{{exponent}}}}}$"
