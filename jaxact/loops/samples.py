"""The samples of a sweep: every parameter of every loop, and how they lie on the axes."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxact.loops.axes import Axis
from jaxact.loops.specification import Sampling, Specification
from jaxact.parameters import PARAMETERS, PRESETS, WN, ZETA, of

SAMPLE = "sample"
_ACTUATOR = {"long_name": "actuator", "description": "Actuator preset, which sets wn and zeta."}
_NUMBER = {"long_name": "sample", "units": "1", "description": "Number of the sample drawn."}


@dataclass(frozen=True)
class Coordinate:
    """Values along some of the dimensions.

    Attributes:
        dims: names of the dimensions.
        values: shape of those dimensions; numbers, or names of actuator presets.
        attributes: unit and name in words.
    """

    dims: tuple[str, ...]
    values: np.ndarray
    attributes: dict[str, str]


@dataclass(frozen=True)
class Samples:
    """All loops of a sweep; n of them in C order of the dimensions.

    Only the values along each dimension are kept, so that a hundred million loops take no memory.

    Attributes:
        along: every parameter of the table by its short name, float64, of a shape that broadcasts
            to `shape`.
        dims: names of the dimensions, in order.
        shape: their sizes.
        coords: of the varied parameters by name.
        first: number of the first loop, from which its random numbers follow.
    """

    along: dict[str, np.ndarray]
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    coords: dict[str, Coordinate]
    first: int = 0

    @functools.cached_property
    def values(self) -> dict[str, np.ndarray]:
        """Every parameter of every loop by its short name, each of shape (n,): for a few loops."""
        return {
            name: np.broadcast_to(array, self.shape).reshape(-1)
            for name, array in self.along.items()
        }

    def take(
        self, numbers: np.ndarray, names: Iterable[str] | None = None
    ) -> dict[str, np.ndarray]:
        """Parameters of some loops by their short names, each of the shape of `numbers`.

        Args:
            numbers: of the loops, integers from 0 to n - 1.
            names: of the parameters; None: all.
        """
        places = np.unravel_index(numbers, self.shape)

        def at(array: np.ndarray) -> np.ndarray:
            varied = tuple(p for p, size in zip(places, array.shape, strict=True) if size > 1)
            flat = array.reshape([size for size in array.shape if size > 1])
            return flat[varied] if varied else np.broadcast_to(flat, np.shape(numbers))

        names = self.along if names is None else names
        return {name: at(self.along[name]) for name in names}

    def __len__(self) -> int:
        """Number of loops."""
        return int(np.prod(self.shape, dtype=np.int64))


def expand(specification: Specification) -> Samples:
    """All loops of a checked specification.

    Listed and gridded axes are dimensions in the order of the file. Sampled ranges share one last
    dimension, `sample`, and the same points are drawn for every combination of the other axes.
    """
    axes = specification.axes
    gridded = [axis for axis in axes if not axis.sampled]
    dims = tuple(axis.name for axis in gridded)
    shape = tuple(len(axis) for axis in gridded)
    coords: dict[str, Coordinate] = {}
    for axis in gridded:
        coords |= _along((axis.name,), axis.name, axis.values, specification.unit)
    if specification.sampling is not None:
        dims, shape = (*dims, SAMPLE), (*shape, specification.sampling.samples)
        ranges = [axis for axis in axes if axis.sampled]
        coords |= _drawn(ranges, specification)
    along = {
        name: _placed(coords[name], dims, shape)
        if name in coords
        else np.full((1,) * len(dims), value, float)
        for name, value in specification.nominal.items()
    }
    return Samples(along, dims, shape, coords)


def ends(specification: Specification) -> dict[str, np.ndarray]:
    """Smallest and largest value of every parameter by key, without drawing any sample.

    Of `actuator` nothing: wn and zeta are its fixed ones.
    """
    values = {name: np.array([value]) for name, value in specification.nominal.items()}
    varied = (axis for axis in specification.axes if axis.name != "actuator")
    return values | {axis.name: np.array(axis.ends) for axis in varied}


def explicit(
    specification: Specification, columns: dict[str, np.ndarray], *, first: int = 0
) -> Samples:
    """Loops that are given one by one, along the dimension `sample`.

    Args:
        specification: checked; the value of every parameter that is not given.
        columns: values of each varied parameter, or names of presets of `actuator`; shape (n,)
            each.
        first: number of the first loop.
    """
    number = len(next(iter(columns.values())))
    coords = {SAMPLE: Coordinate((SAMPLE,), np.arange(first, first + number), _NUMBER)}
    for name, values in columns.items():
        coords |= _along((SAMPLE,), name, values, specification.unit)
    along = {
        name: np.asarray(coords[name].values, float) if name in coords else np.full(1, value, float)
        for name, value in specification.nominal.items()
    }
    return Samples(along, (SAMPLE,), (number,), coords, first)


def _along(
    dims: tuple[str, ...], name: str, values: np.ndarray, unit: str | None
) -> dict[str, Coordinate]:
    """Coordinates that the values of one parameter make."""
    if name != "actuator":
        return {name: Coordinate(dims, values, of(name, unit).attributes)}
    wn, zeta = np.array([PRESETS[str(name)] for name in values]).T
    return {
        "actuator": Coordinate(dims, values, _ACTUATOR),
        WN: Coordinate(dims, wn, PARAMETERS[WN].attributes),
        ZETA: Coordinate(dims, zeta, PARAMETERS[ZETA].attributes),
    }


def _drawn(ranges: list[Axis], specification: Specification) -> dict[str, Coordinate]:
    """Coordinates of the sampled ranges, all along the dimension `sample`."""
    sampling, unit = specification.sampling, specification.unit
    assert sampling is not None
    points = _points(len(ranges), sampling, specification.seed)
    found = {SAMPLE: Coordinate((SAMPLE,), np.arange(sampling.samples), _NUMBER)}
    for axis, column in zip(ranges, points.T, strict=True):
        about = of(axis.name, unit).attributes
        found[axis.name] = Coordinate((SAMPLE,), axis.place(column), about)
    return found


def _points(dimensions: int, sampling: Sampling, seed: int) -> np.ndarray:
    """Points in the unit cube, shape (samples, dimensions)."""
    from scipy.stats import qmc  # slow to import

    if sampling.method == "latin-hypercube":
        return np.asarray(qmc.LatinHypercube(dimensions, rng=seed).random(sampling.samples))
    # a whole power of two, for which alone SciPy does not warn; its first points are kept
    power = max(sampling.samples - 1, 0).bit_length()
    points = qmc.Sobol(dimensions, scramble=True, rng=seed).random_base2(power)
    return np.asarray(points[: sampling.samples])


def _placed(coordinate: Coordinate, dims: tuple[str, ...], shape: tuple[int, ...]) -> np.ndarray:
    """A coordinate with a size of 1 along the dimensions that it does not depend on."""
    sizes: list[Any] = [
        size if dim in coordinate.dims else 1 for dim, size in zip(dims, shape, strict=True)
    ]
    return np.asarray(coordinate.values, dtype=np.float64).reshape(sizes)
