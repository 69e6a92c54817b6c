"""Compiled programs that are kept from process to process, in a folder that is named by `FOLDER`.

JAX finds a kept kernel by what it was traced to, and tracing takes longer than loading. Here a
program is found by what its trace follows from, see `jaxact.compilation.keys`, so that nothing is
traced. What is kept is run as machine code: it is read from, and written to, only a folder that
belongs to the user and that nobody else can write to.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import re
import stat
import warnings
import zlib
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from jaxact.compilation import keys
from jaxact.compilation.processor import on_processor
from jaxact.files import shared, writers

FOLDER = "JAXACT_PROGRAMS"
"""Environment variable: the folder. Unset: nothing is kept."""

KEPT = 100
"""Programs that a process keeps, those that were used last: each takes some hundred mappings of
memory, of which Linux gives a process 65,530, and XLA crashes where none is left."""

MOST = 2**30
"""Bytes of all programs that are kept; those that were not used for longest make room."""

_ENDING = ".program"
_DIGEST = 32  # bytes before the content of a file
# What a program calls outside of it; only of these is it known how to start them.
_CALL = re.compile(r'custom_call_target="([^"]*)"')
_LAPACK = "lapack_"
# How object code begins, on Linux and on macOS. There is none in what XLA has not compiled itself
# but loaded from JAX's own cache; such a program could be loaded once more, but not be run.
_OBJECT_CODE = (b"\x7fELF", b"\xcf\xfa\xed\xfe")


# Of all functions together, since the mappings are the process's.
_in_use: OrderedDict[Any, Callable] = OrderedDict()


def let_go() -> None:
    """Give up the compiled programs of this process, and their memory; the kept ones stay kept."""
    _in_use.clear()


class Program:
    """A function that is compiled for each shape of its inputs, when it is called or before.

    Arguments by position are trees of arrays, arguments by name static: hashable, and written out
    in full in the program's key. One that is not told on how many `devices` is run on the
    processor.
    """

    def __init__(self, function: Callable, *, builds: bool = False) -> None:
        """Take a function at the top level of a module; to be used as a decorator.

        Args:
            function: of arrays and static arguments. One that is defined elsewhere is not kept.
            builds: it takes the static arguments only, and gives the function of arrays; it is not
                called where the program has been kept.
        """
        functools.update_wrapper(self, function)
        self._function = function
        self._builds = builds

    def __call__(self, *inputs: Any, **static: Any) -> Any:
        """Run it."""
        with _place(static):
            return self.compiled(*inputs, **static)(*inputs)

    def compiled(self, *inputs: Any, **static: Any) -> Callable:
        """What runs on inputs like these; threads may compile different programs side by side.

        Args:
            inputs: trees of arrays.
            static: static arguments; `devices` among them is on how many it runs, the first ones.
        """
        key = (self, frozenset(static.items()), _shapes(inputs))
        found = _in_use.get(key)
        if found is None:
            with _place(static):
                found = _in_use[key] = self._found(inputs, static)
            for old in list(_in_use)[:-KEPT]:
                _in_use.pop(old, None)
        with contextlib.suppress(KeyError):  # another thread let go of it
            _in_use.move_to_end(key)
        return found

    def _found(self, inputs: Any, static: dict[str, Any]) -> Callable:
        """The program, from the folder or compiled."""
        name = _name(self._function, static, inputs)
        found = None if name is None else _load(name, static.get("devices", 1))
        if found is None:
            found = self._compile(inputs, static)
            if name is not None:
                _keep(name, found)
        return found

    def _compile(self, inputs: Any, static: dict[str, Any]) -> Any:
        import jax

        function = functools.partial(self._function, **static)
        return jax.jit(function() if self._builds else function).lower(*inputs).compile()


def building(function: Callable) -> Program:
    """A decorator: the program of what the function gives for its static arguments."""
    return Program(function, builds=True)


def _place(static: dict[str, Any]) -> contextlib.AbstractContextManager[Any]:
    """Where a program is compiled and run."""
    return contextlib.nullcontext() if "devices" in static else on_processor()


def _shapes(inputs: Any) -> Any:
    import jax

    leaves, structure = jax.tree.flatten(inputs)
    return structure, jax.numpy.result_type(float), tuple(map(jax.typeof, leaves))


def _name(function: Callable, static: dict[str, Any], inputs: Any) -> str | None:
    """The name of a program's file; None where it cannot be kept."""
    import jax

    if not os.environ.get(FOLDER) or jax.default_backend() != "cpu":
        return None
    key = keys.key(function, static, inputs)
    return None if key is None else key + _ENDING


