"""Opening the results of a sweep: found, held against their checksums, read, exported."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact import files
from jaxact.errors import UserError
from jaxact.sweeping import checksums, integrity
from jaxact.sweeping import location as _location
from jaxact.sweeping.location import Location
from jaxact.sweeping.progress import Finding, Store
from jaxact.sweeping.store import STORE, is_ours, unwritable

if TYPE_CHECKING:
    import xarray as xr


@contextlib.contextmanager
def readable(where: str | Path) -> Iterator[None]:
    """A context in which a place is read.

    Raises:
        UserError: it cannot be read: no permission, no connection.
    """
    try:
        yield
    except BrokenPipeError:  # who reads our output has gone; the place is none of it
        raise
    except OSError as error:
        raise UserError(f"{where}: cannot be read ({error.strerror or error})") from error


def find(where: str | Path) -> Location:
    """The store that a user means: a results folder with a `sweep.zarr` in it, or the store itself.

    Args:
        where: path or URL.

    Raises:
        UserError: there is none, or it is none of jaxact's.
    """
    given = _location.at(where)
    inner = given.inside(STORE)
    with readable(where):
        for store in (inner, given):
            if is_ours(store):
                return store
        there = inner.entries() or given.entries()
    if there or (isinstance(given, _location.Folder) and given.path.exists()):
        raise UserError(f"{where}: is not a result of a sweep; give a folder that holds a {STORE}")
    raise UserError(f"{where}: no such result; give the results folder of a sweep, or its {STORE}")


def open_result(where: str | Path, *, unfinished: bool = False) -> xr.Dataset:
    """The results of a sweep, read lazily.

    Metadata and coordinates are held against their checksums, the results by names and sizes of
    their files, and by their own checksums when they are read.

    Args:
        where: results folder with a `sweep.zarr` in it, or the store itself; path or URL.
        unfinished: also of a sweep that has not come to its end; what is missing is NaN, verdict
            -1.

    Raises:
        UserError: there is none, it is none of jaxact's, it is damaged, or it is unfinished.
    """
    store = find(where)
    with readable(where):
        entries = store.entries()
        integrity.demand(store, lambda there, number: there.glance(number, entries))
        return _finished(store, unfinished=unfinished)


def load_result(where: str | Path, variables: Collection[str] | None = None) -> xr.Dataset:
    """The results of a sweep in memory, each of their files held against its checksum.

    Args:
        where: as for `open_result`.
        variables: kept in memory; the others are read again when they are asked for. None for all,
            of which a store without chunks is too small for a choice.

    Raises:
        UserError: as `open_result`.
    """
    store = find(where)
    read: dict[int, dict[str, np.ndarray]] = {}

    def look(there: Store, number: int) -> Finding:
        finding, rows = there.attempt(number)
        kept = rows if variables is None else rows.keys() & set(variables)
        read[number] = {name: rows[name] for name in kept}
        return finding

    with readable(where):
        found = integrity.demand(store, look)
        results = _finished(store)
        there = integrity.chunked(store, found)
        return loaded(results) if there is None else _filled(results, there, read)


def _filled(
    results: xr.Dataset, store: Store, read: dict[int, dict[str, np.ndarray]]
) -> xr.Dataset:
    """The results with the numbers of all chunks, which are let go of."""
    size = int(np.prod(store.layout.shape, dtype=np.int64))
    names = [name for name in store.variables if name in results and name in read[min(read)]]
    whole = {name: np.empty(size, store.dtype(name)) for name in names}
    for number in sorted(read):
        first, count = store.layout.span(number)
        part = read.pop(number)
        for name, values in whole.items():
            values[first : first + count] = part[name]
    arrays = {
        name: results[name].copy(data=values.reshape(store.layout.shape))
        for name, values in whole.items()
    }
    results = results.assign(arrays)
    return loaded(results) if len(names) == len(results.data_vars) else results


def _finished(store: Location, *, unfinished: bool = False) -> xr.Dataset:
    results = opened(store)
    if not results.attrs.get("complete", False) and not unfinished:
        raise UserError(
            f"{store.name}: the sweep has not come to its end; continue it with"
            " `jaxact sweep ... --resume`, `jaxact status` shows how far it is"
        )
    return results


def opened(store: Location) -> xr.Dataset:
    """The dataset in a place, read lazily; raises UserError if it cannot be read."""
    import xarray as xr

    try:
        results: xr.Dataset = xr.open_zarr(store.zarr(), zarr_format=3)
        if "parameters" not in results.attrs:
            raise UserError(
                f"{store.name}: is a list of loops without axes; give the result of `jaxact sweep`,"
                " or of `jaxact margins --loops SPECIFICATION --store`"
            )
        json.loads(results.attrs["parameters"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UserError(
            f"{store.name}: cannot be read ({error}); `jaxact validate` says what is damaged, and"
            " `jaxact sweep ... --resume` mends it"
        ) from error
    results.attrs = checksums.plain(results.attrs)
    return results


def loaded(results: xr.Dataset) -> xr.Dataset:
    """The results with all numbers read into memory; raises UserError if a chunk is damaged."""
    try:
        return results.load()
    except (OSError, ValueError) as error:
        raise UserError(
            f"a chunk of the results cannot be read ({error}); `jaxact validate` says which, and"
            " `jaxact sweep ... --resume` computes it anew"
        ) from error


def to_netcdf(results: xr.Dataset, path: Path, *, overwrite: bool = False) -> None:
    """Write the results as one NetCDF-4 file, whole or not at all.

    Args:
        results: of a sweep.
        path: of the file.
        overwrite: replace a file that is there.

    Raises:
        UserError: the file exists and may not be replaced, or cannot be written.
    """
    files.check_output(path, overwrite=overwrite)
    encoded = loaded(results).assign_attrs({k: _netcdf(v) for k, v in results.attrs.items()})
    try:
        with files.replacing(path) as partial:
            encoded.to_netcdf(partial, engine="h5netcdf")
    except OSError as error:
        raise UserError(unwritable(path, error)) from error


def _netcdf(value: Any) -> Any:
    return int(value) if isinstance(value, bool) else value
