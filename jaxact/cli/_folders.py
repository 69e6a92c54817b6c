"""A folder of files that a verb writes: checked first, there as a whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxact import files
from jaxact.cli import _signals
from jaxact.errors import UserError


def check_folder(path: Path | None, *, overwrite: bool) -> None:
    """Raise UserError if a folder cannot be made there, or is there and may not be replaced.

    Args:
        path: of the folder, None for none.
        overwrite: replace a folder that is there.
    """
    if path is None:
        return
    if not path.absolute().parent.is_dir():
        raise UserError(f"output {path}: the folder {path.parent} does not exist; create it first")
    if path.exists() and not path.is_dir():
        raise UserError(f"output {path}: is a file; name a folder")
    if path.exists() and not overwrite:
        raise UserError(f"output {path}: exists; give another name, or --overwrite to replace it")


@contextmanager
def whole_folder(path: Path) -> Iterator[Path]:
    """A temporary folder to fill, which takes the place of `path` at the end, if all went well.

    Raises:
        UserError: it cannot be written.
    """
    try:
        with files.temporary(path.absolute().parent) as beside:
            new, old = beside / "new", beside / "old"
            new.mkdir()
            yield new
            _signals.undivided(lambda: _replace(path, new, old))
    except OSError as error:
        reason = error.strerror or error
        raise UserError(f"output {path}: cannot be written ({reason}); choose another") from error


def _replace(path: Path, new: Path, old: Path) -> None:
    """Move a new folder to `path`, and what was there to `old`; in between, neither is there."""
    if path.exists():
        os.replace(path, old)
    try:
        os.replace(new, path)
    except OSError:
        if old.exists():
            os.replace(old, path)
        raise
    _signals.keep(f"interrupted; {path} is written")
