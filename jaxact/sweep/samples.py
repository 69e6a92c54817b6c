"""The samples of a sweep: every parameter of every loop, and how they lie on the axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxact.sweep.axes import Axis
from jaxact.sweep.parameters import PARAMETERS, PRESETS
from jaxact.sweep.specification import Sampling, Specification

SAMPLE = "sample"
_ACTUATOR = {"long_name": "actuator", "description": "Actuator preset, which sets wn and zeta."}
_NUMBER = {"long_name": "sample", "units": "1", "description": "Number of the sample drawn."}


@dataclass(frozen=True)
class Coordinate:
    """Values along some of the dimensions.

    dims: names of the dimensions
    values: shape of those dimensions; numbers, or names of actuator presets
    attributes: unit and name in words
    """

    dims: tuple[str, ...]
    values: np.ndarray
    attributes: dict[str, str]


@dataclass(frozen=True)
class Samples:
    """All loops of a sweep; n of them in C order of the dimensions.

    values: every parameter of the table by its short name, each of shape (n,), float64, read-only
    dims: names of the dimensions, in order
    shape: their sizes
    coords: of the varied parameters by name
    """

    values: dict[str, np.ndarray]
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    coords: dict[str, Coordinate]

    def __len__(self) -> int:
        """Number of loops."""
        return int(np.prod(self.shape, dtype=np.int64))


def expand(specification: Specification) -> Samples:
    """All loops of a checked specification.

    Listed and gridded axes are dimensions in the order of the file. Sampled ranges share one last
    dimension, `sample`, and the same points are drawn for every combination of the other axes.
    A parameter that does not vary takes no memory (its array has stride 0).
    """
    axes = specification.axes
    gridded = [axis for axis in axes if not axis.sampled]
    dims = tuple(axis.name for axis in gridded)
    shape = tuple(len(axis) for axis in gridded)
    coords = {name: place for axis in gridded for name, place in _along(axis).items()}
    if specification.sampling is not None:
        dims, shape = (*dims, SAMPLE), (*shape, specification.sampling.samples)
        ranges = [axis for axis in axes if axis.sampled]
        coords |= _drawn(ranges, specification.sampling, specification.seed)
    number = int(np.prod(shape, dtype=np.int64))
    values = {
        name: _fill(coords[name], dims, shape)
        if name in coords
        else np.broadcast_to(np.float64(value), (number,))
        for name, value in specification.nominal.items()
    }
    return Samples(values, dims, shape, coords)


def _along(axis: Axis) -> dict[str, Coordinate]:
    """Coordinates that one listed or gridded axis makes."""
    dims = (axis.name,)
    if axis.name != "actuator":
        return {axis.name: Coordinate(dims, axis.values, PARAMETERS[axis.name].attributes)}
    wn, zeta = np.array([PRESETS[str(name)] for name in axis.values]).T
    return {
        "actuator": Coordinate(dims, axis.values, _ACTUATOR),
        "wn": Coordinate(dims, wn, PARAMETERS["wn"].attributes),
        "zeta": Coordinate(dims, zeta, PARAMETERS["zeta"].attributes),
    }


def _drawn(ranges: list[Axis], sampling: Sampling, seed: int) -> dict[str, Coordinate]:
    """Coordinates of the sampled ranges, all along the dimension `sample`."""
    points = _points(len(ranges), sampling, seed)
    numbers = np.arange(sampling.samples)
    return {SAMPLE: Coordinate((SAMPLE,), numbers, _NUMBER)} | {
        axis.name: Coordinate(
            (SAMPLE,), axis.place(points[:, column]), PARAMETERS[axis.name].attributes
        )
        for column, axis in enumerate(ranges)
    }


def _points(dimensions: int, sampling: Sampling, seed: int) -> np.ndarray:
    """Points in the unit cube, shape (samples, dimensions)."""
    from scipy.stats import qmc  # slow to import

    if sampling.method == "latin-hypercube":
        return np.asarray(qmc.LatinHypercube(dimensions, rng=seed).random(sampling.samples))
    # a whole power of two, for which alone SciPy does not warn; its first points are kept
    power = max(sampling.samples - 1, 0).bit_length()
    points = qmc.Sobol(dimensions, scramble=True, rng=seed).random_base2(power)
    return np.asarray(points[: sampling.samples])


def _fill(coordinate: Coordinate, dims: tuple[str, ...], shape: tuple[int, ...]) -> np.ndarray:
    """A coordinate at every sample, shape (n,)."""
    sizes: list[Any] = [
        size if dim in coordinate.dims else 1 for dim, size in zip(dims, shape, strict=True)
    ]
    spread = np.broadcast_to(coordinate.values.reshape(sizes), shape)
    return np.ascontiguousarray(spread, dtype=np.float64).reshape(-1)
