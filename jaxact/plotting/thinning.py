"""Maps of more loops along an axis than a picture has points, on every n-th of them."""

from __future__ import annotations

import xarray as xr

from jaxact.plotting.panels import SAMPLE

MOST = 2000
"""Values of an axis that are drawn at most."""


def thinned(maps: xr.Dataset) -> xr.Dataset:
    """A sweep with at most `MOST` values along each of its axes; drawn samples are all kept."""
    kept = {dim: slice(None, None, stride) for dim, stride in _strides(maps).items()}
    return maps.isel(kept) if kept else maps


def left_out(maps: xr.Dataset) -> str:
    """What `thinned` leaves out, in a sentence; "" where that is nothing."""
    parts = [f"1 in {stride} values of {dim}" for dim, stride in _strides(maps).items()]
    return f"Drawn: {', '.join(parts)}." if parts else ""


def _strides(maps: xr.Dataset) -> dict[str, int]:
    sizes = {str(dim): size for dim, size in maps.sizes.items() if dim != SAMPLE}
    return {dim: -(-size // MOST) for dim, size in sizes.items() if size > MOST}
