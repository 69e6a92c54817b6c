"""A random sample of loops: one marker a loop, coloured by a result, shaped by its verdict."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from jaxact.plotting import theme
from jaxact.plotting.field import OF_LIMIT_CYCLES, RATES, Field, field, settled
from jaxact.plotting.panels import Arrangement, Axis, Panel
from jaxact.plotting.stability_map import (
    boundary_handles,
    draw_boundary,
    finish,
    frame,
    mark_nominal,
    nominal_handle,
    positions,
)
from jaxact.status import Verdict

if TYPE_CHECKING:
    from jaxact.sweeping.exact_lines import ExactLines

# Marker, edge colour and edge width of each verdict: apart in grey and without colour vision.
_MARKERS: dict[Verdict, dict[str, Any]] = {
    Verdict.STABLE: {"marker": "o", "edgecolors": "#16365C", "linewidths": 0.35},
    Verdict.LIMIT_CYCLE: {"marker": "D", "edgecolors": "black", "linewidths": 0.9},
    Verdict.UNSTABLE: {"marker": "^", "edgecolors": "#4A1A08", "linewidths": 0.35},
    Verdict.TOPPLES: {"marker": "v", "edgecolors": "#3C4654", "linewidths": 0.35},
    Verdict.INVALID: {"marker": "x"},
}


def scatter(
    dataset: xr.Dataset,
    arrangement: Arrangement,
    *,
    variable: str = "growth_rate",
    boundaries: Sequence[ExactLines | None] | None = None,
    nominal: tuple[float, float] | None = None,
    title: str = "",
    footer: str = "",
) -> Figure:
    """A variable at every sampled loop over two of its parameters.

    Args:
        dataset: the whole sweep (the colour scale is shared by all panels).
        arrangement: kind "scatter", see `jaxact.plotting.panels.arrange`.
        variable: coloured; loops without a finite value are drawn grey.
        boundaries: exact boundary of each panel in order, None where there is none.
        nominal: (x, y) of the point to mark.
        title, footer: above and below.
    """
    shown = field(dataset, variable)
    with theme.applied():
        handles = legend(arrangement, boundaries, nominal, variable)
        drawn = frame(arrangement, title, footer=footer, entries=len(handles))
        for number, panel in enumerate(arrangement.panels):
            axes = drawn.grid[panel.row, panel.column]
            exact = None if boundaries is None else boundaries[number]
            draw(axes, arrangement, panel, shown, exact=exact, nominal=nominal)
        finish(drawn, shown, handles)
    return drawn.page.figure


def draw(
    axes: Axes,
    arrangement: Arrangement,
    panel: Panel,
    shown: Field,
    *,
    exact: ExactLines | None = None,
    nominal: tuple[float, float] | None = None,
) -> None:
    """One panel on given axes; arguments as for `scatter`."""
    axes.grid(visible=True, which="major")
    _points(axes, arrangement, panel, shown)
    if exact is not None:
        draw_boundary(axes, exact)
    if nominal is not None:
        mark_nominal(axes, arrangement, nominal)


def _points(axes: Axes, arrangement: Arrangement, panel: Panel, shown: Field) -> None:
    assert arrangement.y is not None
    x, y = (_places(axis, panel.data[axis.name].values) for axis in (arrangement.x, arrangement.y))
    growth = shown.variable in RATES
    values = panel.data[shown.variable].values if growth else settled(panel.data, shown.variable)
    verdict = panel.data["verdict"].values
    size = float(np.clip(6000.0 / max(len(x), 1), 7.0, 34.0))
    for kind, marker in _MARKERS.items():
        finite = (verdict == kind) & np.isfinite(values)
        absent = (verdict == kind) & ~np.isfinite(values)
        if kind is Verdict.INVALID:
            absent, finite = verdict == kind, np.zeros_like(finite)
        axes.scatter(
            x[finite], y[finite], s=size, c=values[finite], cmap=shown.colors, norm=shown.norm,
            rasterized=len(x) > 2000, zorder=3, **marker,
        )  # fmt: skip
        color = "#5A5A5A" if kind is Verdict.INVALID else "#D0D0D0"
        axes.scatter(x[absent], y[absent], s=size, color=color, zorder=2, **_flat(marker))


def _flat(marker: dict[str, Any]) -> dict[str, Any]:
    return {"marker": marker["marker"], "linewidths": 0.8 if marker["marker"] == "x" else 0.0}


def _places(axis: Axis, values: np.ndarray) -> np.ndarray:
    """Positions of samples along the axis, shape (samples,)."""
    if axis.scale != "category":
        return values.astype(float)
    places = dict(zip((str(v) for v in axis.values), positions(axis), strict=True))
    return np.array([places[str(v)] for v in values])


def legend(
    arrangement: Arrangement,
    boundaries: Sequence[ExactLines | None] | None,
    nominal: tuple[float, float] | None,
    variable: str,
) -> list[Artist]:
    """Entries of verdicts, boundaries and marks; arguments as for `scatter`."""
    present = {int(v) for panel in arrangement.panels for v in np.unique(panel.data["verdict"])}
    fills = {
        Verdict.STABLE: "#6FA8D6", Verdict.LIMIT_CYCLE: "#FBDCC0", Verdict.UNSTABLE: "#B8501B",
        Verdict.TOPPLES: "#B9C2CE",
    }  # fmt: skip
    handles: list[Artist] = [
        Line2D(
            [], [], linestyle="none", marker=marker["marker"], markersize=6, label=kind.label,
            markerfacecolor=fills.get(kind, "#5A5A5A"),
            markeredgecolor=marker.get("edgecolors", "#5A5A5A"),
            markeredgewidth=marker.get("linewidths", 1.0),
        )
        for kind, marker in _MARKERS.items()
        if int(kind) in present
    ]  # fmt: skip
    if variable in OF_LIMIT_CYCLES and present - {int(Verdict.LIMIT_CYCLE)}:
        grey = {"markerfacecolor": "#D0D0D0", "markeredgecolor": "none", "markersize": 6}
        handles.append(
            Line2D([], [], linestyle="none", marker="s", label="grey: no limit cycle", **grey)  # type: ignore[arg-type]
        )
    handles += boundary_handles(boundaries)
    if nominal is not None:
        handles.append(nominal_handle(arrangement, nominal))
    return handles
