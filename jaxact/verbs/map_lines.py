"""What is drawn over a map of a sweep: exact boundaries, and the point that is nominal."""

from __future__ import annotations

import math

import xarray as xr

from jaxact.errors import UserError
from jaxact.parameters import KD, KP, MASS, known, of
from jaxact.plotting.panels import Arrangement
from jaxact.plotting.stability_map import cell_edges, place
from jaxact.sweeping import exact_lines, store
from jaxact.sweeping.exact_lines import ExactLines

_GAINS = (KP, KD)


def boundaries(arrangement: Arrangement) -> list[ExactLines | None]:
    """The exact boundary of every panel, over whichever two numbers it shows."""
    axes = [axis for axis in (arrangement.x, arrangement.y) if axis is not None]
    drawable = len(axes) == 2 and all(a.scale != "category" and known(a.name) for a in axes)
    if arrangement.kind == "lines" or not drawable:
        return [None] * len(arrangement.panels)
    windows = []
    for axis in axes:
        edges, bounds = cell_edges(axis), of(axis.name)
        ends = max(float(edges[0]), bounds.minimum), min(float(edges[-1]), bounds.maximum)
        windows.append(exact_lines.Window(axis.name, *ends, axis.scale == "log"))
    return [exact_lines.exact_lines(panel.data, *windows) for panel in arrangement.panels]


def nominal(
    results: xr.Dataset, arrangement: Arrangement, given: tuple[float, ...] = ()
) -> tuple[float, float] | None:
    """The point to mark: what was given, or the specification's own values; None out of view.

    Raises:
        UserError: as many numbers as there are axes were not given.
    """
    axes = [axis for axis in (arrangement.x, arrangement.y) if axis is not None]
    if arrangement.kind == "lines":
        axes = axes[:1]
    if given and len(given) != len(axes):
        shown = " ".join(f"{value:g}" for value in given)
        raise UserError(f"`nominal` {shown}: give {' and '.join(axis.name for axis in axes)}")
    own = store.nominal(results)
    if not given and any(axis.name not in own for axis in axes):
        return None
    # The default gains are the reference study's, chosen for its mass.
    usual = any(own[axis.name] == of(axis.name).default for axis in axes if axis.name in _GAINS)
    if not given and usual and own.get(MASS) != of(MASS).default:
        return None
    point = list(given) or [own[axis.name] for axis in axes]
    if any(math.isnan(value) for value in point):
        return None  # a robot's joints have their own
    if any(place(axis, value) is None for axis, value in zip(axes, point, strict=True)):
        return None
    return point[0], point[-1]
