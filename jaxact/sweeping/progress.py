"""What is done of a sweep: results chunk by chunk in a store, each with a receipt.

The store is the only truth. First the file of every variable is durably there, then the receipt:
the number of the chunk, its tile and the checksums of those files. A chunk whose receipt is not
there is missing, one whose files are not those of the receipt is damaged; both are computed.
"""

from __future__ import annotations

import enum
import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from jaxact.errors import UserError
from jaxact.sweeping import checksums
from jaxact.sweeping import layout as _layout
from jaxact.sweeping import store as _store
from jaxact.sweeping.layout import DamagedError, Layout
from jaxact.sweeping.location import Entry, Location
from jaxact.sweeping.store import PROGRESS, RECEIPT, ROOT, SECOND
from jaxact.sweeping.variables import KIND, dtype_of, variables

_RECEIPTS = f"{PROGRESS}/{RECEIPT}"


class State(enum.Enum):
    """Of a chunk."""

    DONE = "done"
    MISSING = "missing"
    DAMAGED = "damaged"


@dataclass(frozen=True)
class Finding:
    """What a look at a chunk has found.

    Attributes:
        state: of the chunk.
        tile: loops in a tile when it was computed; 0 where it is not done.
        why: what is wrong with a damaged one.
    """

    state: State
    tile: int = 0
    why: str = ""


@dataclass(frozen=True)
class Store:
    """A store that is being filled, or was.

    Attributes:
        location: where it lies.
        layout: how the sweep is cut into chunks.
        precision: of the results, "float32" or "float64".
        tile: loops in a tile, as planned.
        variables: names of the results of every loop, in the order of the receipts.
    """

    location: Location
    layout: Layout
    precision: str
    tile: int
    variables: tuple[str, ...]

    def dtype(self, variable: str) -> np.dtype:
        """Type of the numbers of a variable."""
        return dtype_of(variable, self.precision)

    @property
    def _row(self) -> int:
        return 2 + len(self.variables)

    def write(self, number: int, results: Mapping[str, np.ndarray], tile: int) -> None:
        """Write the results of a chunk, and then its receipt; durable when it returns.

        Args:
            number: of the chunk.
            results: of its samples by variable, each of shape (n,).
            tile: loops in a tile, as they were computed.

        Raises:
            OSError: the store cannot be written.
        """
        files, checksums = {}, []
        for name in self.variables:
            values = np.asarray(results[name], self.dtype(name))
            content, checksum = _layout.encode(values, self.layout.loops)
            files[f"{name}/{self.layout.key(number)}"] = content
            checksums.append(checksum)
        self.location.write(files)
        receipt = np.array([number, tile, *checksums], np.uint32)
        self.location.write({_receipt_key(number): _layout.encode(receipt, self._row)[0]})

    def receipt(self, number: int) -> np.ndarray | None:
        """Chunk, tile and checksums as they were written; None where there is no receipt.

        Raises:
            DamagedError: it is not as it was written.
        """
        content = self.location.read(_receipt_key(number))
        if content is None:
            return None
        row, _ = _layout.decode(content, np.dtype(np.uint32), self._row, self._row)
        if row[0] != number:
            raise DamagedError("its receipt is another chunk's")
        return row

    def read(self, number: int) -> dict[str, np.ndarray]:
        """The results of a chunk that is done, each of shape (n,).

        Raises:
            DamagedError: they are not what its receipt says.
        """
        row = self.receipt(number)
        if row is None:
            raise DamagedError("it has no receipt")
        _, count = self.layout.span(number)
        found = {}
        for name, wanted in zip(self.variables, row[2:], strict=True):
            content = self.location.read(f"{name}/{self.layout.key(number)}")
            if content is None:
                raise DamagedError(f"{name} is missing")
            try:
                values, checksum = _layout.decode(
                    content, self.dtype(name), self.layout.loops, count
                )
            except DamagedError as error:
                raise DamagedError(f"{name}: {error}") from None
            if checksum != wanted:
                raise DamagedError(f"{name} is not what the receipt says")
            found[name] = values
        return found

    def look(self, number: int) -> Finding:
        """Whether a chunk is done, by all its bytes."""
        return self.attempt(number)[0]

    def attempt(self, number: int) -> tuple[Finding, dict[str, np.ndarray]]:
        """Whether a chunk is done, by all its bytes, and its results, each of shape (n,), if so."""
        try:
            row = self.receipt(number)
            if row is None:
                return Finding(State.MISSING), {}
            return Finding(State.DONE, tile=int(row[1])), self.read(number)
        except DamagedError as error:
            return Finding(State.DAMAGED, why=str(error)), {}

    @property
    def keys(self) -> set[str]:
        """Of the files of all chunks."""
        numbers = range(len(self.layout))
        results = {f"{name}/{self.layout.key(n)}" for name in self.variables for n in numbers}
        return results | {_receipt_key(n) for n in numbers}

    def glance(self, number: int, entries: Mapping[str, Entry]) -> Finding:
        """Whether a chunk is done, by names and sizes of files only."""
        if _receipt_key(number) not in entries:
            return Finding(State.MISSING)
        for name in self.variables:
            entry = entries.get(f"{name}/{self.layout.key(number)}")
            size = self.layout.loops * self.dtype(name).itemsize + 4
            if entry is None or entry.size != size:
                return Finding(State.DAMAGED, why=f"{name} is missing or cut off")
        return Finding(State.DONE)

    def finish(self, attributes: Mapping[str, object]) -> None:
        """Put attributes on the whole store, among them the mark of completion."""
        content = self.location.read(ROOT)
        assert content is not None
        root = json.loads(content)
        root["attributes"] |= attributes
        self.location.write({ROOT: checksums.sealed(root)})


