"""The result store: an xarray dataset on Zarr v3 that explains itself.

What describes a store (the metadata of every array, the coordinates) is made here as files by their
key, all at once; the results come chunk by chunk, see `jaxact.sweeping.progress`.
"""

from __future__ import annotations

import json
import math
import shlex
import sys
import warnings
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact import __version__, engines
from jaxact.loops.joint_units import with_units
from jaxact.loops.samples import Samples
from jaxact.loops.specification import Specification
from jaxact.parameters import of
from jaxact.status import Verdict
from jaxact.sweeping import checksums
from jaxact.sweeping.checksums import ChecksumState
from jaxact.sweeping.layout import Layout
from jaxact.sweeping.location import Location
from jaxact.sweeping.variables import (
    KIND,
    MARGINS,
    SAMPLED,
    VARIABLES,
    dtype_of,
    of_margins,
    variables_of,
)
from jaxact.units import in_unit

if TYPE_CHECKING:
    import xarray as xr

STORE = "sweep.zarr"
ROOT = "zarr.json"
# Beside the results: what says which chunks are done.
PROGRESS = "progress"
RECEIPT = "receipt"
IDENTITY = "identity"
# Where the identity is kept a second time.
SECOND = f"{PROGRESS}/{ROOT}"
_MARK = "jaxact_version"
# Another version of these may compute other numbers.
_NUMERIC = ("jax", "jaxlib", "mujoco", "mujoco-mjx", "numpy", "scipy")
_PACKAGES = (*_NUMERIC, "xarray", "zarr")


def skeleton(
    specification: Specification,
    samples: Samples,
    layout: Layout,
    identity: str,
    attributes: Mapping[str, Any],
) -> dict[str, bytes]:
    """All files of a store but its results, by key.

    A receipt is a row of whole numbers: that of the chunk, the loops in a tile, and the checksum of
    the chunk of every variable. A chunk is done when its receipt is there and true.

    Args:
        specification: what was asked.
        samples: all its loops.
        layout: how they are cut into chunks.
        identity: what a sweep that continues this one must share, JSON.
        attributes: of the whole store, from `provenance`.
    """
    import xarray as xr
    import zarr
    from zarr.codecs import BytesCodec, Crc32cCodec
    from zarr.storage import MemoryStore

    files: dict[str, Any] = {}
    memory = MemoryStore(files)
    coords = {
        name: (place.dims, _plain(place.values), dict(place.attributes))
        for name, place in with_units(samples.coords, specification.plant).items()
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
        names = variables_of(specification)
        for name in names:
            dtype = dtype_of(name, specification.precision)
            root.create_array(
                name,
                shape=layout.shape,
                chunks=layout.chunk,
                dtype=dtype,
                fill_value=math.nan if dtype.kind == "f" else -1,
                dimension_names=samples.dims,
                attributes=_attributes(name, specification.unit),
                **checked,
            )
        progress = root.create_group(PROGRESS, attributes={IDENTITY: identity})
        row = 2 + len(names)
        progress.create_array(
            RECEIPT, shape=(len(layout), row), chunks=(1, row), dtype="uint32", fill_value=0,
            dimension_names=("chunk", "entry"), **checked,
        )  # fmt: skip
        zarr.consolidate_metadata(memory, zarr_format=3)
    written = {key: bytes(content.to_bytes()) for key, content in files.items()}
    return described_by_root(written)


def described_by_root(files: Mapping[str, bytes]) -> dict[str, bytes]:
    """Files of a store with the checksums of all in its root; see `jaxact.sweeping.checksums`."""
    rest = {key: content for key, content in files.items() if key != ROOT}
    if SECOND in rest:
        rest[SECOND] = checksums.sealed(json.loads(rest[SECOND]))
    root = json.loads(files[ROOT])
    root["attributes"] |= {checksums.CHECKSUMS: checksums.digests(rest)}
    return rest | {ROOT: checksums.sealed(root)}


def attributes_of(location: Location, key: str = ROOT) -> dict[str, Any] | None:
    """The attributes of a store or of a group in it, None where they are lost or damaged."""
    content = location.read(key)
    if content is None or checksum_state(location, key, content) is ChecksumState.BROKEN:
        return None
    try:
        found = json.loads(content)["attributes"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    return checksums.plain(found) if isinstance(found, dict) else None


def checksum_state(location: Location, key: str, content: bytes) -> ChecksumState:
    """Whether a metadata file of a store is as it was written.

    A root without a checksum is an older store's; or it has lost it, where the other has one.
    """
    found = checksums.state(content)
    if found is ChecksumState.NONE and key == ROOT:
        second = location.read(SECOND)
        if second is not None and checksums.state(second) is not ChecksumState.NONE:
            return ChecksumState.BROKEN
    return found


def beginning(location: Location) -> dict[str, Any]:
    """What a store says of its beginning, as far as it is true."""
    found = attributes_of(location)
    if found is None:
        return dict(checksums.beginning(location.read(ROOT) or b""))
    ours = ("complete", "summary", "coordinates", "adaptive", IDENTITY)
    return {key: value for key, value in found.items() if key not in ours}


def is_ours(location: Location) -> bool:
    """Whether a store was made by jaxact, damaged ones included."""
    return _MARK.encode() in (location.read(ROOT) or b"") or identity_of(location) is not None


def identity_of(location: Location) -> dict[str, Any] | None:
    """What a sweep that continues this store must share, kept twice; None where it is lost."""
    for key in (ROOT, SECOND):
        try:
            found = json.loads((attributes_of(location, key) or {})[IDENTITY])
        except (KeyError, ValueError, TypeError):
            continue
        if isinstance(found, dict):
            return found
    return None


def _plain(values: np.ndarray) -> np.ndarray:
    # names as objects: Zarr v3 has a type for them, but none for NumPy's strings of fixed length
    return values.astype(object) if values.dtype.kind == "U" else values


def _attributes(name: str, unit: str | None) -> dict[str, Any]:
    known = (VARIABLES | MARGINS).get(name)
    attributes: dict[str, Any] = {} if known is None else dict(vars(known))
    if attributes:
        attributes["units"] = in_unit(attributes["units"], unit)
    if name == "verdict":
        attributes["flag_values"] = [int(kind) for kind in Verdict]
        attributes["flag_meanings"] = " ".join(kind.label.replace(" ", "_") for kind in Verdict)
    return attributes


def provenance(specification: Specification, device: str) -> dict[str, Any]:
    """Attributes of a store: all that is needed to run it again.

    The specification (JSON, TOML and the value of every parameter), versions, seed, command,
    device, time.

    Args:
        specification: what was asked.
        device: what it runs on, in words.
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
    if of_margins(specification):
        found[KIND] = SAMPLED
    model = specification.model
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
    own = engines.named(engine)
    return versions((*_NUMERIC, *(own.packages if own else ())))


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
    unit = json.loads(results.attrs["specification"]).get("unit")
    return xr.DataArray(value, name=name, attrs=dict(of(name, unit).attributes))


def unwritable(where: str | Path, error: OSError) -> str:
    """What to say of a place that cannot be written."""
    return f"{where}: cannot be written ({error.strerror or error}); give another place with `out`"
