"""One parameter along the axis: a result as curves, one for each value of a second parameter."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullLocator

from jaxact.plotting import theme, ticks, wording
from jaxact.plotting.field import RATES, field, settled, signed_scale, signed_ticks, variable_label
from jaxact.plotting.panels import Arrangement, Panel
from jaxact.plotting.stability_map import finish, frame, positions
from jaxact.status import Verdict

_FACES = {
    Verdict.STABLE: None,
    Verdict.LIMIT_CYCLE: "white",
    Verdict.UNSTABLE: "none",
    Verdict.TOPPLES: "#B9C2CE",
}
_UNSTABLE_MARK = "x"


def lines(
    dataset: xr.Dataset,
    arrangement: Arrangement,
    *,
    variable: str = "growth_rate",
    nominal: float | None = None,
    title: str = "",
    footer: str = "",
) -> Figure:
    """A variable along one parameter.

    Args:
        dataset: the whole sweep (the value axis is shared by all panels).
        arrangement: kind "lines", see `jaxact.plotting.panels.arrange`.
        variable: along the value axis; the growth rate on a symmetric-log one with zero drawn.
        nominal: x of the point to mark with a vertical line.
        title, footer: above and below.
    """
    field(dataset, variable)  # refuses unknown names and empty variables
    with theme.applied():
        handles = legend(arrangement, variable, nominal)
        drawn = frame(arrangement, title, footer=footer, entries=len(handles))
        for panel in arrangement.panels:
            axes = drawn.grid[panel.row, panel.column]
            draw(axes, dataset, arrangement, panel, variable, nominal)
            if panel.column == 0:
                axes.set_ylabel(variable_label(dataset[variable]))
        finish(drawn, None, handles)
    return drawn.page.figure


def draw(
    axes: Axes,
    dataset: xr.Dataset,
    arrangement: Arrangement,
    panel: Panel,
    variable: str,
    nominal: float | None = None,
) -> None:
    """One panel on given axes; arguments as for `lines`."""
    growth = variable in RATES
    values = dataset[variable].values if growth else settled(dataset, variable)
    _value_axis(axes, values[np.isfinite(values)].astype(float), growth)
    axes.grid(visible=True, which="major")
    _curves(axes, arrangement, panel, variable)
    if nominal is not None:
        axes.axvline(nominal, color=theme.FAINT, linewidth=0.9, linestyle=":", zorder=1.5)


def _value_axis(axes: Axes, finite: np.ndarray, growth: bool) -> None:
    if growth:
        limit, linear = signed_scale(finite)
        axes.set_yscale("symlog", linthresh=linear, linscale=0.6)
        axes.set_ylim(-limit, limit)
        locator, formatter = signed_ticks(limit, linear)
        axes.yaxis.set_major_locator(locator)
        axes.yaxis.set_minor_locator(NullLocator())
        axes.yaxis.set_major_formatter(formatter)
        axes.axhspan(0.0, limit, facecolor="#F6E7DA", zorder=0)
        axes.axhline(0.0, color=theme.INK, linewidth=0.9, zorder=1)
    elif finite.min() > 0 and finite.max() / finite.min() > 100:
        axes.set_yscale("log")
        ticks.label(axes.yaxis)


def _curves(axes: Axes, arrangement: Arrangement, panel: Panel, variable: str) -> None:
    x = positions(arrangement.x)
    growth = variable in RATES
    values = panel.data[variable].values if growth else settled(panel.data, variable)
    verdict = panel.data["verdict"].values
    if arrangement.y is None:
        values, verdict = values[None], verdict[None]
    joined = "" if arrangement.x.scale == "category" else None
    for number, (line, kinds) in enumerate(zip(values, verdict, strict=True)):
        look_of = theme.style(number)
        axes.plot(x, line, zorder=3, **(look_of | ({"linestyle": joined} if joined == "" else {})))
        every = math.ceil(len(x) / 32)
        for kind, face in _FACES.items():
            hit = np.flatnonzero((kinds == kind) & np.isfinite(line))
            hit = hit[hit % every == 0]
            color = look_of["color"]
            axes.plot(
                x[hit], line[hit], linestyle="none", color=color, zorder=4, markersize=4.2,
                marker=_UNSTABLE_MARK if kind is Verdict.UNSTABLE else "o",
                markerfacecolor=color if face is None else face,
            )  # fmt: skip


def legend(arrangement: Arrangement, variable: str, nominal: float | None) -> list[Artist]:
    """Entries of curves, verdicts and marks; arguments as for `lines`."""
    growth = variable in RATES
    handles: list[Artist] = []
    family = arrangement.y
    if family is not None:
        for number, value in enumerate(family.values):
            words = wording.quantity(value, family.units)
            label = words if family.scale == "category" else f"{family.name} {words}"
            handles.append(Line2D([], [], label=label, **theme.style(number)))
    present = {int(v) for panel in arrangement.panels for v in np.unique(panel.data["verdict"])}
    for kind, face in _FACES.items():
        if int(kind) in present and (growth or kind not in (Verdict.UNSTABLE, Verdict.TOPPLES)):
            handles.append(
                Line2D(
                    [], [], linestyle="none", color=theme.INK, markersize=4.5, label=kind.label,
                    marker=_UNSTABLE_MARK if kind is Verdict.UNSTABLE else "o",
                    markerfacecolor=theme.INK if face is None else face,
                )
            )  # fmt: skip
    if growth:
        handles.append(Patch(facecolor="#F6E7DA", label="perturbations grow"))
    if nominal is not None:
        words = wording.quantity(nominal, arrangement.x.units)
        label = f"nominal: {arrangement.x.name} {words}"
        handles.append(Line2D([], [], color=theme.FAINT, linewidth=0.9, ls=":", label=label))
    return handles
