"""One process at a time fills a results folder.

In a folder the lock is a file that is locked for as long as its holder lives, so that one left
behind by a killed process is not taken for a living one; it also names process and host. A store
behind a URL knows no locks: there the file alone stands for one, and is taken over from a process
of the same host that has ended.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxact.errors import UserError
from jaxact.sweeping.location import Folder, Location

NAME = "sweep.lock"


@contextlib.contextmanager
def held(folder: Location) -> Iterator[None]:
    """Hold the lock of a results folder, which must be there.

    Raises:
        UserError: another process holds it; names that and its host.
        OSError: the folder cannot be written.
    """
    taken = _local(folder.path) if isinstance(folder, Folder) else _remote(folder)
    with taken:
        yield


def holder(folder: Location) -> str:
    """Who holds the lock: "process 12 on host", or "" where nobody does."""
    content = folder.read(NAME)
    owner = _owner(content)
    if content is None:
        return ""
    if owner["host"] == socket.gethostname() and not _alive(owner["pid"]):
        return ""
    return _words(owner)


@contextlib.contextmanager
def _local(folder: Path) -> Iterator[None]:
    path = folder / NAME
    file = _open_locked(path)
    try:
        owner = _owner(path.read_bytes())
        if owner["host"] not in ("", socket.gethostname()):
            # a file system that does not carry locks from host to host
            raise UserError(_refusal(path, owner))
        os.ftruncate(file, 0)
        os.pwrite(file, _mine(), 0)
        try:
            yield
        finally:
            path.unlink(missing_ok=True)
    finally:
        os.close(file)


def _open_locked(path: Path) -> int:
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(file)
            raise UserError(_refusal(path, _patient_owner(path))) from None
        except OSError:
            os.close(file)
            raise
        with contextlib.suppress(FileNotFoundError):
            if os.stat(path).st_ino == os.fstat(file).st_ino:
                return file
        # its holder removed it between our opening and locking it
        os.close(file)


@contextlib.contextmanager
def _remote(folder: Location) -> Iterator[None]:
    content = folder.read(NAME)
    if content is not None and holder(folder):
        raise UserError(_refusal(f"{folder.name}/{NAME}", _owner(content)))
    folder.write({NAME: _mine()})
    try:
        yield
    finally:
        folder.delete(NAME)


def _mine() -> bytes:
    return json.dumps({"pid": os.getpid(), "host": socket.gethostname()}).encode()


def _owner(content: bytes | None) -> dict[str, Any]:
    try:
        found = json.loads(content or b"")
        return {"pid": int(found["pid"]), "host": str(found["host"])}
    except (ValueError, KeyError, TypeError):
        return {"pid": 0, "host": ""}


def _patient_owner(path: Path) -> dict[str, Any]:
    """The owner in a lock file, which another process may be about to write."""
    for _ in range(20):
        with contextlib.suppress(OSError):
            owner = _owner(path.read_bytes())
            if owner["pid"]:
                return owner
        time.sleep(0.05)
    return _owner(None)


def _alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def _words(owner: dict[str, Any]) -> str:
    return f"process {owner['pid']} on {owner['host']}"


def _refusal(path: object, owner: dict[str, Any]) -> str:
    return (
        f"{path}: {_words(owner)} is filling this folder; wait for it, end it, or give another"
        " `out` (if it is gone for certain, remove this file)"
    )
