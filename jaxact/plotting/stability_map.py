"""The stability map: growth rate over two parameters, verdicts hatched, exact boundary on top."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import (
    FixedFormatter,
    FixedLocator,
    FuncFormatter,
)

from jaxact.plotting import theme, ticks, wording
from jaxact.plotting.field import (
    OF_LIMIT_CYCLES,
    RATES,
    Field,
    dress_colorbar,
    field,
    settled,
    usual,
)
from jaxact.plotting.page import Page, page
from jaxact.plotting.panels import Arrangement, Axis, Panel
from jaxact.plotting.zero_line import zero_line
from jaxact.status import Verdict

if TYPE_CHECKING:
    from jaxact.sweeping.exact_lines import ExactLines

# Verdicts that are hatched: pattern and its colour. Stable is left plain.
HATCHES = {
    Verdict.LIMIT_CYCLE: ("....", "#2B2B2B"),
    Verdict.UNSTABLE: ("////", "#3A1C0E"),
    Verdict.TOPPLES: ("\\\\", "#7A8594"),
    Verdict.INVALID: ("xxxx", "#5A5A5A"),
}
INVALID_FILL = "#C9C9C9"
# A loop that does not have the metric that is drawn, e.g. one that did not settle in time.
EMPTY_FILL = "#EDEDED"
LINEARISED = {
    "growth_rate": "linearised boundary",
    "shaking_rate": "linearised boundary of shaking",
}


@dataclass(frozen=True)
class Frame:
    """A page with its grid of axes, shape (rows, columns)."""

    page: Page
    grid: np.ndarray


def stability_map(
    dataset: xr.Dataset,
    arrangement: Arrangement,
    *,
    variable: str = "growth_rate",
    boundaries: Sequence[ExactLines | None] | None = None,
    nominal: tuple[float, float] | None = None,
    linearised: bool = False,
    title: str = "",
    footer: str = "",
) -> Figure:
    """Small multiples of a variable over (x, y), one panel for each facet value.

    Args:
        dataset: the whole sweep (the colour scale is shared by all panels).
        arrangement: kind "map", see `jaxact.plotting.panels.arrange`.
        variable: coloured; rates are centred on zero.
        boundaries: exact boundary of each panel in order, None where there is none.
        nominal: (x, y) of the point to mark.
        linearised: draw where the rate of the linearised loops is zero, as of robots: the one that
            is coloured, else the one that is usual.
        title, footer: above and below.
    """
    shown = field(dataset, variable)
    with theme.applied():
        rate = variable if variable in RATES else usual(dataset)
        zero = [
            zero_line(arrangement, panel, rate) if linearised else ()
            for panel in arrangement.panels
        ]
        handles = legend_handles(
            arrangement, boundaries, nominal, variable, linearised=rate if any(zero) else None
        )
        drawn = frame(arrangement, title, footer=footer, entries=len(handles))
        for number, panel in enumerate(arrangement.panels):
            exact = None if boundaries is None else boundaries[number]
            axes = drawn.grid[panel.row, panel.column]
            draw(axes, arrangement, panel, shown, exact=exact, zero=zero[number], nominal=nominal)
        finish(drawn, shown, handles)
    return drawn.page.figure


def draw(
    axes: Axes,
    arrangement: Arrangement,
    panel: Panel,
    shown: Field,
    *,
    exact: ExactLines | None = None,
    zero: Sequence[tuple[np.ndarray, np.ndarray]] = (),
    nominal: tuple[float, float] | None = None,
) -> None:
    """One panel on given axes, whose scales and labels are left as they are.

    Args:
        axes: to draw on.
        arrangement, panel: which part of the sweep.
        shown: the variable, of `jaxact.plotting.field.field`.
        exact: boundary, None for none.
        zero: lines (x, y) where a linearised rate is zero.
        nominal: (x, y) of the point to mark.
    """
    _field(axes, arrangement, panel, shown)
    # A line that says where the border is needs no staircase of cells beside it.
    _verdicts(axes, arrangement, panel, shown.variable, border=exact is None and not zero)
    if exact is not None:
        draw_boundary(axes, exact)
    for x, y in zero:
        axes.plot(x, y, color="black", linewidth=1.5, zorder=4, scalex=False, scaley=False)
    if nominal is not None:
        mark_nominal(axes, arrangement, nominal)


def frame(arrangement: Arrangement, title: str, *, footer: str = "", entries: int = 0) -> Frame:
    """An empty figure: one dressed pair of axes for each panel, room for legend and footer.

    Args:
        title: above everything, "" for none.
        footer: small print below everything, "" for none.
        entries: how many entries the legend will have.
    """
    rows, columns = arrangement.rows, arrangement.columns
    side = {1: 4.6, 2: 3.2}.get(columns, 2.55)
    width, height = max(side * columns + 1.9, 6.2), 0.9 * side * rows + 0.55
    paper = page(width, height, title=title, footer=footer, entries=entries)
    grid = paper.figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    _dress(grid, arrangement)
    return Frame(paper, grid)


def _dress(grid: np.ndarray, arrangement: Arrangement) -> None:
    """Scales, captions and labels; labels only at the rim of the grid."""
    taken = {(panel.row, panel.column): panel for panel in arrangement.panels}
    for place in np.ndindex(*grid.shape):
        axes: Any = grid[place]
        if place not in taken:
            axes.set_visible(False)
            continue
        dress_axis(axes, "x", arrangement.x)
        if arrangement.y is not None and arrangement.kind != "lines":
            dress_axis(axes, "y", arrangement.y)
            if place[1] == 0:
                axes.set_ylabel(arrangement.y.label)
        if (place[0] + 1, place[1]) not in taken:
            axes.set_xlabel(arrangement.x.label)
            axes.tick_params(labelbottom=True)
        panel = taken[place]
        axes.set_title(panel.caption, pad=4)
        if panel.row_caption and (place[0], place[1] + 1) not in taken:
            axes.text(
                1.03, 0.5, panel.row_caption, transform=axes.transAxes, rotation=270, ha="left",
                va="center", fontsize=9.5,
            )  # fmt: skip


def finish(frame: Frame, shown: Field | None, handles: list[Artist]) -> None:
    """Colour bar at the right and legend below."""
    if shown is not None:
        mappable = ScalarMappable(norm=shown.norm, cmap=shown.colors)
        bar = frame.page.figure.colorbar(
            mappable, ax=frame.grid, extend=shown.extend, fraction=0.05, pad=0.012, aspect=32,
            shrink=0.97,
        )  # fmt: skip
        dress_colorbar(bar, shown)
    frame.page.legend(handles)


def dress_axis(axes: Axes, which: str, shown: Axis) -> None:
    """Scale, limits and ticks of one axis, log where its values are."""
    line = axes.xaxis if which == "x" else axes.yaxis
    if shown.scale == "category":
        names = [wording.quantity(value, shown.units) for value in shown.values]
        line.set_major_locator(FixedLocator(range(len(names))))
        line.set_major_formatter(FixedFormatter(names))
    elif shown.scale == "log":
        (axes.set_xscale if which == "x" else axes.set_yscale)("log")
        ticks.label(line, factor=1e3 if shown.in_milliseconds else 1.0)
    elif shown.in_milliseconds:
        line.set_major_formatter(FuncFormatter(lambda value, _: f"{value * 1e3:.6g}"))
    edges = cell_edges(shown)
    (axes.set_xlim if which == "x" else axes.set_ylim)(edges[0], edges[-1])


def positions(shown: Axis) -> np.ndarray:
    """Where values stand on the axis: the values, or 0, 1, 2 ... for categories; shape (n,)."""
    if shown.scale == "category":
        return np.arange(len(shown.values), dtype=float)
    return np.asarray(shown.values, dtype=float)


def place(shown: Axis, value: float) -> float | None:
    """Where a number stands on the axis; None outside of it, and between two categories."""
    if shown.scale == "category":
        hit = [i for i, v in enumerate(shown.values) if not isinstance(v, str) and v == value]
        return float(hit[0]) if hit else None
    edges = cell_edges(shown)
    return value if edges[0] <= value <= edges[-1] else None


def cell_edges(shown: Axis) -> np.ndarray:
    """Edges of the cells around the values, half-way on the axis's own scale; shape (n + 1,)."""
    at = positions(shown)
    if shown.scale == "log":
        at = np.log(at)
    if len(at) == 1:
        edges = np.array([at[0] - 0.5, at[0] + 0.5])
    else:
        middle = 0.5 * (at[1:] + at[:-1])
        edges = np.concatenate([[2 * at[0] - middle[0]], middle, [2 * at[-1] - middle[-1]]])
    return np.exp(edges) if shown.scale == "log" else edges


