"""What the report of a joint's sweep has of its results: their own axes, and simulated cells."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.errors import UserError
from jaxact.loops.axes import Axis
from jaxact.loops.specification import Specification
from jaxact.parameters import KD, KP
from jaxact.status import Verdict

if TYPE_CHECKING:
    import xarray as xr

# So many with all their numbers take half a megabyte.
_MOST_CELLS = 30_000
_IN_A_CELL = ("growth_rate", "limit_cycle_amplitude", "limit_cycle_frequency")


def own(specification: Specification, results: xr.Dataset) -> Specification:
    """What a sweep's results, or a part of them, are of: their values instead of the axes'.

    Args:
        specification: of the whole sweep.
        results: of it, or some of its loops.

    Raises:
        UserError: no loop is left, or it is not known any more which value of an axis one has.
    """
    if not results["verdict"].size:
        raise UserError("these results are of no loops; select some")
    axes, fixed = [], dict(specification.parameters)
    for axis in specification.axes:
        if axis.name not in results.coords:  # the exact boundary would be that of another value
            raise UserError(
                f"results: {axis.name} was swept, and these no longer say which value they have;"
                f" pick one that stays with them, e.g. maps.isel({axis.name}=0), not its mean or"
                " with drop=True"
            )
        values = results[axis.name]
        if values.ndim == 0:
            fixed.pop(axis.name, None)  # later ones come over earlier ones
            fixed[axis.name] = values.item()
        elif values.dims == (axis.name,):
            axes.append(Axis(axis.name, listed=tuple(values.values.tolist())))
        else:  # along the samples that were drawn, or refined
            axes.append(axis)
    return dataclasses.replace(specification, parameters=fixed, axes=tuple(axes))


def cells(specification: Specification, results: xr.Dataset) -> dict[str, Any] | None:
    """What was simulated, thinned out to what a page can hold; None where it lies on no grid.

    Args:
        specification: from `own`.
        results: that it is of.

    Returns:
        Rows of kd, of each of the loops of the other axes in their order; `near`: they are not
        simulated loops themselves, but show the nearest. A verdict is a digit, or a dash where
        there is none yet.
    """
    names = [name for name in _IN_A_CELL if name in results]
    kept = results[["verdict", *names]]
    near = "adaptive" in kept.attrs
    grid = _even(kept) if near else kept
    if grid is None or {*grid["verdict"].dims} != {axis.name for axis in specification.axes}:
        return None
    others = [axis.name for axis in specification.axes if axis.name not in (KP, KD)]
    return {**_rows(grid.sortby([KP, KD]), others), "near": near}


def _even(results: xr.Dataset) -> xr.Dataset | None:
    """An even grid of a sweep that was refined over the gains; None of any other, or of a part."""
    from jaxact.plotting import even_grid  # slow to import

    said = json.loads(results.attrs["adaptive"])
    if {*said["refined"]} != {KP, KD} or "sample" not in results.dims:
        return None
    axes = json.loads(results.attrs["specification"])["axes"]
    columns = [results[name].values.tolist() for name in said["cases"]]
    there = {*zip(*columns, strict=True)} if columns else {()}
    if len(there) < math.prod(len(axes[name]) for name in said["cases"]):
        return None
    return even_grid.resampled(results)


def _rows(grid: xr.Dataset, others: list[str]) -> dict[str, Any]:
    """The cells of a grid over kp, kd and other axes."""
    stride = max(1, math.ceil(math.sqrt(grid["verdict"].size / _MOST_CELLS)))
    thin = grid.isel({KP: slice(None, None, stride), KD: slice(None, None, stride)})
    shape = (-1, thin.sizes[KD] * thin.sizes[KP])

    def rows(name: str) -> np.ndarray:
        return thin[name].transpose(*others, KD, KP).values.reshape(shape)

    known = {status.value for status in Verdict}
    verdicts = [
        "".join(str(code) if code in known else "-" for code in row) for row in rows("verdict")
    ]
    numbers: Mapping[str, Any] = {
        str(name): [
            [float(f"{x:.3g}") if np.isfinite(x) else None for x in row] for row in rows(str(name))
        ]
        for name in thin.data_vars
        if name != "verdict" and bool(np.isfinite(thin[name]).any())
    }
    ends = {name: thin[name].values.tolist() for name in (KP, KD)}
    return {**ends, "verdicts": verdicts, **numbers}
