"""A store that is written all at once: there as a whole, or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from jaxact.errors import UserError
from jaxact.sweeping import store as _store
from jaxact.sweeping.location import Folder

if TYPE_CHECKING:
    import xarray as xr


@contextlib.contextmanager
def destination(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """A new folder to write into, which takes the place of `path` once the block is done.

    The folder lies beside `path`, so that a forbidden place is found before the work.
    Whatever ends the block with an exception leaves `path` as it was, and nothing else behind.

    Args:
        path: of the store.
        overwrite: replace a jaxact store that is there already; nothing else is ever replaced.

    Raises:
        UserError: `path` exists and may not be replaced, or cannot be written.
    """
    refuse_existing(path, overwrite=overwrite)
    made = _make_folders(path.parent)
    partial: Path | None = None
    try:
        partial = Path(
            tempfile.mkdtemp(prefix=f".{path.name}.", suffix=".partial", dir=path.parent)
        )
        yield partial
        _replace(partial, path, overwrite)
    except BaseException as error:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()
        if isinstance(error, OSError):
            raise UserError(_store.unwritable(path, error)) from error
        raise


def write(results: xr.Dataset, folder: Path) -> None:
    """Write a dataset as a Zarr v3 store into an empty folder, with a checksum of every file."""
    with warnings.catch_warnings():
        # one metadata file for the whole store, without which xarray warns whenever it is opened
        warnings.filterwarnings("ignore", message="Consolidated metadata is currently not part")
        results.to_zarr(folder, mode="w", zarr_format=3, consolidated=True)
    location = Folder(folder)
    files = {key: location.read(key) or b"" for key in location.entries()}
    location.write({_store.ROOT: _store.described_by_root(files)[_store.ROOT]})


def refuse_existing(path: Path, *, overwrite: bool) -> None:
    """Raise UserError if a path exists and may not be replaced; arguments as for `destination`."""
    if not os.path.lexists(path):
        return
    if not _store.is_ours(Folder(path)) or path.is_symlink():
        raise UserError(
            f"{path}: exists and is no result of a sweep, so it stays; give another `out`"
        )
    if not overwrite:
        raise UserError(f"{path}: exists; give another `out`, or `overwrite` to replace it")


def _make_folders(folder: Path) -> list[Path]:
    """Make the folder and its parents; returns those that were not there, innermost first."""
    missing = []
    for step in (folder, *folder.parents):
        if os.path.exists(step):
            break
        missing.append(step)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        for step in missing:
            with contextlib.suppress(OSError):
                step.rmdir()
        raise UserError(_store.unwritable(folder, error)) from error
    return missing


def _replace(partial: Path, path: Path, overwrite: bool) -> None:
    """Put the finished folder in its place; what was there is gone only after that."""
    partial.chmod(0o777 & ~_umask())
    if not (overwrite and path.exists()):
        partial.rename(path)
        return
    old = path.with_name(f"{partial.name}.old")
    path.rename(old)
    partial.rename(path)
    shutil.rmtree(old)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