def _field(axes: Axes, arrangement: Arrangement, panel: Panel, shown: Field) -> None:
    assert arrangement.y is not None
    growth = shown.variable in RATES
    values = panel.data[shown.variable].values if growth else settled(panel.data, shown.variable)
    axes.set_facecolor(INVALID_FILL if growth else EMPTY_FILL)
    axes.pcolormesh(
        cell_edges(arrangement.x), cell_edges(arrangement.y), np.ma.masked_invalid(values),
        cmap=shown.colors, norm=shown.norm, rasterized=True, zorder=1,
    )  # fmt: skip


def _verdicts(
    axes: Axes, arrangement: Arrangement, panel: Panel, variable: str, *, border: bool
) -> None:
    """Hatch what is not stable, and draw the border of what is where that is wanted.

    Limit cycles whose amplitude or frequency is coloured need no hatch to be told.
    """
    assert arrangement.y is not None
    x, y = _corners(cell_edges(arrangement.x)), _corners(cell_edges(arrangement.y))
    verdict = panel.data["verdict"].values
    for kind, (pattern, color) in HATCHES.items():
        own = verdict == kind
        if variable in OF_LIMIT_CYCLES and kind is Verdict.LIMIT_CYCLE:
            own = own & ~np.isfinite(settled(panel.data, variable))
        mask = np.repeat(np.repeat(own, 2, axis=0), 2, axis=1)
        if not mask.any():
            continue
        area = axes.contourf(
            x, y, mask.astype(float), levels=[0.5, 1.5], colors="none", hatches=[pattern], zorder=2
        )
        area.set_edgecolor(color)
        area.set_linewidth(0.0)
    calm = (verdict == Verdict.STABLE) | (verdict == Verdict.TOPPLES)
    stable = np.repeat(np.repeat(calm, 2, axis=0), 2, axis=1)
    if border and stable.any() and not stable.all():
        axes.contour(
            x, y, stable.astype(float), levels=[0.5], colors="white", linewidths=2.2, zorder=3
        )


