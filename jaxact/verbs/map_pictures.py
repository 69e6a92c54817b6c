"""Pictures of a sweep's results: maps, samples and curves, on given axes or as a whole page."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from matplotlib import pyplot
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from jaxact.errors import UserError
from jaxact.plotting import caption, even_grid, thinning
from jaxact.plotting import field as _field
from jaxact.plotting import lines as _lines
from jaxact.plotting import panels as _panels
from jaxact.plotting import scatter as _scatter
from jaxact.plotting import stability_map as _map
from jaxact.plotting.zero_line import zero_line
from jaxact.sweeping import agreement, variables
from jaxact.verbs import map_lines
from jaxact.verbs.given_axes import on_axes

if TYPE_CHECKING:
    from jaxact.plotting.panels import Arrangement, Kind

_SMALL = "small"
Select = Mapping[str, float | str]
"""Parameter -> value within its axis, of which the nearest is kept."""


@on_axes
def stability_map(
    maps: xr.Dataset,
    *,
    variable: str | None = None,
    x: str | None = None,
    y: str | None = None,
    select: Mapping[str, float | str] | None = None,
    ax: Axes | None = None,
    axes: Sequence[Axes] | None = None,
    exact: bool = True,
    nominal: bool = True,
    colorbar: bool = True,
    legend: bool = True,
) -> Axes | np.ndarray:
    """A variable of a sweep over two parameters, verdicts hatched, the exact boundary on top.

    Args:
        maps: from `jaxact.sweep` or `jaxact.load_result`.
        variable: coloured; None for the growth rate.
        x, y: parameters across the map; None for kp and kd where they were swept.
        select: parameter -> value within its axis, of which the nearest is kept.
        ax: for a single map.
        axes: for as many maps as what is left over has values.
        exact: draw the exact boundary, solid of the sampled loop and dashed in continuous time; of
            robots, where the linearised rate is zero.
        nominal: mark the specification's own parameters, or the defaults.
        colorbar, legend: add them.

    Returns:
        The axes, as they were given; an array of them where there are several maps.

    Raises:
        UserError: parameters that were not swept, a value outside its axis, or another number of
            axes than of maps.
    """
    arrangement, maps = _arranged(maps, "map", x, y, select)
    variable = _field.usual(maps) if variable is None else variable
    shown = _field.field(maps, variable)
    own = ax is None and axes is None
    given = _axes(arrangement, ax, axes)
    handles = _draw_maps(given, maps, arrangement, shown, exact=exact, marked=nominal)
    if colorbar:
        _colorbar(given, shown)
    return _finished(given, handles if legend else [], outer=own)


@on_axes
def scatter(
    maps: xr.Dataset,
    *,
    variable: str | None = None,
    x: str | None = None,
    y: str | None = None,
    select: Select | None = None,
    ax: Axes | None = None,
    axes: Sequence[Axes] | None = None,
    nominal: bool = True,
    colorbar: bool = True,
    legend: bool = True,
) -> Axes | np.ndarray:
    """A variable at every loop of a sweep that was drawn at random, over two of its parameters.

    Args:
        maps, variable, x, y, select, ax, axes, nominal, colorbar, legend: as for `stability_map`.
    """
    arrangement, maps = _arranged(maps, "scatter", x, y, select)
    variable = _field.usual(maps) if variable is None else variable
    shown = _field.field(maps, variable)
    given = _axes(arrangement, ax, axes)
    known = map_lines.boundaries(arrangement)
    point = map_lines.nominal(maps, arrangement) if nominal else None
    for one, panel, exact in zip(given, arrangement.panels, known, strict=True):
        _dress(one, arrangement, panel)
        _scatter.draw(one, arrangement, panel, shown, exact=exact, nominal=point)
    if colorbar:
        _colorbar(given, shown)
    handles = _scatter.legend(arrangement, known, point, variable) if legend else []
    return _finished(given, handles, outer=ax is None and axes is None)


@on_axes
def lines(
    maps: xr.Dataset,
    *,
    variable: str | None = None,
    x: str | None = None,
    y: str | None = None,
    select: Select | None = None,
    ax: Axes | None = None,
    axes: Sequence[Axes] | None = None,
    nominal: bool = True,
    legend: bool = True,
) -> Axes | np.ndarray:
    """A variable of a sweep along one parameter, a curve for each value of another.

    Args:
        maps, variable, select, ax, axes, nominal, legend: as for `stability_map`.
        x: along the axis; None for kp where it was swept.
        y: a curve for each value; None for kd where it was swept.
    """
    arrangement, maps = _arranged(maps, "lines", x, y, select)
    variable = _field.usual(maps) if variable is None else variable
    _field.field(maps, variable)  # what it does not have is said here
    given = _axes(arrangement, ax, axes)
    point = map_lines.nominal(maps, arrangement) if nominal else None
    marked = None if point is None else point[0]
    for one, panel in zip(given, arrangement.panels, strict=True):
        _dress(one, arrangement, panel)
        _lines.draw(one, maps, arrangement, panel, variable, marked)
        one.set_ylabel(_field.variable_label(maps[variable]))
    handles = _lines.legend(arrangement, variable, marked) if legend else []
    return _finished(given, handles, outer=ax is None and axes is None)


def page(
    results: xr.Dataset,
    *,
    kind: Kind | None = None,
    x: str | None = None,
    y: str | None = None,
    facet: Sequence[str] = (),
    select: Select | None = None,
    variable: str | None = None,
    nominal: Sequence[float] = (),
    title: str | None = None,
    compare: bool = True,
) -> tuple[Figure, str, str]:
    """A whole page of panels, titled, with a legend and small print below.

    Args:
        results: from `jaxact.load_result`.
        kind: "map", "scatter" or "lines"; None for what suits.
        x, y, select: as for `stability_map`.
        facet: one panel for each value of one parameter, or of two for rows and columns.
        variable: coloured; None for the growth rate, or where robots topple the shaking rate.
        nominal: point to mark; () for the specification's own parameters.
        title: above it; None for the sweep's description.
        compare: every verdict with exact theory, in the small print.

    Returns:
        The figure, its small print, and its kind.
    """
    given = results
    arrangement, results = _arranged(results, kind, x, y, select, facet)
    if even_grid.refined(given):
        computed = even_grid.of_cases(given, arrangement.data)
    else:
        computed = _panels.part_of(given, _picked(select))
    variable = _field.usual(results) if variable is None else variable
    _field.field(results, variable)  # a misspelt name is told before anything is computed
    known = map_lines.boundaries(arrangement)
    footer = _small_print(
        computed, arrangement, compare=compare, drawn=any(one is not None for one in known)
    )
    heading = results.attrs.get("title", "") if title is None else title
    shared: dict[str, Any] = {"variable": variable, "title": heading, "footer": footer}
    marked = map_lines.nominal(results, arrangement, tuple(nominal))
    draw: Callable[..., Figure]
    if arrangement.kind == "lines":
        draw, shared["nominal"] = _lines.lines, None if marked is None else marked[0]
    else:
        shared |= {"boundaries": known, "nominal": marked}
        draw = _scatter.scatter
        if arrangement.kind == "map":
            draw, shared["linearised"] = _map.stability_map, not agreement.is_plain_mass(results)
    return draw(results, arrangement, **shared), footer, arrangement.kind


def _small_print(
    computed: xr.Dataset, arrangement: Arrangement, *, compare: bool, drawn: bool
) -> str:
    """What was simulated, and how many verdicts differ from exact theory.

    Args:
        computed: the loops computed, where others are shown.
        arrangement: of the page.
        compare: the verdicts with exact theory.
        drawn: exact boundaries are.
    """
    exact = variables.KIND in computed.attrs
    found = agreement.sweep_agreement(computed) if compare and not exact else None
    parts = [
        f"Shown: {', '.join(arrangement.selected)}." if arrangement.selected else "",
        thinning.left_out(computed),
        caption.exact(computed) if exact else caption.simulated(computed),
        caption.compared(found) if found is not None else "",
        caption.linear_only(arrangement.data) if drawn or found is not None else "",
    ]
    return " ".join(part for part in parts if part)


def _arranged(
    maps: xr.Dataset,
    kind: Kind | None,
    x: str | None,
    y: str | None,
    select: Select | None,
    facet: Sequence[str] = (),
) -> tuple[Arrangement, xr.Dataset]:
    """How a sweep lies on panels, and the sweep on an even grid."""
    if not isinstance(maps, xr.Dataset) or "specification" not in maps.attrs:
        raise UserError(
            f"maps: a value of type {type(maps).__name__} that is not a sweep's; give the "
            "dataset of jaxact.sweep(...) or jaxact.load_result(...), with its attributes"
        )
    swept = json.loads(maps.attrs["specification"])["axes"]
    lost = next((name for name in swept if name not in maps.coords), None)
    if lost is not None:  # the exact boundary would be that of another value
        raise UserError(
            f"maps: {lost} was swept, and these no longer say which value they have; pick one that "
            f"stays with them, e.g. maps.isel({lost}=0), not its mean or with drop=True"
        )
    maps = even_grid.resampled(maps) if even_grid.refined(maps) else maps
    picked = _picked(select)
    part = thinning.thinned(_panels.part_of(maps, picked))
    there = {name: str(part[name].item()) for name in picked}
    shown = _panels.arrange(part, kind=kind, x=x, y=y, facet=tuple(facet), select=there)
    return shown, thinning.thinned(maps)


def _picked(select: Select | None) -> dict[str, str]:
    return {name: str(value) for name, value in (select or {}).items()}


def _axes(arrangement: Arrangement, ax: Axes | None, axes: Sequence[Axes] | None) -> list[Axes]:
    """An axes for each panel: those given, or of a new figure."""
    if ax is not None and axes is not None:
        raise UserError("ax, axes: give one of the two, `ax` for a single map")
    given = [ax] if ax is not None else None if axes is None else list(np.ravel(np.array(axes)))
    if given is None:
        grid = pyplot.subplots(arrangement.rows, arrangement.columns, sharex=True, sharey=True,
                               squeeze=False, layout="constrained")[1]  # fmt: skip
        given = [grid[panel.row, panel.column] for panel in arrangement.panels]
    if len(given) != len(arrangement.panels):
        several = f"there are {len(arrangement.panels)} maps, and {len(given)} axes; give as many"
        raise UserError(several + _or_select(arrangement, len(given)))
    return given


def _or_select(arrangement: Arrangement, given: int) -> str:
    """What else to do where there are more maps than axes: one that was swept picks a map."""
    shown, across = arrangement.data, {arrangement.x.name, arrangement.y and arrangement.y.name}
    apart = [name for name in shown.dims if name not in across and shown.sizes[name] > 1]
    if given >= len(arrangement.panels) or not apart:
        return ""
    swept = shown[apart[0]].values.tolist()  # names of actuators, too
    return f", or select, e.g. select={{{str(apart[0])!r}: {swept[-1]!r}}}"


def _dress(one: Axes, arrangement: Arrangement, panel: _panels.Panel) -> None:
    """Scales, labels and caption of a panel."""
    _map.dress_axis(one, "x", arrangement.x)
    one.set_xlabel(arrangement.x.label)
    if arrangement.y is not None and arrangement.kind != "lines":
        _map.dress_axis(one, "y", arrangement.y)
        one.set_ylabel(arrangement.y.label)
    captions = (panel.caption, panel.row_caption, *arrangement.selected)
    if words := ", ".join(word for word in captions if word):
        one.set_title(words)


def _colorbar(given: Sequence[Axes], shown: _field.Field) -> None:
    mappable = ScalarMappable(norm=shown.norm, cmap=shown.colors)
    bar = given[0].figure.colorbar(mappable, ax=given, extend=shown.extend)
    _field.dress_colorbar(bar, shown)


def _finished(given: Sequence[Axes], handles: list[Artist], *, outer: bool) -> Axes | np.ndarray:
    """The axes as they are returned; outer: labels at the edge of the figure only."""
    for one in given if outer else ():
        one.label_outer()
    if handles:
        given[0].legend(handles=handles, fontsize=_SMALL)
    return given[0] if len(given) == 1 else np.array(given, dtype=object)


def _draw_maps(
    axes: Sequence[Axes], maps: xr.Dataset, arrangement: Arrangement,
    shown: _field.Field, *, exact: bool, marked: bool,
) -> list[Artist]:  # fmt: skip
    """Draw all panels; what a legend of them says is returned."""
    plain = agreement.is_plain_mass(maps)
    known = map_lines.boundaries(arrangement) if exact and plain else [None] * len(axes)
    rate = shown.variable if shown.variable in _field.RATES else _field.usual(maps)
    point = map_lines.nominal(maps, arrangement) if marked else None
    zeros = [
        zero_line(arrangement, panel, rate) if exact and not plain else ()
        for panel in arrangement.panels
    ]
    for one, panel, its, zero in zip(axes, arrangement.panels, known, zeros, strict=True):
        _dress(one, arrangement, panel)
        _map.draw(one, arrangement, panel, shown, exact=its, zero=zero, nominal=point)
    return _map.legend_handles(
        arrangement, known, point, shown.variable, linearised=rate if any(zeros) else None
    )
