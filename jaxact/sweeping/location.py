"""Where a store lies: a local folder, or a URL that fsspec knows; files in it by their key.

A file is written whole or not at all, and once `write` returns it survives a power cut: in a folder
by a temporary file, fsync, rename, and fsync of the folder; elsewhere by the store's own upload,
which replaces an object at once. Keys are relative paths with slashes.
"""

from __future__ import annotations

import contextlib
import glob
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Protocol

from jaxact.errors import UserError

_PARTIAL = ".partial"
_METADATA = "zarr.json"


@dataclass(frozen=True)
class Entry:
    """A file that is there.

    Attributes:
        size: [bytes].
        modified: [s since 1970], 0 where the store does not say.
    """

    size: int
    modified: float


class Location(Protocol):
    """A folder of files by key; every method raises OSError where the store fails."""

    @property
    def name(self) -> str:
        """Path or URL as the user knows it."""

    def inside(self, *parts: str) -> Location:
        """A folder in this one."""

    def read(self, key: str) -> bytes | None:
        """The content of a file, None where there is none."""

    def write(self, files: Mapping[str, bytes]) -> None:
        """Write files by key; each is there as a whole or not at all."""

    def delete(self, key: str) -> None:
        """Remove a file, if it is there."""

    def entries(self) -> dict[str, Entry]:
        """All files below, by key, but for temporary ones."""

    def clean(self) -> None:
        """Remove the temporary files that a killed process has left."""

    def remove(self) -> None:
        """Remove the folder with all that is in it, if it is there."""

    def zarr(self) -> Any:
        """What zarr and xarray open it as."""


def at(where: str | Path) -> Location:
    """The place that a path or URL names.

    Args:
        where: a path, `file://...`, or `protocol://...` of a store that fsspec knows.

    Raises:
        UserError: a URL whose protocol needs a package that is not installed.
    """
    text = str(where)
    if not is_url(text):
        return Folder(Path(text))
    if text.startswith("file://"):
        return Folder(Path(text.removeprefix("file://")))
    try:
        import fsspec

        system, root = fsspec.core.url_to_fs(text)
    except ImportError as error:
        raise UserError(f"{text}: {error}; install jaxact[remote]") from None
    except ValueError as error:
        raise UserError(f"{text}: {error}") from None
    return Remote(text.rstrip("/"), system, str(root).rstrip("/"))


def is_url(where: str | Path) -> bool:
    """Whether a text names a place by its protocol."""
    return "://" in str(where)


@dataclass(frozen=True)
class Folder:
    """A local folder, or one of a file system that all machines share."""

    path: Path

    @property
    def name(self) -> str:
        """The path."""
        return str(self.path)

    def inside(self, *parts: str) -> Folder:
        """A folder in this one."""
        return Folder(self.path.joinpath(*parts))

    def read(self, key: str) -> bytes | None:
        """The content of a file, None where there is none."""
        try:
            return (self.path / key).read_bytes()
        except (FileNotFoundError, NotADirectoryError, IsADirectoryError):
            return None

    def write(self, files: Mapping[str, bytes]) -> None:
        """Write files by key; each is there as a whole or not at all."""
        folders = {(self.path / key).parent for key in files}
        for folder in sorted(folders):
            _make(folder)
        pairs: list[tuple[Path, Path]] = []
        try:
            for key, content in files.items():
                path = self.path / key
                pairs.append((path.with_name(f".{path.name}.{os.getpid()}{_PARTIAL}"), path))
                _put(pairs[-1][0], content)
            for partial, path in pairs:
                if path.is_dir():
                    path.rmdir()  # empty, in the place of a file: damage
                partial.replace(path)
        except BaseException:
            for partial, _ in pairs:
                with contextlib.suppress(OSError):
                    partial.unlink(missing_ok=True)
            raise
        for folder in folders:
            _sync(folder)

    def delete(self, key: str) -> None:
        """Remove a file, if it is there."""
        (self.path / key).unlink(missing_ok=True)

    def entries(self) -> dict[str, Entry]:
        """All files below, by key, but for temporary ones."""
        found: dict[str, Entry] = {}
        folders = [self.path] if self.path.is_dir() else []
        while folders:
            with os.scandir(folders.pop()) as listing:
                for item in listing:
                    if item.is_dir(follow_symlinks=False):
                        folders.append(Path(item.path))
                    elif not item.name.endswith(_PARTIAL):
                        with contextlib.suppress(FileNotFoundError):  # replaced meanwhile
                            status = item.stat()
                            key = Path(item.path).relative_to(self.path).as_posix()
                            found[key] = Entry(status.st_size, status.st_mtime)
        return found

    def clean(self) -> None:
        """Remove the temporary files that a killed process has left."""
        for path in self.path.rglob(f".*{_PARTIAL}"):
            path.unlink(missing_ok=True)
        for path in self.path.parent.glob(f".{glob.escape(self.path.name)}.*{_PARTIAL}"):
            shutil.rmtree(path)

    def remove(self) -> None:
        """Remove the folder with all that is in it, if it is there.

        It is renamed first, so that a store is whole or gone.
        """
        if not self.path.exists():
            return
        gone = self.path.with_name(f".{self.path.name}.{os.getpid()}{_PARTIAL}")
        if gone.exists():  # a killed process of the same number has left it
            shutil.rmtree(gone)
        self.path.rename(gone)
        shutil.rmtree(gone)

    def zarr(self) -> Any:
        """What zarr and xarray open it as."""
        return str(self.path)


