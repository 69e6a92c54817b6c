"""Checksums of what describes a store: its root carries its own, and those of the other files.

`zarr.json` at the root of a store has two more attributes: `checksums`, the CRC-32C of every other
file of the description (metadata of the arrays, coordinates), and `checksum`, its own. The root is
replaced at once, so that what is said of a store changes from one true state to the next, whenever
a process is killed.

When a sweep was begun, and by which command, differs from run to run, and nothing else of a store
does. So these two have a checksum of their own, behind the time.
"""

from __future__ import annotations

import enum
import json
import re
from collections.abc import Mapping
from typing import Any

import google_crc32c

CHECKSUM = "checksum"
CHECKSUMS = "checksums"
_CREATED, _COMMAND = "created", "command"
_MARKED = re.compile(r"(.*) crc32c:([0-9a-f]{8})", re.DOTALL)


class ChecksumState(enum.Enum):
    """What the checksum of a metadata file says of it."""

    INTACT = "as it was written"
    BROKEN = "not as it was written"
    NONE = "without a checksum"


def digest(content: bytes) -> str:
    """CRC-32C of a file, eight hexadecimal digits."""
    return f"{google_crc32c.value(content):08x}"


def digests(files: Mapping[str, bytes]) -> str:
    """Of some files by key, as the attribute `checksums` has them: JSON."""
    return json.dumps({key: digest(files[key]) for key in sorted(files)})


def sealed(document: Mapping[str, Any]) -> bytes:
    """A metadata file of Zarr with its checksum among its attributes.

    Args:
        document: what is in it.
    """
    attributes = dict(document["attributes"])
    if isinstance(attributes.get(_CREATED), str):
        attributes[_CREATED] = _marked(attributes)
    attributes[CHECKSUM] = _own(dict(document) | {"attributes": attributes})
    return _rendered(dict(document) | {"attributes": attributes})


def state(content: bytes) -> ChecksumState:
    """Whether a metadata file is what `sealed` made."""
    try:
        document = json.loads(content)
        attributes = document["attributes"]
        if CHECKSUM not in attributes:
            return ChecksumState.NONE
        same = _rendered(document) == content and attributes[CHECKSUM] == _own(document)
        if _CREATED in attributes:
            same = same and attributes[_CREATED] == _marked(attributes)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return ChecksumState.BROKEN
    return ChecksumState.INTACT if same else ChecksumState.BROKEN


def plain(attributes: Mapping[str, Any]) -> dict[str, Any]:
    """Attributes as they were before they were sealed."""
    found = {k: v for k, v in attributes.items() if k not in (CHECKSUM, CHECKSUMS)}
    if isinstance(found.get(_CREATED), str):
        found[_CREATED] = _unmarked(found[_CREATED])
    return found


def beginning(content: bytes) -> dict[str, str]:
    """When and by what a store was begun, from a damaged root; empty where that is lost."""
    found = {}
    for name in (_CREATED, _COMMAND):
        match = re.search(rb'"%s": ("(?:[^"\\]|\\.)*")' % name.encode(), content)
        if match is None:
            return {}
        try:
            found[name] = str(json.loads(match[1]))
        except ValueError:
            return {}
    return plain(found) if found[_CREATED] == _marked(found) else {}


def _rendered(document: Mapping[str, Any]) -> bytes:
    return json.dumps(document, indent=2).encode()


def _own(document: Mapping[str, Any]) -> str:
    """The checksum of a file without itself and what differs from run to run."""
    kept = {
        name: value
        for name, value in document["attributes"].items()
        if name not in (CHECKSUM, _CREATED, _COMMAND)
    }
    return f"crc32c:{digest(_rendered(dict(document) | {'attributes': kept}))}"


def _marked(attributes: Mapping[str, Any]) -> str:
    """The time with the checksum of when and by what a store was begun behind it."""
    created = _unmarked(attributes[_CREATED])
    whole = f"{created} {attributes.get(_COMMAND)}".encode(errors="surrogatepass")
    return f"{created} crc32c:{digest(whole)}"


def _unmarked(created: str) -> str:
    match = _MARKED.fullmatch(created)
    return created if match is None else match[1]
