"""A folder of files that a verb writes: checked first, there as a whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
        with _temporary(path.absolute().parent) as beside:
            new, old = Path(beside) / "new", Path(beside) / "old"
            new.mkdir()
            yield new
            if path.exists():
                os.replace(path, old)
            try:
                os.replace(new, path)
            except OSError:
                if old.exists():
                    os.replace(old, path)
                raise
    except OSError as error:
        reason = error.strerror or error
        raise UserError(f"output {path}: cannot be written ({reason}); choose another") from error


@contextmanager
def _temporary(parent: Path) -> Iterator[str]:
    """A folder that is gone at the end, whatever ends the block or the process."""
    with tempfile.TemporaryDirectory(dir=parent, prefix=".jaxact-") as folder:
        _signals.unfinished(folder)
        try:
            yield folder
        finally:
            _signals.finished(folder)