def _make(folder: Path) -> None:
    """Make a folder and its parents, each durably in its own parent."""
    if folder.is_dir():
        return
    if folder.parent != folder:
        _make(folder.parent)
    folder.mkdir(exist_ok=True)
    _sync(folder.parent)


def _put(path: Path, content: bytes) -> None:
    with open(path, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """Make what was renamed into a folder durable; not all systems can."""
    with contextlib.suppress(PermissionError, NotImplementedError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


@dataclass(frozen=True)
class Remote:
    """A folder of a store that fsspec knows.

    Attributes:
        url: as the user gave it.
        system: fsspec's file system.
        root: the folder in it.
    """

    url: str
    system: Any
    root: str

    @property
    def name(self) -> str:
        """The URL."""
        return self.url

    def inside(self, *parts: str) -> Remote:
        """A folder in this one."""
        return Remote("/".join((self.url, *parts)), self.system, "/".join((self.root, *parts)))

    def read(self, key: str) -> bytes | None:
        """The content of a file, None where there is none."""
        with contextlib.suppress(FileNotFoundError, NotADirectoryError, IsADirectoryError):
            with _as_os_error():
                return bytes(self.system.cat_file(f"{self.root}/{key}"))
        return None

    def write(self, files: Mapping[str, bytes]) -> None:
        """Write files by key; each is there as a whole or not at all."""
        with _as_os_error():
            for folder in {f"{self.root}/{key}".rpartition("/")[0] for key in files}:
                self.system.makedirs(folder, exist_ok=True)
            self.system.pipe({f"{self.root}/{key}": content for key, content in files.items()})

    def delete(self, key: str) -> None:
        """Remove a file, if it is there."""
        with contextlib.suppress(FileNotFoundError), _as_os_error():
            self.system.rm_file(f"{self.root}/{key}")

    def entries(self) -> dict[str, Entry]:
        """All files below, by key, but for temporary ones."""
        self.system.invalidate_cache()
        start = len(self.system._strip_protocol(self.root)) + 1
        with _as_os_error():
            found = self.system.find(self.root, detail=True)
        return {
            str(path)[start:]: Entry(int(item.get("size") or 0), _modified(item))
            for path, item in found.items()
        }

    def clean(self) -> None:
        """Nothing: uploads that were broken off leave no object."""

    def remove(self) -> None:
        """Remove the folder with all that is in it, if it is there."""
        self.system.invalidate_cache()
        with _as_os_error():
            if not self.system.exists(self.root):
                return
            # what says whose the folder is goes last, so that the rest is known whenever it ends
            keys = sorted(
                self.entries(), key=lambda key: (key.endswith(_METADATA), -key.count("/"))
            )
            for key in keys:
                self.delete(key)
            if self.system.exists(self.root):
                self.system.rm(self.root, recursive=True)

    def zarr(self) -> Any:
        """What zarr and xarray open it as."""
        from zarr.storage import FsspecStore

        return FsspecStore.from_url(self.url)


@contextlib.contextmanager
def _as_os_error() -> Iterator[None]:
    """What a store's own library raises, no credentials say or no connection, as an OSError."""
    try:
        yield
    except Exception as error:
        if isinstance(error, OSError) or type(error).__module__ == "builtins":
            raise
        lines = str(error).splitlines() or [type(error).__name__]
        raise OSError(lines[0]) from error


def _modified(item: Mapping[str, Any]) -> float:
    """When a file was written [s since 1970], 0 where the store does not say."""
    for name in ("LastModified", "mtime", "last_modified", "updated", "created"):
        value = item.get(name)
        if isinstance(value, int | float):
            return float(value)
        if isinstance(value, datetime):
            return value.timestamp()
    return 0.0
