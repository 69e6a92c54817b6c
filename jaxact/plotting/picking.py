"""Which value of a swept number is meant by one that a person writes."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from jaxact.errors import UserError

# Share of a value by which a number that is meant for it may differ: pictures write four digits.
_ROUNDING = 1e-3


def nearest(coordinate: xr.DataArray, given: str) -> int:
    """Place of the value nearest to a number.

    Args:
        coordinate: of numbers, shape (n,).
        given: as it is written, in the unit of the coordinate.

    Raises:
        UserError: no number, or one beyond the ends of the axis by more than half of the spacing
            there, and by more than rounding.
    """
    values = np.asarray(coordinate.values, float)
    number = _number(str(coordinate.name), given)
    hit = np.flatnonzero(values == number)
    if hit.size:
        return int(hit[0])
    known = np.unique(values[~np.isnan(values)])
    lower, upper = _room(known)
    if not known[0] - lower <= number <= known[-1] + upper:
        raise UserError(_outside(coordinate, number, known))
    return int(np.nanargmin(np.abs(values - number)))


def _number(name: str, given: str) -> float:
    try:
        number = float(given)
    except ValueError:
        number = math.nan
    if math.isnan(number):
        raise UserError(f"`select` {name}: '{given}' is not a number")
    return number


def _room(known: np.ndarray) -> tuple[float, float]:
    """How far below and above its rising values an axis still is the one that is meant."""
    finite = known[np.isfinite(known)]
    if not finite.size:
        return 0.0, 0.0
    steps = np.diff(finite) if finite.size > 1 else np.zeros(1)
    lower, upper = _ROUNDING * np.abs(finite[[0, -1]])
    return max(0.5 * steps[0], lower), max(0.5 * steps[-1], upper)


def _outside(coordinate: xr.DataArray, number: float, known: np.ndarray) -> str:
    units = str(coordinate.attrs.get("units", ""))
    unit = "" if units == "1" else f" {units}".rstrip()
    said = f"`select` {coordinate.name}: {number:g}{unit} is outside its axis"
    if len(known) == 1:
        return f"{said}, whose only value is {known[0]:g}{unit}"
    return f"{said}, which goes from {known[0]:g} to {known[-1]:g}{unit}"
