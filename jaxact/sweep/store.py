"""The result store: an xarray dataset on Zarr v3 that explains itself.

What describes a store (the metadata of every array, the coordinates) is made here as files by their
key, all at once; the results come chunk by chunk, see `jaxact.sweep.progress`.
"""

from __future__ import annotations

import contextlib
import json
import math
import shlex
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact import __version__
from jaxact.errors import UserError
from jaxact.status import Verdict
from jaxact.sweep import place as _place
from jaxact.sweep.layout import Layout
from jaxact.sweep.parameters import of
from jaxact.sweep.place import Place
from jaxact.sweep.samples import Samples
from jaxact.sweep.specification import Specification

if TYPE_CHECKING:
    import xarray as xr

STORE = "sweep.zarr"
ROOT = "zarr.json"
# Beside the results: what says which chunks are done.
PROGRESS = "progress"
RECEIPT = "receipt"
IDENTITY = "identity"
_MARK = "jaxact_version"
# Another version of these may compute other numbers.
_NUMERIC = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "scipy")
_PACKAGES = (*_NUMERIC, "xarray", "zarr")


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
        "m",
        "limit cycle amplitude",
        "Half the peak-to-peak position at the end; 0: no limit cycle.",
    ),
    "limit_cycle_frequency": Variable(
        "rad/s", "limit cycle frequency", "Angular frequency of the oscillation at the end."
    ),
}


def dtype_of(variable: str, precision: str) -> np.dtype[Any]:
    """Type of the numbers that are kept of a variable; precision: "float32" or "float64"."""
    return np.dtype(np.int8 if variable == "verdict" else precision)


def skeleton(
    specification: Specification,
    samples: Samples,
    layout: Layout,
    identity: str,
    attributes: Mapping[str, Any],
) -> dict[str, bytes]:
    """All files of a store but its results, by key.

    specification: what was asked
    samples: all its loops
    layout: how they are cut into chunks
    identity: what a sweep that continues this one must share, JSON
    attributes: of the whole store, from `provenance`

    A receipt is a row of whole numbers: that of the chunk, the loops in a tile, and the checksum of
    the chunk of every variable. A chunk is done when its receipt is there and true.
    """
    import xarray as xr
    import zarr
    from zarr.codecs import BytesCodec, Crc32cCodec
    from zarr.storage import MemoryStore

    files: dict[str, Any] = {}
    memory = MemoryStore(files)
    coords = {
        name: (place.dims, _plain(place.values), dict(place.attributes))
        for name, place in samples.coords.items()
    }
    with warnings.catch_warnings():
        # one metadata file for the whole store, without which xarray warns whenever it is opened
        warnings.filterwarnings("ignore", message="Consolidated metadata is currently not part")
        described = xr.Dataset({}, coords, dict(attributes) | {IDENTITY: identity})
        described.to_zarr(memory, mode="w", zarr_format=3, consolidated=False)
        root = zarr.open_group(memory, mode="a", zarr_format=3, use_consolidated=False)
        checked: dict[str, Any] = {
            "serializer": BytesCodec(endian="little"),
            "compressors": [Crc32cCodec()],
            "filters": None,
            "chunk_key_encoding": {"name": "default", "separator": "."},
        }
        for name in VARIABLES:
            dtype = dtype_of(name, specification.precision)
            root.create_array(
                name,
                shape=layout.shape,
                chunks=layout.chunk,
                dtype=dtype,
                fill_value=math.nan if dtype.kind == "f" else -1,
                dimension_names=samples.dims,
                attributes=_attributes(name),
                **checked,
            )
        progress = root.create_group(PROGRESS, attributes={IDENTITY: identity})
        row = 2 + len(VARIABLES)
        progress.create_array(
            RECEIPT, shape=(len(layout), row), chunks=(1, row), dtype="uint32", fill_value=0,
            dimension_names=("chunk", "entry"), **checked,
        )  # fmt: skip
        zarr.consolidate_metadata(memory, zarr_format=3)
    return {key: bytes(content.to_bytes()) for key, content in files.items()}


def attributes_of(place: Place, key: str = ROOT) -> dict[str, Any] | None:
    """The attributes of a store or of a group in it, None where there is no readable one."""
    try:
        content = place.read(key)
        found = json.loads(content)["attributes"] if content is not None else None
    except (ValueError, KeyError, TypeError):
        return None
    return found if isinstance(found, dict) else None


def is_ours(place: Place) -> bool:
    """Whether a store was made by jaxact."""
    return _MARK in (attributes_of(place) or {}) or identity_of(place) is not None


def identity_of(place: Place) -> dict[str, Any] | None:
    """What a sweep that continues this store must share, kept twice; None where it is lost."""
    for key in (ROOT, f"{PROGRESS}/{ROOT}"):
        try:
            found = json.loads((attributes_of(place, key) or {})[IDENTITY])
        except (KeyError, ValueError, TypeError):
            continue
        if isinstance(found, dict):
            return found
    return None


def _plain(values: np.ndarray) -> np.ndarray:
    # names as objects: Zarr v3 has a type for them, but none for NumPy's strings of fixed length
    return values.astype(object) if values.dtype.kind == "U" else values