def _corners(edges: np.ndarray) -> np.ndarray:
    """Both ends of every cell, so that contours follow the cells and invent nothing between."""
    return np.column_stack([edges[:-1], edges[1:]]).ravel()


def draw_boundary(axes: Axes, boundary: ExactLines) -> None:
    """Sampled boundary solid, continuous-time boundary dashed."""
    for curves, line in ((boundary.continuous, "--"), (boundary.sampled, "-")):
        for x, y in curves:
            axes.plot(
                x, y, line, color="black", linewidth=1.5 if line == "-" else 1.1, zorder=4,
                scalex=False, scaley=False,
            )  # fmt: skip


def mark_nominal(axes: Axes, arrangement: Arrangement, nominal: tuple[float, float]) -> None:
    """A star at the nominal parameters, where they are in view."""
    assert arrangement.y is not None
    x, y = place(arrangement.x, nominal[0]), place(arrangement.y, nominal[1])
    if x is None or y is None:
        return
    axes.plot(
        x, y, marker="*", markersize=12, markerfacecolor=theme.YELLOW, markeredgecolor="black",
        markeredgewidth=0.8, linestyle="none", zorder=6, scalex=False, scaley=False,
    )  # fmt: skip


def verdict_handles(present: Iterable[int]) -> list[Artist]:
    """Legend entries of the hatched verdicts that occur."""
    return [
        Patch(
            facecolor=INVALID_FILL if kind is Verdict.INVALID else "#F6F1EA",
            edgecolor=color, hatch=pattern, linewidth=0.0, label=kind.label,
        )
        for kind, (pattern, color) in HATCHES.items()
        if kind in present
    ]  # fmt: skip


