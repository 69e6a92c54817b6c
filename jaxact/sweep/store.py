"""The result store: an xarray dataset on Zarr v3 that explains itself, written whole or not."""

from __future__ import annotations

import contextlib
import json
import math
import os
import shlex
import shutil
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact import __version__
from jaxact.errors import UserError
from jaxact.status import Verdict
from jaxact.sweep.parameters import PARAMETERS
from jaxact.sweep.samples import Samples
from jaxact.sweep.specification import Specification

if TYPE_CHECKING:
    import xarray as xr

STORE = "sweep.zarr"
_MARK = "jaxact_version"
_PACKAGES = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "scipy", "xarray", "zarr")


@dataclass(frozen=True)
class Variable:
    """A result of every loop: its SI unit, its name in words, one sentence."""

    units: str
    long_name: str
    description: str


VARIABLES: dict[str, Variable] = {
    "growth_rate": Variable(
        "1/s", "growth rate", "Exponential rate of a small perturbation; negative: stable."
    ),
    "verdict": Variable("1", "verdict", "What the loop did, see flag_meanings."),
    "overshoot": Variable(
        "1", "overshoot", "Largest excess over the setpoint, relative to the step's height."
    ),
    "rise_time": Variable("s", "rise time", "From 10 % to 90 % of the step."),
    "settling_time": Variable("s", "settling time", "Last time outside 2 % of the step."),
    "integrated_absolute_error": Variable(
        "m s", "integrated absolute error", "Integral of |setpoint - position|."
    ),
    "integrated_squared_error": Variable(
        "m^2 s", "integrated squared error", "Integral of (setpoint - position)^2."
    ),
    "control_effort": Variable("N^2 s", "control effort", "Integral of the squared command."),
    "peak_force": Variable("N", "peak force", "Largest magnitude of the force."),
    "rms_force": Variable("N", "rms force", "Root mean square of the force."),
    "limit_cycle_amplitude": Variable(
        "m", "limit cycle amplitude", "Half the peak-to-peak position at the end."
    ),
    "limit_cycle_frequency": Variable(
        "rad/s", "limit cycle frequency", "Angular frequency of the oscillation at the end."
    ),
}


def dataset(
    specification: Specification, samples: Samples, results: Mapping[str, np.ndarray]
) -> xr.Dataset:
    """The results of a sweep with named dimensions, coordinates, units and provenance.

    specification: what was asked
    samples: all its loops
    results: of every loop in their order, by name, each of shape (n,)

    The attributes hold all that is needed to run it again: the specification (JSON, TOML and the
    value of every parameter), versions, seed, command, device, time.
    """
    import xarray as xr

    arrays = {
        name: (
            samples.dims,
            _stored(name, values, specification).reshape(samples.shape),
            attributes,
        )
        for name, values in results.items()
        for attributes in (_attributes(name),)
    }
    coords = {
        name: (place.dims, _plain(place.values), dict(place.attributes))
        for name, place in samples.coords.items()
    }
    return xr.Dataset(arrays, coords, _provenance(specification))


def _stored(name: str, values: np.ndarray, specification: Specification) -> np.ndarray:
    return np.asarray(values, dtype=np.int8 if name == "verdict" else specification.precision)


def _plain(values: np.ndarray) -> np.ndarray:
    # names as objects: Zarr v3 has a type for them, but none for NumPy's strings of fixed length
    return values.astype(object) if values.dtype.kind == "U" else values


def _attributes(name: str) -> dict[str, Any]:
    attributes: dict[str, Any] = dict(vars(VARIABLES[name])) if name in VARIABLES else {}
    if name == "verdict":
        attributes["flag_values"] = np.array([int(kind) for kind in Verdict], dtype=np.int8)
        attributes["flag_meanings"] = " ".join(kind.label.replace(" ", "_") for kind in Verdict)
    return attributes