def _attributes(name: str) -> dict[str, Any]:
    attributes: dict[str, Any] = dict(vars(VARIABLES[name])) if name in VARIABLES else {}
    if name == "verdict":
        attributes["flag_values"] = [int(kind) for kind in Verdict]
        attributes["flag_meanings"] = " ".join(kind.label.replace(" ", "_") for kind in Verdict)
    return attributes


def provenance(specification: Specification, device: str) -> dict[str, Any]:
    """Attributes of a store: all that is needed to run it again.

    specification: what was asked
    device: what it runs on, in words

    The specification (JSON, TOML and the value of every parameter), versions, seed, command,
    device, time.
    """
    found = {
        "title": specification.description or _title(specification),
        _MARK: __version__,
        "specification": as_json(specification.document),
        "specification_toml": specification.text,
        "parameters": as_json(specification.nominal),
        "seed": specification.seed,
        "versions": as_json({"python": sys.version.split()[0]} | versions()),
        "device": device,
        "command": shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    model = specification.model if specification.plant is None else specification.plant.model
    if model is not None:
        found["model_xml"] = model.read_text(encoding="utf-8", errors="replace")
    return found


def _title(specification: Specification) -> str:
    """What a sweep is of, where nobody has said it."""
    plant = specification.plant
    if plant is None:
        return "sweep of a joint's closed loop"
    posture = "" if plant.keyframe is None else f", keyframe {plant.keyframe}"
    mounted = "" if plant.base == "free" else f", base {plant.base}"
    return f"sweep of {plant.model.name}{posture}{mounted}"


def versions(packages: Sequence[str] = _PACKAGES) -> dict[str, str]:
    """Version of jaxact and of some packages."""
    return {"jaxact": __version__} | {name: version(name) for name in packages}


def numeric_versions(engine: str) -> dict[str, str]:
    """Of what computes an engine's numbers: another version may compute other ones."""
    return versions((*_NUMERIC, "warp-lang") if engine == "warp" else _NUMERIC)


def as_json(value: Any) -> str:
    """JSON text; infinity and not-a-number are the strings "inf" and "nan" there."""

    def finite(item: Any) -> Any:
        if isinstance(item, Mapping):
            return {name: finite(inner) for name, inner in item.items()}
        if isinstance(item, list | tuple):
            return [finite(inner) for inner in item]
        return str(item) if isinstance(item, float) and not math.isfinite(item) else item

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
    # a parameter that is newer than the store has its default
    value = nominal(results).get(name, of(name).default)
    return xr.DataArray(value, name=name, attrs=dict(of(name).attributes))


@contextlib.contextmanager
def readable(where: str | Path) -> Iterator[None]:
    """Raises UserError where a place cannot be read: no permission, no connection."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{where}: cannot be read ({error.strerror or error})") from error


def find(where: str | Path) -> Place:
    """The store that a user means: a results folder with a `sweep.zarr` in it, or the store itself.

    where: path or URL

    Raises UserError if there is none, or it is none of jaxact's.
    """
    given = _place.at(where)
    inner = given.inside(STORE)
    with readable(where):
        for store in (inner, given):
            if is_ours(store):
                return store
        there = inner.entries() or given.entries()
    if there or (isinstance(given, _place.Folder) and given.path.exists()):
        raise UserError(f"{where}: is no result of a sweep; give a folder that holds a {STORE}")
    raise UserError(f"{where}: no such result; give the results folder of a sweep, or its {STORE}")


def open_result(where: str | Path, *, unfinished: bool = False) -> xr.Dataset:
    """The results of a sweep, read lazily.

    where: results folder with a `sweep.zarr` in it, or the store itself; path or URL
    unfinished: also of a sweep that has not come to its end; what is missing is NaN, verdict -1

    Raises UserError if there is none, it is none of jaxact's, it is damaged, or it is unfinished.
    """
    store = find(where)
    results = opened(store)
    if not results.attrs.get("complete", False) and not unfinished:
        raise UserError(
            f"{store.name}: the sweep has not come to its end; continue it with"
            " `jaxact sweep ... --resume`, `jaxact status` shows how far it is"
        )
    return results


def opened(store: Place) -> xr.Dataset:
    """The dataset in a place, read lazily; raises UserError if it is damaged."""
    import xarray as xr

    try:
        results: xr.Dataset = xr.open_zarr(store.zarr(), zarr_format=3)
        json.loads(results.attrs["parameters"])
    except (OSError, ValueError, KeyError) as error:
        raise UserError(
            f"{store.name}: cannot be read ({error}); `jaxact validate` says what is damaged, and"
            " `jaxact sweep ... --resume` mends it"
        ) from error
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
    encoded = loaded(results).assign_attrs({k: _netcdf(v) for k, v in results.attrs.items()})
    try:
        with tempfile.TemporaryDirectory(prefix=".jaxact-", dir=path.parent) as scratch:
            partial = Path(scratch) / path.name
            encoded.to_netcdf(partial, engine="h5netcdf")
            partial.replace(path)
    except OSError as error:
        raise UserError(unwritable(path, error)) from error


def _netcdf(value: Any) -> Any:
    return int(value) if isinstance(value, bool) else value


def unwritable(where: str | Path, error: OSError) -> str:
    """What to say of a place that cannot be written."""
    return f"{where}: cannot be written ({error.strerror or error}); give another place with --out"
