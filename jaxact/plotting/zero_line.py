"""The smooth line on which a rate of a map's loops is zero, between the loops computed."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from jaxact.plotting.panels import Arrangement, Axis, Panel
from jaxact.sweeping.tracing import Curve, trace

# Values on the line, in units of the typical growth rate, are this near to zero.
_ZERO = 1e-4


def zero_line(
    arrangement: Arrangement, panel: Panel, rate: str = "growth_rate"
) -> tuple[Curve, ...]:
    """Where a rate, linear between neighbours on the axes' own scales, is zero.

    Rates are those of linearised loops, so that this is where those change stability; it is
    interpolated between the loops that were computed. None of an axis of categories.
    """
    x, y = arrangement.x, arrangement.y
    if y is None or "category" in (x.scale, y.scale):
        return ()
    growth = np.asarray(panel.data[rate].values, dtype=float)
    finite = np.abs(growth[np.isfinite(growth)])
    if min(growth.shape) < 2 or not finite.size:
        return ()
    # Of loops that are far from zero little more than the sign counts.
    size = max(float(np.median(finite)), 1e-9)
    columns, rows = _scaled(x), _scaled(y)
    between = RegularGridInterpolator((rows, columns), np.arcsinh(growth / size))

    def decays(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        return np.asarray(between(np.column_stack([second, first])) < 0.0)

    lines = []
    for first, second in trace(decays, columns, rows):
        # Beside loops without a growth rate nothing is known: the line has a gap there.
        known = np.abs(between(np.column_stack([second, first]))) < _ZERO
        lines.append((_back(x, np.where(known, first, np.nan)), _back(y, second)))
    return tuple(lines)


def _scaled(axis: Axis) -> np.ndarray:
    values = np.asarray(axis.values, dtype=float)
    return np.log(values) if axis.scale == "log" else values


def _back(axis: Axis, values: np.ndarray) -> np.ndarray:
    return np.exp(values) if axis.scale == "log" else values
