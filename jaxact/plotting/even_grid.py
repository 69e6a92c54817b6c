"""The samples of a sweep that was refined around its boundary, as an even grid to be drawn."""

from __future__ import annotations

import itertools
import json

import numpy as np
import xarray as xr

from jaxact.parameters import WN, ZETA

# Cells of the grid along an axis, by the number of refined axes.
_CELLS = {1: 1024, 2: 320, 3: 48}


def refined(results: xr.Dataset) -> bool:
    """Whether a sweep was refined around its boundary."""
    return "adaptive" in results.attrs


def resampled(results: xr.Dataset) -> xr.Dataset:
    """An even grid over the refined axes, in which every cell shows the sample nearest to it.

    Args:
        results: of an adaptive sweep, in memory; all along `sample`.

    Returns:
        A dataset with a dimension for every axis of the specification, in its order. Near is meant
        on the axes as they are spaced, each as long as the others.
    """
    said = json.loads(results.attrs["adaptive"])
    axes = json.loads(results.attrs["specification"])["axes"]
    cases, names = said["cases"], said["refined"]
    listed = [_listed(name, axes[name]) for name in cases]
    even = {name: _even(axes[name], _CELLS[len(names)]) for name in names}
    wanted = np.stack(
        np.meshgrid(*(_places(even[name], axes[name]) for name in names), indexing="ij"), axis=-1
    )
    there = np.stack([_places(results[name].values, axes[name]) for name in names], axis=-1)
    chosen = [
        _nearest(there, wanted, _of_case(results, dict(zip(cases, values, strict=True))))
        for values in itertools.product(*listed)
    ]
    shape = [len(values) for values in listed] + [len(values) for values in even.values()]
    picked = np.stack(chosen).reshape(shape)
    dims = (*cases, *names)
    coords = {
        **{name: (name, _plain(values)) for name, values in zip(cases, listed, strict=True)},
        **{name: (name, values) for name, values in even.items()},
    }
    grid = xr.Dataset(
        {
            str(name): (dims, array.values[picked], array.attrs)
            for name, array in results.data_vars.items()
        },
        coords,
        results.attrs,
    )
    for name in grid.coords:
        grid[name].attrs.update(results[name].attrs)
    return _with_servo(grid, results).transpose(*axes)


def of_cases(results: xr.Dataset, part: xr.Dataset) -> xr.Dataset:
    """The samples of an adaptive sweep whose cases are in a part of its even grid."""
    mine = np.ones(results.sizes["sample"], bool)
    for name in json.loads(results.attrs["adaptive"])["cases"]:
        mine &= np.isin(results[name].values, np.atleast_1d(part[name].values))
    return results.isel(sample=mine)


def _listed(name: str, given: list) -> list:
    """Distinct values of a list of a specification, whose JSON has infinity as a string."""
    return list(dict.fromkeys(given if name == "actuator" else map(float, given)))


def _even(axis: dict, cells: int) -> np.ndarray:
    spaced = np.geomspace if axis["spacing"] == "log" else np.linspace
    return spaced(axis["min"], axis["max"], cells)


def _places(values: np.ndarray, axis: dict) -> np.ndarray:
    """Fractions 0..1 of an axis, in its spacing."""
    ends = np.array([axis["min"], axis["max"]])
    if axis["spacing"] == "log":
        values, ends = np.log(values), np.log(ends)
    return (np.asarray(values) - ends[0]) / (ends[1] - ends[0])


def _of_case(results: xr.Dataset, case: dict[str, object]) -> np.ndarray:
    """Numbers of the samples of one case."""
    mine = np.ones(results.sizes["sample"], bool)
    for name, value in case.items():
        mine &= results[name].values == value
    return np.flatnonzero(mine)


def _nearest(there: np.ndarray, wanted: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    from scipy.spatial import cKDTree

    return numbers[cKDTree(there[numbers]).query(wanted)[1]]


def _plain(values: list) -> np.ndarray:
    named = any(isinstance(value, str) for value in values)
    return np.array(values, dtype=object if named else float)


def _with_servo(grid: xr.Dataset, results: xr.Dataset) -> xr.Dataset:
    """The dynamics of the actuators that are cases, as coordinates along them."""
    if "actuator" not in grid.dims:
        return grid
    names = results["actuator"].values
    first = [int(np.flatnonzero(names == name)[0]) for name in grid["actuator"].values]
    servo = {
        name: ("actuator", results[name].values[first], results[name].attrs) for name in (WN, ZETA)
    }
    return grid.assign_coords(servo)