def _receipt_key(number: int) -> str:
    return f"{_RECEIPTS}/c.{number}.0"


def times(entries: Mapping[str, Entry]) -> np.ndarray:
    """When the receipts were written [s since 1970], rising."""
    return np.sort(
        [entry.modified for key, entry in entries.items() if key.startswith(f"{_RECEIPTS}/c.")]
    )


def existing(location: Location) -> Store | None:
    """The store in a place as its identity describes it; None where there is none of ours."""
    identity = _store.identity_of(location)
    if identity is None:
        return None
    try:
        layout = Layout(tuple(identity["shape"]), tuple(identity["chunk"]))
        precision, tile = identity["precision"], int(identity["tile"])
        robot, margins = bool(identity.get("shaking_rate")), bool(identity.get(KIND))
        return Store(location, layout, precision, tile, variables(robot=robot, margins=margins))
    except (KeyError, TypeError, ValueError):
        return None


def repair(location: Location, skeleton: Mapping[str, bytes]) -> None:
    """Write every file of a store's description that is not as it should be, the root last.

    The first one says whose store it is, so that it is known for one whenever a process is killed.
    """
    wrong = {key: content for key, content in skeleton.items() if location.read(key) != content}
    last = {ROOT: wrong.pop(ROOT)} if ROOT in wrong else {}
    first = {SECOND: wrong.pop(SECOND)} if SECOND in wrong else {}
    for part in (first, wrong, last):
        if part:
            location.write(part)


def demand_equal(there: Mapping[str, object], here: Mapping[str, object], name: str) -> None:
    """Raise UserError with the differing keys unless two identities are of the same sweep.

    Args:
        there: of the store.
        here: of what is asked for.
        name: of the store.
    """
    old, new = _flat(there), _flat(here)
    differing = [
        f"{key} = {_word(old.get(key))} there, {_word(new.get(key))} here"
        for key in dict.fromkeys((*old, *new))
        if old.get(key) != new.get(key)
    ]
    if differing:
        shown = "; ".join(differing[:6]) + ("; ..." if len(differing) > 6 else "")
        raise UserError(
            f"{name}: was begun with another specification: {shown}; go back to that, give another"
            " `out`, or `overwrite` to begin anew"
        )


def _flat(table: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Nested tables as one, keys joined by dots."""
    found: dict[str, object] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{prefix}{key}.")
        else:
            found[f"{prefix}{key}"] = value
    return found


def _word(value: object) -> str:
    text = "not given" if value is None else json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."


def duration(seconds: float) -> str:
    """`45 s`, `12 min`, `3.4 h`, `2.1 days`."""
    for unit, size, most in (("s", 1.0, 100.0), ("min", 60.0, 100.0), ("h", 3600.0, 48.0)):
        if seconds < most * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds / 86400:,.3g} days"
