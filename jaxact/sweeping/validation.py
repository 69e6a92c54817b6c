"""Is a store what was computed: every checksum, and some loops computed again."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass

import numpy as np

from jaxact import engines
from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops.samples import Samples, expand, explicit
from jaxact.loops.specification import Specification
from jaxact.simulation import execute, plans
from jaxact.sweeping import integrity, margins_computer, opening, progress
from jaxact.sweeping import store as _store
from jaxact.sweeping.location import Location
from jaxact.sweeping.progress import Store
from jaxact.sweeping.variables import of_margins

# Another compiler may round otherwise; near a threshold a metric then jumps.
_TOLERANCE = {"float32": 1e-3, "float64": 1e-9}
# Where a peak is known far less well than how high it is.
_OF_MARGINS = 1e-4

_MENDED = "`jaxact sweep ... --resume` mends it"


@dataclass(frozen=True)
class ChecksumReport:
    """What the checksums say.

    Attributes:
        chunks, done: in all, and whole.
        wrong: what of metadata, coordinates and chunks is not whole, and why.
        foreign: files that are not part of the store.
        older: it was made before metadata and coordinates had checksums.
    """

    chunks: int
    done: int
    wrong: tuple[str, ...]
    foreign: tuple[str, ...] = ()
    older: bool = False


@dataclass(frozen=True)
class Recomputed:
    """Loops computed again.

    Attributes:
        loops, wrong: in all, and with other results.
        words: how they agree.
        example: of one that differs.
    """

    loops: int
    wrong: int
    words: str
    example: str


def checksums(target: Location) -> ChecksumReport:
    """Read every file of a store and hold it against its checksum."""
    found = integrity.description(target)
    store = progress.existing(target) if found.wrong else integrity.chunked(target, found)
    numbers = range(0 if store is None else len(store.layout))
    findings = [] if store is None else [store.look(number) for number in numbers]
    lost = integrity.lost(numbers, findings)
    foreign = () if found.wrong else tuple(integrity.foreign(target, found, store))
    return ChecksumReport(
        len(numbers), len(numbers) - len(lost), (*found.wrong, *lost), foreign, found.older
    )


def recompute(target: Location, number: int, seed: int) -> Recomputed:
    """Compute some loops of a store again.

    Args:
        target: of the store.
        number: loops, at most.
        seed: of their choice.

    Raises:
        UserError: the store does not describe its sweep.
    """
    store = _existing(target)
    specification, samples, outline = _described(target)
    total = len(samples)
    chosen = np.sort(np.random.default_rng(seed).choice(total, min(number, total), replace=False))
    stored, tiles = _stored(store, chosen)
    rows: dict[str, np.ndarray] = {}
    for tile in np.unique(tiles):
        part = tiles == tile
        asked = dataclasses.replace(specification, tile=int(tile), devices=1)
        for name, values in _computed(asked, samples, outline, chosen[part]).items():
            rows.setdefault(name, np.zeros(chosen.size, values.dtype))[part] = values
    other = _rounds_otherwise(target)
    near = _OF_MARGINS if of_margins(specification) else _TOLERANCE[store.precision]
    differing = np.zeros(chosen.size, bool)
    for name in store.variables:
        kind = store.dtype(name)
        old, new = stored[name], rows[name].astype(kind)
        equal = (old == new) | (np.isnan(old.astype(float)) & np.isnan(new.astype(float)))
        if other and kind.kind == "f":
            equal |= np.isclose(old, new, rtol=near, atol=1e-6)
        differing |= ~equal
    wrong = int(differing.sum())
    words = f"the same to rounding ({other})" if other else "bit for bit the same"
    return Recomputed(
        loops=int(chosen.size),
        wrong=wrong,
        words="differences" if wrong else words,
        example=f"loop {chosen[differing][0]}" if wrong else "",
    )


def _computed(
    asked: Specification, samples: Samples, outline: Samples, numbers: np.ndarray
) -> dict[str, np.ndarray]:
    """Results of some loops by variable."""
    if of_margins(asked):
        return margins_computer.recomputed(asked, samples, numbers)
    groups = plans.groups(asked, outline, together=numbers.size, refined=outline is not samples)
    return execute.compute(groups, asked, samples, numbers)


def _existing(target: Location) -> Store:
    store = progress.existing(target)
    if store is None:
        raise UserError(f"{target.name}: does not say how it is cut up; {_MENDED}")
    return store


def _described(target: Location) -> tuple[Specification, Samples, Samples]:
    """The specification of a store, its loops, and those that span their values."""
    attributes = _store.attributes_of(target) or {}
    try:
        specification = reading.parse(str(attributes["specification_toml"]))
    except KeyError:
        raise UserError(f"{target.name}: its description is lost; {_MENDED}") from None
    grid = expand(specification)
    if "adaptive" not in attributes:
        return specification, grid, grid
    asked = json.loads(attributes["adaptive"])
    coords = opening.opened(target).coords
    columns = {name: coords[name].values for name in (*asked["cases"], *asked["refined"])}
    return specification, explicit(specification, columns), grid


def _stored(store: Store, numbers: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The results of some loops by variable, and the tile of each; shape (n,) each."""
    spans = np.array([store.layout.span(chunk)[0] for chunk in range(len(store.layout))])
    chunks = np.searchsorted(spans, numbers, side="right") - 1
    found = {name: np.zeros(numbers.size, store.dtype(name)) for name in store.variables}
    tiles = np.zeros(numbers.size, int)
    for chunk in np.unique(chunks):
        here = chunks == chunk
        rows = store.read(int(chunk))
        receipt = store.receipt(int(chunk))
        assert receipt is not None
        tiles[here] = int(receipt[1])
        for name, values in rows.items():
            found[name][here] = values[numbers[here] - spans[chunk]]
    return found, tiles


def _rounds_otherwise(target: Location) -> str:
    """Why this process need not come to the bits of a store; "" if it must."""
    import jax

    there = _store.identity_of(target) or {}
    engine = str(there.get("engine", ""))
    platform = "cpu" if jax.default_backend() == "cpu" else "gpu"
    if (there.get("versions"), there["platform"]) != (_store.numeric_versions(engine), platform):
        return "other versions or devices"
    own = engines.named(engine)
    if own and not own.simulates:
        return "loops that are computed together round alike"
    if platform == "gpu" and own and not own.reproducible:
        return f"{own.title} on a GPU adds up in any order"
    return ""