def boundary_handles(boundaries: Sequence[ExactLines | None] | None) -> list[Artist]:
    """Legend entries of the exact boundaries that are drawn."""
    drawn = [b for b in boundaries or () if b is not None]
    handles: list[Artist] = []
    if any(b.sampled for b in drawn):
        handles.append(boundary_handle("exact boundary, sampled"))
    if any(b.continuous for b in drawn):
        handles.append(boundary_handle("exact, continuous time", linewidth=1.1, linestyle="--"))
    return handles


def boundary_handle(label: str, *, linewidth: float = 1.5, linestyle: str = "-") -> Artist:
    """Legend entry of a black line."""
    return Line2D([], [], color="black", linewidth=linewidth, linestyle=linestyle, label=label)


def nominal_handle(arrangement: Arrangement, nominal: tuple[float, float]) -> Artist:
    """Legend entry of the star, with its values."""
    assert arrangement.y is not None
    words = ", ".join(
        f"{axis.name} {wording.quantity(value, axis.units)}"
        for axis, value in zip((arrangement.x, arrangement.y), nominal, strict=True)
    )
    return Line2D(
        [], [], marker="*", markersize=11, markerfacecolor=theme.YELLOW, markeredgecolor="black",
        linestyle="none", label=f"nominal: {words}",
    )  # fmt: skip


def legend_handles(
    arrangement: Arrangement,
    boundaries: Sequence[ExactLines | None] | None,
    nominal: tuple[float, float] | None,
    variable: str,
    *,
    linearised: str | None,
) -> list[Artist]:
    """Entries of the legend of a map; `linearised` is the rate whose zero line is drawn, if any."""
    growth = variable in RATES
    present = {int(v) for panel in arrangement.panels for v in np.unique(panel.data["verdict"])}
    handles: list[Artist] = []
    if growth and int(Verdict.STABLE) in present:
        handles.append(Patch(facecolor="#6FA8D6", linewidth=0.0, label=Verdict.STABLE.label))
    if variable in OF_LIMIT_CYCLES:
        handles += _cycle_handles(arrangement, present, variable)
        present -= {int(Verdict.LIMIT_CYCLE)}
    elif not growth and any(_lacks_value(panel.data, variable) for panel in arrangement.panels):
        handles.append(_empty("stable, no value"))
    handles += verdict_handles(present)
    handles += boundary_handles(boundaries)
    if nominal is not None:
        handles.append(nominal_handle(arrangement, nominal))
    if linearised is not None:
        handles.append(boundary_handle(LINEARISED[linearised]))
    return handles


def _cycle_handles(arrangement: Arrangement, present: set[int], variable: str) -> list[Artist]:
    """Legend entries of what is coloured on a map of limit cycles, and of what is not, and why."""
    handles: list[Artist] = [Patch(facecolor="#5CBAC6", linewidth=0.0, label="limit cycle")]
    cycles = [panel.data["verdict"].values == Verdict.LIMIT_CYCLE for panel in arrangement.panels]
    known = [np.isfinite(settled(panel.data, variable)) for panel in arrangement.panels]
    if any((cycle & ~value).any() for cycle, value in zip(cycles, known, strict=True)):
        pattern, color = HATCHES[Verdict.LIMIT_CYCLE]
        words = f"limit cycle without a {variable.rsplit('_', 1)[1]}"
        handles.append(
            Patch(facecolor=EMPTY_FILL, edgecolor=color, hatch=pattern, linewidth=0.0, label=words)
        )
    if int(Verdict.STABLE) in present:
        handles.append(_empty("stable: no limit cycle"))
    return handles


def _empty(words: str) -> Artist:
    return Patch(facecolor=EMPTY_FILL, edgecolor=theme.GRID, label=words)


def _lacks_value(data: xr.Dataset, variable: str) -> bool:
    """Whether a stable loop has no such figure."""
    stable = data["verdict"].values == Verdict.STABLE
    return bool(np.any(stable & ~np.isfinite(data[variable].values)))
