"""What a sweep shows, in a few lines of text: how many loops there are, and what they did."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from jaxact.status import Verdict
from jaxact.sweep.samples import SAMPLE

if TYPE_CHECKING:
    import xarray as xr

# Never a case of their own: the plane of a stability map, and the points of a random sample.
_POOLED = ("kp", "kd", SAMPLE)
_MOST_CASES = 40


def summary(results: xr.Dataset) -> str:
    """Number of loops, share of every verdict, and the share of stable loops in each case.

    results: of a sweep

    A case is one combination of all axes but kp and kd, e.g. one actuator with one delay; where
    there are very many, only the totals are given.
    """
    verdict = results["verdict"].values
    parts = (
        f"{_percent(verdict == kind)} {kind.label}" for kind in Verdict if np.any(verdict == kind)
    )
    lines = [f"{verdict.size:,} loops: {', '.join(parts)}"]
    dims = [str(dim) for dim in results["verdict"].dims if dim not in _POOLED]
    sizes = [results.sizes[dim] for dim in dims]
    if not dims or np.prod(sizes, dtype=float) > _MOST_CASES:
        return lines[0]
    cases = [_case(results, dims, place) for place in np.ndindex(*sizes)]
    width = max(len(name) for name, _ in cases)
    lines += [f"  {name:{width}}  {_percent(stable):>6} stable" for name, stable in cases]
    return "\n".join(lines)


def _case(results: xr.Dataset, dims: list[str], place: tuple[int, ...]) -> tuple[str, np.ndarray]:
    """The name of a case, and which of its loops are stable."""
    part = results.isel(dict(zip(dims, place, strict=True)))
    names = ", ".join(f"{dim} = {_value(part.coords[dim])}" for dim in dims)
    return names, part["verdict"].values == Verdict.STABLE


def _value(coordinate: xr.DataArray) -> str:
    value = coordinate.item()
    if isinstance(value, str):
        return value
    units = str(coordinate.attrs.get("units", "1"))
    return f"{value:g}" if units == "1" else f"{value:g} {units}"


def _percent(which: np.ndarray) -> str:
    share = 100.0 * float(np.mean(which))
    if 0.0 < share < 0.05 or 99.95 <= share < 100.0:
        return f"{int(np.sum(which)):,}"
    return f"{share:.1f} %"
