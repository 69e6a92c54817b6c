"""What a sweep shows, in a few lines of text: how many loops there are, and what they did."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jaxact.loops.samples import SAMPLE
from jaxact.parameters import KD, KP
from jaxact.status import Verdict

if TYPE_CHECKING:
    import xarray as xr

# Never a case of their own: the plane of a stability map, and the points of a random sample.
_POOLED = (KP, KD, SAMPLE)
_MOST_CASES = 40
# Loops whose verdicts are read at once.
_PART = 4_000_000


def summary(results: xr.Dataset) -> str:
    """Number of loops, share of every verdict, and the share of stable loops in each case.

    A case is one combination of all axes but kp and kd, e.g. one actuator with one delay; where
    there are very many, only the totals are given.

    Args:
        results: of a sweep; read in parts.
    """
    verdict = results["verdict"]
    dims = [str(dim) for dim in verdict.dims if dim not in _POOLED]
    sizes = [results.sizes[dim] for dim in dims]
    if np.prod(sizes, dtype=float) > _MOST_CASES:
        dims, sizes = [], []
    cases = {
        place: _counts(verdict.isel(dict(zip(dims, place, strict=True))))
        for place in np.ndindex(*sizes)
    }
    total = sum(cases.values(), start=np.zeros(len(Verdict), int))
    parts = (
        f"{_percent(total[kind], verdict.size)} {kind.label}" for kind in Verdict if total[kind]
    )
    lines = [f"{verdict.size:,} loops: {', '.join(parts)}"]
    if not dims:
        return lines[0]
    names = [_name(results, dims, place) for place in cases]
    width = max(map(len, names))
    lines += [
        f"  {name:{width}}  {_percent(counts[Verdict.STABLE], int(counts.sum())):>6} stable"
        for name, counts in zip(names, cases.values(), strict=True)
    ]
    return "\n".join(lines)


def _counts(verdict: xr.DataArray) -> np.ndarray:
    """How many loops have each verdict, shape (verdicts,); read in parts of bounded size."""
    if not verdict.dims:
        return np.bincount([int(verdict)], minlength=len(Verdict))
    first = verdict.dims[0]
    rows = max(1, _PART * verdict.sizes[first] // max(verdict.size, 1))
    found = np.zeros(len(Verdict), int)
    for start in range(0, verdict.sizes[first], rows):
        part = verdict.isel({first: slice(start, start + rows)}).values
        found += np.bincount(part.ravel(), minlength=len(Verdict))
    return found


def _name(results: xr.Dataset, dims: list[str], place: tuple[int, ...]) -> str:
    """The name of a case."""
    part = results.isel(dict(zip(dims, place, strict=True)))
    return ", ".join(f"{dim} = {_value(part.coords[dim])}" for dim in dims)


def _value(coordinate: xr.DataArray) -> str:
    value = coordinate.item()
    if isinstance(value, str):
        return value
    units = str(coordinate.attrs.get("units", "1"))
    return f"{value:g}" if units == "1" else f"{value:g} {units}"


def _percent(number: int, total: int) -> str:
    share = 100.0 * number / total
    if 0.0 < share < 0.05 or 99.95 <= share < 100.0:
        return f"{number:,}"
    return f"{share:.1f} %"
