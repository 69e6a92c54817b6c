"""Files that are there as a whole or not at all, who can write to them, and what is read once.

And values as files of JSON have them.
"""

from __future__ import annotations

import math
import os
import shutil
import stat
from collections.abc import Callable, Hashable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

from jaxact.errors import UserError

T = TypeVar("T")

# Temporary folders that are there, or may be.
_UNFINISHED: list[Path] = []
# What was read within `read_once` by what it is, None outside of it.
_READ: ContextVar[dict[Hashable, object] | None] = ContextVar("read", default=None)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path to write to, which takes the place of `path` once the block is done.

    It lies beside `path`. Whatever ends the block with an exception leaves `path` as it was, and
    nothing else behind.

    Args:
        path: of the file, which may be there already.

    Raises:
        OSError: the folder cannot be written to.
    """
    with temporary(path.parent) as folder:
        partial = folder / path.name
        yield partial
        os.replace(partial, path)


@contextmanager
def temporary(parent: Path) -> Iterator[Path]:
    """A folder that is gone at the end, whatever ends the block or, by a signal, the process.

    Its name is noted before it is there and until it is gone, for `remove_unfinished`.

    Raises:
        OSError: it cannot be made.
    """
    folder = parent / f".jaxact-{os.urandom(6).hex()}"
    _UNFINISHED.append(folder)
    try:
        folder.mkdir(mode=0o700)
        yield folder
    finally:
        try:
            shutil.rmtree(folder, ignore_errors=True)
        except BaseException:  # interrupted
            shutil.rmtree(folder, ignore_errors=True)
            raise
        finally:
            _UNFINISHED.remove(folder)


def remove_unfinished() -> None:
    """Remove all temporary folders, as the process ends."""
    for folder in list(_UNFINISHED):
        shutil.rmtree(folder, ignore_errors=True)


def check_output(path: Path, *, overwrite: bool = True) -> None:
    """Raise UserError if a file that a user has named cannot be written, or may not be replaced.

    Args:
        path: of the file.
        overwrite: replace a file that is there.
    """
    if not path.parent.is_dir():
        raise UserError(f"output {path}: the folder {path.parent} does not exist; create it first")
    if path.is_dir():
        raise UserError(f"output {path}: is a folder; name a file in it")
    if path.exists() and not overwrite:
        raise UserError(f"output {path}: exists; give another name, or `overwrite` to replace it")


@contextmanager
def output(path: Path) -> Iterator[Path]:
    """As `replacing`, of a file that a user has named.

    Raises:
        UserError: the folder cannot be written to.
    """
    try:
        with replacing(path) as partial:
            yield partial
    except OSError as error:
        reason = error.strerror or error
        raise UserError(f"output {path}: cannot be written ({reason}); choose another") from error


def shared(path: Path) -> str:
    """Why others than the user could have written into a folder; "" if they could not."""
    try:
        facts = path.lstat()
    except OSError:
        return ""  # it is not there
    return "is a symbolic link" if stat.S_ISLNK(facts.st_mode) else writers(facts)


def writers(facts: os.stat_result) -> str:
    """Who else could have written to a file or folder with this status; "" for nobody."""
    if not hasattr(os, "geteuid") or facts.st_uid != os.geteuid():
        return "belongs to another user"
    if facts.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return "can be written to by others (chmod go-w)"
    return ""


@contextmanager
def read_once() -> Iterator[None]:
    """Read each thing once from here to the end of the block, a command.

    Outside of a command it is read whenever it is asked for, as a notebook's may have changed.
    """
    token = _READ.set({})
    try:
        yield
    finally:
        _READ.reset(token)


def once_read(key: Hashable, read: Callable[[], T]) -> T:
    """What `read` returns, or returned for the same key within `read_once`."""
    known = _READ.get()
    if known is None:
        return read()
    if key not in known:
        known[key] = read()
    return known[key]  # type: ignore[return-value]


def plain(value: Any) -> Any:
    """A value, or a table or list of some, as JSON has it: null for NaN, text for infinity."""
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, list):
        return [plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf" if value > 0.0 else "-inf"
    return value
