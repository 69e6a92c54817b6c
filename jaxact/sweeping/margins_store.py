"""Exact margins of the loops of a specification, as a dataset that can be drawn like a sweep's.

A dimension for each axis, as in a sweep's store; growth rate and verdict are the exact ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.sweeping import store
from jaxact.sweeping.variables import KIND, VARIABLES

if TYPE_CHECKING:
    import xarray as xr

CONTINUOUS = "continuous time"

_STABLE, _UNSTABLE = 0, 2


def dataset(
    specification: Specification,
    samples: Samples,
    metrics: Mapping[str, tuple[np.ndarray, str]],
    *,
    kind: str,
    growth_rate: np.ndarray,
    stable: np.ndarray,
) -> xr.Dataset:
    """Margins of all loops of a specification, over its axes.

    Args:
        specification: of the loops.
        samples: them, from `jaxact.loops.samples.expand`.
        metrics: by name, values of shape (n,) and their unit.
        kind: CONTINUOUS or SAMPLED, what the next two are of.
        growth_rate: real part of the rightmost root, or log(spectral radius) / T [1/s], shape (n,).
        stable: shape (n,).
    """
    import xarray as xr

    def shaped(values: np.ndarray) -> np.ndarray:
        return np.asarray(values).reshape(samples.shape)

    verdict = np.where(stable, _STABLE, _UNSTABLE).astype(np.int8)
    arrays = {
        "growth_rate": (
            samples.dims,
            shaped(growth_rate),
            dict(vars(VARIABLES["growth_rate"])),
        ),
        "verdict": (samples.dims, shaped(verdict), dict(vars(VARIABLES["verdict"]))),
    } | {
        name: (samples.dims, shaped(values), {"units": units})
        for name, (values, units) in metrics.items()
    }
    coords = {
        name: (place.dims, np.asarray(place.values, object) if place.values.dtype.kind == "U"
               else place.values, dict(place.attributes))
        for name, place in samples.coords.items()
    }  # fmt: skip
    attributes = store.provenance(specification, "none: exact theory")
    if not specification.description:
        attributes["title"] = "margins of a joint's closed loop"
    return xr.Dataset(arrays, coords, attributes | {KIND: kind, "complete": True})
