"""Files that a verb writes beside its picture: checked first, written whole or not at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from jaxact import files
from jaxact.errors import UserError


def check_output(path: Path | None, ending: str, *, overwrite: bool) -> None:
    """Raise UserError if a file cannot be written there, or is there and may not be replaced.

    Args:
        path: of the file, None for none.
        ending: that its name must have, e.g. ".csv".
        overwrite: replace a file that is there.
    """
    if path is None:
        return
    if path.suffix.lower() != ending:
        raise UserError(f"output {path}: the name must end in {ending}")
    files.check_output(path, overwrite=overwrite)


def write(path: Path, fill: Callable[[BinaryIO], object]) -> None:
    """Write a file through a temporary one beside it.

    Args:
        path: of the file.
        fill: writes the content into an open binary file.

    Raises:
        UserError: the folder cannot be written to.
    """
    with files.output(path) as partial, partial.open("wb") as file:
        fill(file)