def _provenance(specification: Specification) -> dict[str, Any]:
    import jax

    versions = {name: version(name) for name in _PACKAGES}
    device = jax.devices()[0]
    found = {
        "title": specification.description or "sweep of a joint's closed loop",
        _MARK: __version__,
        "specification": _json(specification.document),
        "specification_toml": specification.text,
        "parameters": _json(specification.nominal),
        "seed": specification.seed,
        "versions": _json({"jaxact": __version__, "python": sys.version.split()[0]} | versions),
        "device": f"{jax.local_device_count()} x {device.platform} ({device.device_kind})",
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    if specification.model is not None:
        found["model_xml"] = specification.model.read_text(encoding="utf-8", errors="replace")
    return found


def _json(value: Any) -> str:
    """JSON text in which an infinite number is the string "inf", which JSON has no number for."""

    def finite(item: Any) -> Any:
        if isinstance(item, Mapping):
            return {name: finite(inner) for name, inner in item.items()}
        if isinstance(item, list | tuple):
            return [finite(inner) for inner in item]
        return str(item) if isinstance(item, float) and math.isinf(item) else item

    return json.dumps(finite(value), allow_nan=False)


def nominal(results: xr.Dataset) -> dict[str, float]:
    """Value of every parameter of the table where no axis varies it."""
    given = json.loads(results.attrs["parameters"])
    return {name: float(value) for name, value in given.items()}


def parameter(results: xr.Dataset, name: str) -> xr.DataArray:
    """A parameter over the sweep: its coordinate where it varies, else a single value."""
    import xarray as xr

    if name in results.coords:
        return results.coords[name]
    return xr.DataArray(nominal(results)[name], name=name, attrs=dict(PARAMETERS[name].attributes))


@contextlib.contextmanager
def destination(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """A new folder to write into, which takes the place of `path` once the block is done.

    path: of the store
    overwrite: replace a jaxact store that is there already; nothing else is ever replaced

    The folder lies beside `path`, so that a forbidden place is found before the work.
    Whatever ends the block with an exception leaves `path` as it was, and nothing else behind.

    Raises UserError if `path` exists and may not be replaced, or cannot be written.
    """
    _refuse_existing(path, overwrite)
    made = _make_folders(path.parent)
    partial: Path | None = None
    try:
        partial = Path(
            tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".partial", dir=path.parent)
        )
        yield partial
        _replace(partial, path, overwrite)
    except BaseException as error:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()
        if isinstance(error, OSError):
            raise UserError(_unwritable(path, error)) from error
        raise


def write(results: xr.Dataset, folder: Path) -> None:
    """Write a dataset as a Zarr v3 store into an empty folder."""
    with warnings.catch_warnings():
        # one metadata file for the whole store, without which xarray warns whenever it is opened
        warnings.filterwarnings("ignore", message="Consolidated metadata is currently not part")
        results.to_zarr(folder, mode="w", zarr_format=3, consolidated=True)


def open_result(path: Path) -> xr.Dataset:
    """The results of a sweep, read lazily.

    path: results folder with a `sweep.zarr` in it, or the store itself

    Raises UserError if there is none, it is none of jaxact's, or it is damaged.
    """
    import xarray as xr

    store = path / STORE if (path / STORE).is_dir() else path
    if not store.exists():
        raise UserError(
            f"{path}: no such result; give the results folder of a sweep, or its {STORE}"
        )
    if not _is_ours(store):
        raise UserError(f"{path}: is no result of a sweep; give a folder that holds a {STORE}")
    try:
        results: xr.Dataset = xr.open_zarr(store)
        json.loads(results.attrs["parameters"])
    except (OSError, ValueError, KeyError) as error:
        raise UserError(f"{store}: cannot be read ({error}); run the sweep again") from error
    return results


def to_netcdf(results: xr.Dataset, path: Path, *, overwrite: bool = False) -> None:
    """Write the results as one NetCDF-4 file, whole or not at all.

    results: of a sweep
    path: of the file
    overwrite: replace a file that is there

    Raises UserError if the file exists and may not be replaced, or cannot be written.
    """
    if path.is_dir():
        raise UserError(f"{path}: is a folder; name a file in it")
    if path.exists() and not overwrite:
        raise UserError(f"{path}: exists; give another name, or --overwrite to replace it")
    if not path.parent.is_dir():
        raise UserError(f"{path}: the folder {path.parent} does not exist; create it first")
    encoded = results.load().assign_attrs({k: _netcdf(v) for k, v in results.attrs.items()})
    try:
        with tempfile.TemporaryDirectory(prefix=".jaxact-", dir=path.parent) as scratch:
            partial = Path(scratch) / path.name
            encoded.to_netcdf(partial, engine="h5netcdf")
            partial.replace(path)
    except OSError as error:
        raise UserError(_unwritable(path, error)) from error


def _netcdf(value: Any) -> Any:
    return int(value) if isinstance(value, bool) else value


def _is_ours(store: Path) -> bool:
    try:
        metadata = json.loads((store / "zarr.json").read_text(encoding="utf-8"))
        return _MARK in metadata["attributes"]
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _refuse_existing(path: Path, overwrite: bool) -> None:
    if not os.path.lexists(path):
        return
    if not _is_ours(path) or path.is_symlink():
        raise UserError(
            f"{path}: exists and is no result of a sweep, so it stays; give another --out"
        )
    if not overwrite:
        raise UserError(f"{path}: exists; give another --out, or --overwrite to replace it")


def _make_folders(folder: Path) -> list[Path]:
    """Make the folder and its parents; returns those that were not there, innermost first."""
    missing = []
    for step in (folder, *folder.parents):
        if os.path.exists(step):
            break
        missing.append(step)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        for step in missing:
            with contextlib.suppress(OSError):
                step.rmdir()
        raise UserError(_unwritable(folder, error)) from error
    return missing


def _replace(partial: Path, path: Path, overwrite: bool) -> None:
    """Put the finished folder in its place; what was there is gone only after that."""
    partial.chmod(0o777 & ~_umask())
    if not (overwrite and path.exists()):
        partial.rename(path)
        return
    old = path.with_name(f"{partial.name}.old")
    path.rename(old)
    partial.rename(path)
    shutil.rmtree(old)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def _unwritable(path: Path, error: OSError) -> str:
    return f"{path}: cannot be written ({error.strerror or error}); give another place with --out"
