"""Gains of a robot's groups of joints before and after tuning, and where the starts ended."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxact.parameters import KD, KP
from jaxact.plotting import theme, ticks
from jaxact.plotting.page import page
from jaxact.plotting.tuning import AFTER, BEFORE

# The axis goes this many times the spread of the middle half beyond it, or decades at least.
_FENCE, _DECADES = 1.5, 0.6
_ROOM = 1.25  # beyond the outermost mark, as a factor


def gains(
    names: Sequence[str],
    before: tuple[np.ndarray, np.ndarray] | None,
    after: tuple[np.ndarray, np.ndarray],
    ends: np.ndarray,
    *,
    units: tuple[str, str],
    title: str = "",
    footer: str = "",
) -> Figure:
    """kp and kd of every group, before and after, and where every start ended.

    A gain that is far from all others is drawn as an arrow at the edge, with its value, so that
    the others are not squeezed.

    Args:
        names: of the groups.
        before, after: kp and kd, shape (groups,) each; None without a start.
        ends: of the descent, shape (starts, 2, groups).
        units: of kp and kd.
        title, footer: above and below.
    """
    with theme.applied():
        width = min(max(5.2, 1.4 + 0.9 * len(names)), 12.0)
        handles = _handles(before is not None)
        paper = page(width, 4.6, title=title, footer=footer, entries=len(handles), entry_width=1.9)
        axes = paper.figure.subplots(2, 1, sharex=True)
        draw(axes, names, before, after, ends, units=units)
        paper.figure.align_ylabels()
        paper.legend(handles)
    return paper.figure


def draw(
    axes: Sequence[Axes],
    names: Sequence[str],
    before: tuple[np.ndarray, np.ndarray] | None,
    after: tuple[np.ndarray, np.ndarray],
    ends: np.ndarray,
    *,
    units: tuple[str, str],
) -> list[Artist]:
    """As `gains`, on given axes: of kp, and of kd. Returns a legend."""
    places = np.arange(len(names))
    for row, (panel, symbol) in enumerate(zip(axes, (KP, KD), strict=True)):
        given = [] if before is None else [before[row]]
        low, high = limits(np.concatenate([after[row], *given, ends[:, row].ravel()]))
        panel.set_yscale("log")
        panel.set_ylim(low, high)
        ticks.label(panel.yaxis)
        for end in ends[:, row]:
            _marks(panel, places, end, marker="_", color=theme.INK, markersize=9, alpha=0.5)
        if before is not None:
            _marks(panel, places, before[row], value=True, marker="X", color=BEFORE,
                   markersize=8, markeredgecolor="white")  # fmt: skip
        _marks(panel, places, after[row], value=True, marker="o", color=AFTER, markersize=8,
               markeredgecolor="white")  # fmt: skip
        panel.set_ylabel(f"{symbol} [{units[row]}]")
        panel.grid(visible=True, axis="y", which="major")
    turned = {"rotation": 45, "ha": "right"} if len(names) > 6 else {}
    axes[1].set_xticks(places, names, **turned)
    axes[1].set_xlim(-0.6, len(names) - 0.4)
    return _handles(before is not None)


def limits(values: np.ndarray) -> tuple[float, float]:
    """Ends of a logarithmic axis for all but the outliers among some positive numbers.

    An outlier is beyond the quartiles by _FENCE times their distance (Tukey, "Exploratory data
    analysis", 1977), and by _DECADES at least.
    """
    logs = np.log10(values[np.isfinite(values) & (values > 0.0)])
    if not logs.size:
        return 0.1, 10.0
    lower, upper = np.percentile(logs, [25.0, 75.0])
    fence = max(_FENCE * (upper - lower), _DECADES)
    inside = logs[(logs >= lower - fence) & (logs <= upper + fence)]
    return float(10.0 ** inside.min() / _ROOM), float(10.0 ** inside.max() * _ROOM)


def _marks(
    axes: Axes, places: np.ndarray, values: np.ndarray, *, value: bool = False, **mark: object
) -> None:
    """Marks of some gains; what is beyond the axis is an arrow at its edge.

    Args:
        value: write the number beside the arrow.
    """
    low, high = axes.get_ylim()
    inside = (values >= low) & (values <= high)
    axes.plot(places[inside], values[inside], linestyle="none", **mark)  # type: ignore[arg-type]
    for place, number in zip(places[~inside], values[~inside], strict=True):
        above = number > high
        edge = high / _ROOM**0.35 if above else low * _ROOM**0.35
        arrow = mark | {"marker": "^" if above else "v", "markersize": 6}
        axes.plot([place], [edge], linestyle="none", **arrow)  # type: ignore[arg-type]
        if value:
            axes.annotate(
                f"{number:.3g}", (place, edge), (7.0, 0.0), textcoords="offset points",
                va="center", fontsize=7.5, color=mark["color"],
            )  # type: ignore[arg-type] # fmt: skip


def _handles(before: bool) -> list[Artist]:
    def mark(marker: str, color: str, label: str, size: float = 8.0) -> Artist:
        return Line2D([], [], marker=marker, ls="none", color=color, markersize=size, label=label)

    handles = [mark("o", AFTER, "after")]
    if before:
        handles.append(mark("X", BEFORE, "before"))
    return [*handles, mark("_", theme.INK, "ends of the starts", 9.0)]