@contextlib.contextmanager
def _folder(*, make: bool = False) -> Iterator[int | None]:
    """The open folder; None where there is none, or somebody else could have written to it."""
    path = os.environ.get(FOLDER, "")
    opened = None
    with contextlib.suppress(OSError):
        if make:
            Path(path).mkdir(mode=0o700, parents=True, exist_ok=True)
        opened = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        reason = shared(Path(path)) if opened is None else writers(os.fstat(opened))
        if reason:
            _say(path, reason)
        yield None if reason else opened
    finally:
        if opened is not None:
            os.close(opened)


@functools.cache
def _say(path: str, reason: str) -> None:
    warnings.warn(f"{path}: {reason}; compiling anew", stacklevel=2)


def _load(name: str, devices: int) -> Callable | None:
    """A kept program; None if there is none, or it is damaged or cannot be used here."""
    with contextlib.suppress(Exception), _folder() as folder:  # it can always be compiled
        content = None if folder is None else _read(folder, name)
        if content and hashlib.sha256(content[_DIGEST:]).digest() == content[:_DIGEST]:
            return _started(content[_DIGEST:], devices)
    return None


def _read(folder: int, name: str) -> bytes | None:
    """The content of a file of the user's own, which is the one used last then."""
    with open(name, "rb", opener=_opener(folder, os.O_NOFOLLOW)) as file:
        facts = os.fstat(file.fileno())
        if not stat.S_ISREG(facts.st_mode) or writers(facts):
            return None
        os.utime(file.fileno())
        return file.read()


def _opener(folder: int, flags: int) -> Callable[[str, int], int]:
    return lambda name, mode: os.open(name, mode | flags, 0o600, dir_fd=folder)


def _started(content: bytes, devices: int) -> Callable:
    import jax
    from jax.experimental import serialize_executable

    calls, (code, inputs, outputs) = pickle.loads(zlib.decompress(content))
    if calls:
        _start_lapack()
    chosen = jax.local_devices()[:devices]
    return serialize_executable.deserialize_and_load(
        code, inputs, outputs, execution_devices=chosen
    )


@functools.cache
def _start_lapack() -> None:
    """JAX starts it when it lowers something that calls it; without that, calls crash."""
    import jax
    import numpy as np

    jax.jit(jax.lax.linalg.cholesky).lower(np.eye(1, dtype=np.float32))


def _keep(name: str, compiled: Any) -> None:
    """Keep a program; silently not where that is impossible."""
    from jax.experimental import serialize_executable

    with contextlib.suppress(Exception):  # not every program can be, nor every folder be written
        calls = set(_CALL.findall(compiled.as_text()))
        if not all(call.startswith(_LAPACK) for call in calls) or not keys.unchanged():
            return
        parts = serialize_executable.serialize(compiled)
        if not any(start in parts[0] for start in _OBJECT_CODE):
            return
        content = zlib.compress(pickle.dumps((calls, parts)), level=1)
        with _folder(make=True) as folder:
            if folder is not None:
                _write(folder, name, hashlib.sha256(content).digest() + content)
                _make_room(folder)


def _write(folder: int, name: str, content: bytes) -> None:
    """A file that is there as a whole, or not at all."""
    partial = f".{os.urandom(8).hex()}{_ENDING}"
    try:
        with open(partial, "xb", opener=_opener(folder, os.O_NOFOLLOW)) as file:
            file.write(content)
        os.replace(partial, name, src_dir_fd=folder, dst_dir_fd=folder)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(partial, dir_fd=folder)
        raise


def _make_room(folder: int) -> None:
    """Delete programs, and nothing else that somebody may keep in the folder."""
    with os.scandir(folder) as found:
        kept = [(file.stat(follow_symlinks=False), file.name) for file in found
                if file.name.endswith(_ENDING)]  # fmt: skip
    size = 0
    for facts, name in sorted(kept, key=lambda one: -one[0].st_mtime):
        size += facts.st_size
        if size > MOST:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(name, dir_fd=folder)
