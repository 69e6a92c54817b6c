"""Which part of a sweep goes into which panel: axes, facets, titles. Nothing is drawn here."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import xarray as xr

from jaxact.errors import UserError, nearest
from jaxact.parameters import KD, KP, WN, ZETA
from jaxact.plotting import picking, wording

Kind = Literal["map", "scatter", "lines"]
KINDS: tuple[Kind, ...] = ("map", "scatter", "lines")
SAMPLE = "sample"
MOST_PANELS = 36
MOST_SERIES = 7
MOST_CATEGORIES = 12


@dataclass(frozen=True)
class Axis:
    """One swept parameter as it is drawn.

    Attributes:
        name: parameter name.
        values: distinct values in the order drawn, shape (n,); numbers, or names of categories.
        units: SI unit, "" for none.
        label: text of the axis.
        scale: "log" or "linear" as the values are spaced, "category" for names.
    """

    name: str
    values: np.ndarray
    units: str
    label: str
    scale: Literal["log", "linear", "category"]

    @property
    def in_milliseconds(self) -> bool:
        """True for times below a second: their ticks are written in ms."""
        return self.units == "s" and self.scale != "category" and abs(self.values[-1]) < 1.0


@dataclass(frozen=True)
class Panel:
    """One small picture: where it stands, its caption, and its part of the sweep.

    Attributes:
        row, column: place in the grid of panels.
        caption: above the panel: value of the column's facet with its unit, "" where there is none.
        row_caption: beside the last panel of a row: value of the row's facet, "" where there is
            none.
        data: the part of the store; dims (y, x) for a map, (x,) or (series, x) for lines, (point,)
            for a scatter. Facet parameters are scalar coordinates.
    """

    row: int
    column: int
    caption: str
    row_caption: str
    data: xr.Dataset


@dataclass(frozen=True)
class Arrangement:
    """All panels of a picture.

    Attributes:
        kind: "map", "scatter" or "lines".
        x, y: the axes; y is the family of curves for lines (None: a single curve).
        rows, columns: size of the grid of panels.
        panels: one entry a panel, row by row.
        data: the part of the sweep that is shown, all panels together.
        selected: captions of the parameters of which one value was picked.
    """

    kind: Kind
    x: Axis
    y: Axis | None
    rows: int
    columns: int
    panels: tuple[Panel, ...]
    data: xr.Dataset
    selected: tuple[str, ...] = ()


def arrange(
    dataset: xr.Dataset,
    *,
    kind: Kind | None = None,
    x: str | None = None,
    y: str | None = None,
    facet: Sequence[str] = (),
    select: Mapping[str, str] | None = None,
) -> Arrangement:
    """Panels of a sweep: x and y across each panel, the facets from panel to panel.

    Args:
        dataset: a sweep store: a dimension for each gridded parameter, and `sample` for drawn ones.
        kind: what to draw; None: scatter where parameters were drawn, map for a grid of two or more
            axes, lines for one.
        x, y: parameters across a panel; None: kp and kd where they are swept, else the first two.
        facet: at most two gridded parameters, rows then columns; further gridded ones are added.
        select: parameter -> value within its axis; keeps the nearest value of that gridded
            parameter only.

    Raises:
        UserError: a name that was not swept, a value outside its axis, an axis with a single value,
            more parameters than can be shown, and a kind that does not fit the store.
    """
    dataset = part_of(dataset, select or {})
    gridded, drawn = _gridded(dataset), _drawn(dataset)
    swept = gridded | drawn
    for name in (x, y):
        if name is not None:
            _known(name, swept, "axis")
    for name in facet:
        if name in drawn:
            raise UserError(f"facet '{name}' was drawn at random; use it as `x` or `y`")
        _known(name, gridded, "facet")
    many = [name for name, values in swept.items() if len(_distinct(values)) > 1]
    kind = _kind(kind, bool(drawn), many, y)
    # a random sample spreads over what was drawn; its gridded parameters make panels
    preferred = [name for name in many if name in drawn] or many
    x, y = _axes(kind, x, y, facet, swept, many, preferred)
    rest = [name for name in many if name in gridded and name not in (x, y)]
    facets = _facets(facet, rest, (x, y), swept)
    selected = tuple(
        _caption(axis(swept[name]), _distinct(swept[name])[0], dataset) for name in select or {}
    )
    shown = dataset
    dataset = dataset.squeeze([d for d in dataset.dims if d in gridded and dataset.sizes[d] == 1])
    rows, columns, panels = _panels(dataset, facets, swept)
    order = [name for name in (y, x) if name is not None]
    panels = [replace(p, data=_shaped(p.data, order, bool(drawn))) for p in panels]
    axis_x, axis_y = axis(swept[x]), None if y is None else axis(swept[y])
    if kind == "map":
        axis_x, axis_y = _evened(axis_x), None if axis_y is None else _evened(axis_y)
    return Arrangement(kind, axis_x, axis_y, rows, columns, tuple(panels), shown, selected)


def part_of(dataset: xr.Dataset, select: Mapping[str, str]) -> xr.Dataset:
    """The part of a sweep with the nearest value of some gridded parameters, in rising order.

    Args:
        dataset, select: as for `arrange`, whose errors it raises.
    """
    return _select(_sorted(dataset), select)


def _shaped(data: xr.Dataset, order: list[str], drawn: bool) -> xr.Dataset:
    """Dimensions in the order they are drawn, or all samples in one row."""
    if not drawn:
        return data.transpose(*order, missing_dims="ignore")
    plain = data.reset_index(list(data.indexes))
    return plain.stack({"point": list(data.sizes)}, create_index=False)


def axis(coordinate: xr.DataArray) -> Axis:
    """The axis of a coordinate: its values, label, and how it is spaced."""
    values = _distinct(coordinate)
    units = str(coordinate.attrs.get("units", ""))
    name = str(coordinate.name)
    result = Axis(name, values, units, "", _scale(values))
    shown = "ms" if result.in_milliseconds else units
    label = wording.axis_label(name, shown, str(coordinate.attrs.get("long_name", "")))
    return replace(result, label=label)


def _evened(given: Axis) -> Axis:
    """A few unevenly spaced numbers as categories: equal cells, each with its value."""
    if given.scale == "category" or len(given.values) > MOST_CATEGORIES:
        return given
    steps = np.log(given.values) if given.scale == "log" else given.values
    if len(steps) < 3 or np.ptp(np.diff(steps)) <= 0.02 * np.diff(steps).mean():
        return given
    label = given.label.rsplit(" [", 1)[0]
    return replace(given, scale="category", label=label)


def _sorted(dataset: xr.Dataset) -> xr.Dataset:
    """Gridded numbers in rising order, whatever the order they were listed in."""
    numeric = {name: c.values for name, c in _gridded(dataset).items() if c.dtype.kind in "fiu"}
    mixed = [name for name, values in numeric.items() if not np.all(np.diff(values) > 0.0)]
    return dataset.sortby(mixed) if mixed else dataset


def _gridded(dataset: xr.Dataset) -> dict[str, xr.DataArray]:
    dims = [str(dim) for dim in dataset["growth_rate"].dims if dim != SAMPLE]
    return {dim: dataset[dim] for dim in dims}


def _drawn(dataset: xr.Dataset) -> dict[str, xr.DataArray]:
    return {
        str(name): coordinate
        for name, coordinate in dataset.coords.items()
        if coordinate.dims == (SAMPLE,) and name != SAMPLE
    }


def _distinct(coordinate: xr.DataArray) -> np.ndarray:
    values = coordinate.values
    if values.dtype.kind in "OSUT":
        return np.array(list(dict.fromkeys(str(v) for v in values.ravel())), dtype=object)
    return np.unique(values)


def _scale(values: np.ndarray) -> Literal["log", "linear", "category"]:
    """Log where the ratios of neighbours are evener than their differences."""
    if values.dtype == object or not np.all(np.isfinite(values)):
        return "category"
    if len(values) < 3 or values[0] <= 0:
        return "linear"
    steps, ratios = np.diff(values), np.diff(np.log(values))
    return "log" if np.ptp(ratios) / ratios.mean() < np.ptp(steps) / steps.mean() else "linear"


def _known(name: str, known: Iterable[str], what: str) -> None:
    known = list(known)
    if name not in known:
        raise UserError(
            f"unknown {what} '{name}': this sweep did not vary it; {nearest(name, known)}"
        )


def _select(dataset: xr.Dataset, select: Mapping[str, str]) -> xr.Dataset:
    for name, given in select.items():
        swept = _gridded(dataset)
        if name in _drawn(dataset):
            raise UserError(f"`select` {name}: it was drawn at random, so it has no values to pick")
        _known(name, swept, "axis to select")
        values = swept[name].values
        if values.dtype.kind in "OSUT":
            names = [str(v) for v in values]
            if given not in names:
                raise UserError(f"`select` {name}: no '{given}' here; {nearest(given, names)}")
            index = names.index(given)
        else:
            index = picking.nearest(swept[name], given)
        dataset = dataset.isel({name: [index]})
    return dataset


def _kind(kind: Kind | None, drawn: bool, many: list[str], y: str | None) -> Kind:
    if not many:
        raise UserError("this sweep has a single loop: nothing to draw along; simulate it instead")
    if kind is None:
        if drawn:
            return "scatter"
        return "lines" if len(many) == 1 and y is None else "map"
    if kind not in KINDS:
        raise UserError(f"unknown kind '{kind}'; {nearest(kind, KINDS)}")
    if drawn != (kind == "scatter"):
        shape = "random sample: draw a scatter" if drawn else "grid: draw a map or lines"
        raise UserError(f"kind '{kind}' does not fit, the sweep is a {shape}")
    return kind


def _axes(
    kind: Kind,
    x: str | None,
    y: str | None,
    facet: Sequence[str],
    swept: Mapping[str, xr.DataArray],
    many: list[str],
    preferred: list[str],
) -> tuple[str, str | None]:
    free = [name for name in many if name not in (x, y, *facet)]
    free.sort(key=lambda name: name not in preferred)
    numeric = [name for name in free if _scale(_distinct(swept[name])) != "category"]
    gains = [name for name in (KP, KD) if name in numeric]
    queue = gains + [name for name in numeric if name not in gains]
    queue += [name for name in free if name not in queue]
    if x is None:
        if not queue:
            raise UserError("no parameter is left for the x axis; give fewer facets")
        x = queue.pop(0)
    if y is None and kind != "lines":
        if not queue:
            raise UserError(f"a {kind} needs two swept parameters; draw lines instead")
        y = queue.pop(0)
    if kind == "lines" and y is None:
        short = [n for n in free if n != x and len(_distinct(swept[n])) <= MOST_SERIES]
        y = short[-1] if short else None
    if x == y:
        raise UserError(f"x and y are both '{x}'; choose two parameters")
    for name in (x, y):
        if name is not None and name not in many:
            value = _distinct(swept[name])[0]
            only = wording.quantity(value, str(swept[name].attrs.get("units", "")))
            raise UserError(f"axis '{name}' has the single value {only}; choose another axis")
    if kind == "lines" and y is not None and len(_distinct(swept[y])) > MOST_SERIES:
        count = len(_distinct(swept[y]))
        raise UserError(
            f"axis '{y}' has {count} values: too many curves (at most {MOST_SERIES}); "
            "draw a map, or pick one with `select`"
        )
    return x, y


def _facets(
    facet: Sequence[str],
    rest: list[str],
    used: tuple[str, str | None],
    swept: Mapping[str, xr.DataArray],
) -> list[str]:
    for name in facet:
        if name in used:
            raise UserError(f"'{name}' is an axis already; choose another facet")
    if len(set(facet)) != len(facet):
        raise UserError("`facet` names the same parameter twice")
    facets = [name for name in facet if name in rest] + [n for n in rest if n not in facet]
    if len(facets) > 2:
        surplus = ", ".join(facets[2:])
        raise UserError(
            f"the sweep has more axes than panels can show ({surplus}); "
            f"keep one value with `select` {facets[-1]}=VALUE"
        )
    sizes = {name: len(_distinct(swept[name])) for name in facets}
    count, largest = math.prod(sizes.values()), max(sizes, key=lambda n: sizes[n], default="")
    if count > MOST_PANELS:
        raise UserError(
            f"facets {' x '.join(facets)} make {count} panels (at most {MOST_PANELS}); "
            f"keep one value with `select` {largest}=VALUE"
        )
    return facets


def _panels(
    dataset: xr.Dataset, facets: list[str], swept: Mapping[str, xr.DataArray]
) -> tuple[int, int, list[Panel]]:
    if not facets:
        return 1, 1, [Panel(0, 0, "", "", dataset)]
    axes = [axis(swept[name]) for name in facets]
    if len(axes) == 1:
        columns = min(len(axes[0].values), 3 if len(axes[0].values) != 4 else 2)
        rows = math.ceil(len(axes[0].values) / columns)
    else:
        rows, columns = len(axes[0].values), len(axes[1].values)
    panels = []
    for number, index in enumerate(np.ndindex(*(len(a.values) for a in axes))):
        row, column = index if len(axes) == 2 else divmod(number, columns)
        chosen = [a.values[i] for a, i in zip(axes, index, strict=True)]
        part = _part(dataset, axes, chosen)
        captions = [_caption(a, v, part) for a, v in zip(axes, chosen, strict=True)]
        above = captions[-1] if len(axes) == 1 or row == 0 else ""
        beside = captions[0] if len(axes) == 2 else ""
        panels.append(Panel(int(row), int(column), above, beside, part))
    return rows, columns, panels


def _part(dataset: xr.Dataset, axes: list[Axis], chosen: list[Any]) -> xr.Dataset:
    for facet, value in zip(axes, chosen, strict=True):
        values = dataset[facet.name].values
        named = values.dtype.kind in "OSUT"
        match = [str(v) == value for v in values] if named else values == value
        index = int(np.flatnonzero(match)[0])
        dataset = dataset.isel({facet.name: index})
    return dataset


def _caption(facet: Axis, value: object, part: xr.Dataset) -> str:
    """`delay 1 ms`, or for an actuator its name and dynamics."""
    if facet.name != "actuator":
        return f"{facet.name.replace('_', ' ')} {wording.quantity(value, facet.units)}"
    text = wording.display_name(value)
    if WN in part.coords and part[WN].size == 1 and np.isfinite(part[WN].item()):
        text += f" ({part[WN].item():.4g} rad/s, ζ {part[ZETA].item():.3g})"
    return text
