"""Is every file of a store as it was written, before anything is shown of it?

The root says of every file of the description (metadata, coordinates) which checksum it has, see
`jaxact.sweeping.checksums`; the receipts say it of the results, see `jaxact.sweeping.progress`. A
store that was written at once has no receipts: its root says it of all files.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from jaxact.errors import UserError
from jaxact.sweeping import checksums, progress
from jaxact.sweeping import store as _store
from jaxact.sweeping.checksums import ChecksumState
from jaxact.sweeping.location import Location
from jaxact.sweeping.progress import Finding, State, Store
from jaxact.sweeping.store import ROOT, SECOND
from jaxact.sweeping.variables import MARGINS, VARIABLES


@dataclass(frozen=True)
class Description:
    """What a look at the description of a store has found.

    Attributes:
        wrong: what is damaged, a few words each.
        keys: of its files, as far as known.
        older: it was made before descriptions had checksums, so that not all damage is found.
    """

    wrong: tuple[str, ...]
    keys: frozenset[str]
    older: bool = False


def description(location: Location) -> Description:
    """Hold the metadata and coordinates of a store against their checksums."""
    content = location.read(ROOT)
    if content is None:
        return Description((f"{ROOT} is missing",), frozenset())
    found = _store.checksum_state(location, ROOT, content)
    if found is ChecksumState.BROKEN:
        return Description((f"{ROOT}: its checksum is wrong",), frozenset())
    try:
        root = json.loads(content)
        if found is ChecksumState.NONE:
            return _older(location, root)
        expected = dict(json.loads(root["attributes"][checksums.CHECKSUMS]))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return Description((f"{ROOT} cannot be read",), frozenset())
    wrong = []
    for key, digest in expected.items():
        there = location.read(key)
        if there is None:
            wrong.append(f"{key} is missing")
        elif checksums.digest(there) != digest:
            wrong.append(f"{key}: its checksum is wrong")
    return Description(tuple(wrong), frozenset({ROOT, *expected}))


def _older(location: Location, root: Mapping[str, Any]) -> Description:
    """What can be said of a store whose description has no checksums: metadata is there twice."""
    wrong = []
    keys = {ROOT}
    for name, metadata in root["consolidated_metadata"]["metadata"].items():
        key = f"{name}/{ROOT}"
        keys.add(key)
        content = location.read(key)
        try:
            same = content is not None and _bare(json.loads(content)) == _bare(metadata)
        except ValueError:
            same = False
        if not same:
            wrong.append(f"{key} is {'missing' if content is None else 'damaged'}")
        if metadata["node_type"] == "array" and name not in VARIABLES | MARGINS:
            coordinate = {f"{name}/c/{n}" for n in range(_pieces(metadata))}
            keys |= coordinate
            wrong += [f"{one} is missing" for one in coordinate if location.read(one) is None]
    return Description(tuple(wrong), frozenset(keys), older=True)


def _bare(metadata: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in metadata.items() if key != "consolidated_metadata"}


def _pieces(metadata: Mapping[str, Any]) -> int:
    """Chunks of a coordinate, which has one dimension; 0 of any other array."""
    if len(metadata["shape"]) != 1 or not metadata["shape"][0]:
        return 0
    chunk = int(metadata["chunk_grid"]["configuration"]["chunk_shape"][0])
    return -(-int(metadata["shape"][0]) // chunk)


def chunked(location: Location, found: Description) -> Store | None:
    """The store with its receipts; None for one that was written at once, which has none."""
    return progress.existing(location) if SECOND in found.keys else None


def lost(numbers: Iterable[int], findings: Iterable[Finding]) -> list[str]:
    """What is wrong with chunks that should all be done, a few words each."""
    return [
        f"chunk {number} {finding.state.value}{f' ({finding.why})' if finding.why else ''}"
        for number, finding in zip(numbers, findings, strict=True)
        if finding.state is not State.DONE
    ]


def foreign(location: Location, found: Description, store: Store | None) -> list[str]:
    """Files in a store that are not part of it; nothing reads them."""
    known = found.keys | (set() if store is None else store.keys)
    return sorted(set(location.entries()) - known)


def refuse(location: Location, wrong: Iterable[str]) -> None:
    """Raise UserError, which says what of a store is damaged and what mends it, if anything is."""
    words = list(wrong)
    if not words:
        return
    more = f"; {len(words) - 3} more, see `jaxact validate`" if len(words) > 3 else ""
    raise UserError(
        f"{location.name}: is damaged: {'; '.join(words[:3])}{more}; {mended_by(location)}"
    )


def mended_by(location: Location) -> str:
    """What mends a damaged store."""
    if _store.identity_of(location) is None:
        return "make it again"
    return "`jaxact sweep ... --resume` mends it (`jaxact validate` checks all of it)"


def is_whole(location: Location) -> bool:
    """Whether a store is complete and nothing of it is damaged, by all its bytes."""
    found = description(location)
    store = chunked(location, found)
    complete = (_store.attributes_of(location) or {}).get("complete", False)
    if found.wrong or found.older or store is None or not complete:
        return False
    return all(store.look(number).state is State.DONE for number in range(len(store.layout)))


def demand(location: Location, look: Callable[[Store, int], Finding]) -> Description:
    """Raise UserError if anything of a store is damaged; of an unfinished one, its description.

    Args:
        location: of the store.
        look: at one of its chunks: all its bytes, or names and sizes of files.
    """
    found = description(location)
    refuse(location, found.wrong)
    store = chunked(location, found)
    complete = (_store.attributes_of(location) or {}).get("complete", False)
    if store is not None and complete:
        numbers = range(len(store.layout))
        refuse(location, lost(numbers, (look(store, number) for number in numbers)))
    return found
