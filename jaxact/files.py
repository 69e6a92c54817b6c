"""Files that are there as a whole, or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from jaxact.errors import UserError


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
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".jaxact-") as folder:
        partial = Path(folder) / path.name
        yield partial
        os.replace(partial, path)


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
