"""How a tuning converged: its objective and its bounds along the descent, reached or not."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from jaxact.plotting import theme, ticks
from jaxact.plotting.page import page
from jaxact.plotting.tuning import AFTER, BEFORE

# Of the panels of the objective and of the bounds, relative to each other.
HEIGHTS = (1.5, 1.0)
_REACHED, _BEYOND = "#DDEFE4", "#F7E3D8"
_HIGHEST = 30.0
# Objectives that differ by less are one, and are drawn flat.
_FLAT = 1.1


@dataclass(frozen=True)
class UnmetBound:
    """What a tuning did not reach.

    Attributes:
        words: a short sentence.
        ratio: of the metric that is missed most to its bound, at the best gains that were found;
            inf where none were found that are stable [-].
    """

    words: str
    ratio: float


def convergence(
    values: np.ndarray,
    violations: np.ndarray,
    *,
    label: str,
    given: bool,
    stable: np.ndarray | None = None,
    missed: UnmetBound | None = None,
    title: str = "",
    footer: str = "",
) -> Figure:
    """The objective of every start along the descent, and by how much its constraints are missed.

    Args:
        values: of the objective in its unit, shape (starts, steps).
        violations: largest ratio of a metric to its bound [-], 1 where it is met, same shape.
        label: of the objective, with unit.
        given: the last start is the user's own.
        stable: starts that came to stable gains, shape (starts,), None for all; values of unstable
            loops say nothing, and are not compared with the bounds.
        missed: what was not reached, None where everything was.
        title, footer: above and below.
    """
    stable = np.ones(len(values), bool) if stable is None else np.asarray(stable)
    with theme.applied():
        handles = _handles(stable, given=given, missed=missed)
        paper = page(6.8, 4.8, title=title, footer=footer, entries=len(handles), entry_width=3.3)
        axes = paper.figure.subplots(2, 1, sharex=True, gridspec_kw={"height_ratios": HEIGHTS})
        draw(axes, values, violations, label=label, given=given, stable=stable, missed=missed)
        paper.figure.align_ylabels()
        paper.legend(handles)
    return paper.figure


def draw(
    axes: Sequence[Axes],
    values: np.ndarray,
    violations: np.ndarray,
    *,
    label: str,
    given: bool,
    stable: np.ndarray,
    missed: UnmetBound | None,
) -> list[Artist]:
    """As `convergence`, on given axes: of the objective, and of the bounds. Returns a legend."""
    upper, lower = axes
    steps = np.arange(values.shape[1])
    for index in range(len(values)):
        line = _line(own=given and index == len(values) - 1, stable=bool(stable[index]))
        upper.plot(steps, values[index], **line)
        if stable[index]:
            lower.plot(steps, violations[index], **line)
    _objective_axis(upper, values, label)
    _bound_axis(lower, violations[stable], missed)
    if missed is not None:
        upper.set_title(missed.words, color=theme.VERMILION, fontweight="bold")
    for one in axes:
        one.grid(visible=True)
    return _handles(stable, given=given, missed=missed)


def _line(*, own: bool, stable: bool) -> dict[str, object]:
    line: dict[str, object] = {"color": BEFORE if own else AFTER, "linewidth": 1.6 if own else 1.0}
    return line if stable else line | {"color": theme.FAINT, "linestyle": ":"}


def _objective_axis(axes: Axes, values: np.ndarray, label: str) -> None:
    """Logarithmic, but of a range that is next to nothing."""
    axes.set_ylabel(label)
    finite = values[np.isfinite(values)]
    if not finite.size:
        return
    low, high = float(finite.min()), float(finite.max())
    if low > 0.0 and high / low < _FLAT:
        axes.set_ylim(low / _FLAT, high * _FLAT)
    elif low > 0.0:
        axes.set_yscale("log")
        ticks.label(axes.yaxis)


def _bound_axis(axes: Axes, ratios: np.ndarray, missed: UnmetBound | None) -> None:
    """Values as ratios to their bounds, with the region that was to be reached."""
    axes.set_ylabel("times the bound")
    axes.set_xlabel("step")
    shown = ratios[np.isfinite(ratios)]
    best = missed.ratio if missed is not None and math.isfinite(missed.ratio) else 1.0
    high = max(min(1.1 * float(shown.max(initial=1.0)), 4.0), 1.25 * best, 1.25)
    high = min(high, max(_HIGHEST, 1.25 * best))
    # What was to be reached takes a part of the axis that is seen.
    low = min(0.9 * float(shown.min(initial=1.0)), 1.0 - 0.2 * (high - 1.0) / high)
    axes.set_ylim(low, high)
    if high > 4.0:
        axes.set_yscale("log")
        ticks.label(axes.yaxis)
    axes.axhspan(low, 1.0, color=_REACHED, zorder=0)
    axes.axhline(1.0, color=theme.INK, linewidth=0.9)
    if missed is None:
        return
    axes.axhspan(1.0, high, color=_BEYOND, zorder=0)
    if math.isfinite(missed.ratio):
        axes.axhline(missed.ratio, color=theme.VERMILION, linewidth=1.2, linestyle="--")
    else:
        axes.text(
            0.5, 0.6, "no stable gains found", transform=axes.transAxes, ha="center", va="center",
            color=theme.VERMILION,
        )  # fmt: skip


def _handles(stable: np.ndarray, *, given: bool, missed: UnmetBound | None) -> list[Artist]:
    default = stable[:-1] if given else stable
    handles: list[Artist] = []
    if default.any():
        handles.append(Line2D([], [], **_line(own=False, stable=True), label="default starts"))  # type: ignore[arg-type]
    if given and stable[-1]:
        handles.append(Line2D([], [], **_line(own=True, stable=True), label="the given start"))  # type: ignore[arg-type]
    if not stable.all():
        faint = _line(own=False, stable=False)
        handles.append(Line2D([], [], **faint, label="starts that stay unstable"))  # type: ignore[arg-type]
    handles.append(Patch(color=_REACHED, label="every bound met"))
    if missed is not None and math.isfinite(missed.ratio):
        handles.append(
            Line2D(
                [], [], color=theme.VERMILION, linewidth=1.2, ls="--",
                label=f"best found, {missed.ratio:.4g} times the bound",
            )
        )  # fmt: skip
    return handles
