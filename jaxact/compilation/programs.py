"""Compiled programs that are kept from process to process, in a folder that is named by `FOLDER`.

JAX finds a kept kernel by what it was traced to, and tracing takes longer than loading. Here a
program is found by what its trace follows from, so that nothing is traced.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import pickle
import platform
import re
import tempfile
import zlib
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.experimental import serialize_executable

import jaxact

FOLDER = "JAXACT_PROGRAMS"
"""Environment variable: the folder, of the user's own, as what is in it is executed. Unset: nothing
is kept."""

KEPT = 32
"""Programs of one kind that a process keeps: each takes some hundred mappings of memory, of which
Linux gives a process 65,530, and XLA crashes where none is left."""

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


class Program:
    """A function that is compiled for each shape of its inputs, when it is called or before."""

    def __init__(self, make: Callable[[], Callable], name: object | None, devices: int = 1) -> None:
        """Take a function.

        Args:
            make: gives the function of arrays; not asked where the program has been kept.
            name: what it computes, whose `repr` tells everything that its trace depends on beside
                its inputs, JAX's settings, and the code of jaxact; None: it cannot be kept.
            devices: on which it runs, the first of the local ones.
        """
        self._make = make
        self._name = name
        self._devices = devices
        self._compiled: dict[Any, Callable] = {}

    def __call__(self, *inputs: Any) -> Any:
        """Run it."""
        return self.compiled(*inputs)(*inputs)

    def compiled(self, *inputs: Any) -> Callable:
        """What runs on inputs like these; threads may compile different programs side by side."""
        shapes = _shapes(inputs)
        if shapes not in self._compiled:
            path = None if self._name is None else _path(self._name, shapes)
            found = None if path is None else _load(path, self._devices)
            if found is None:
                found = self._function.lower(*inputs).compile()
                if path is not None:
                    _keep(path, found)
            self._compiled[shapes] = found
            for old in list(self._compiled)[:-KEPT]:
                self._compiled.pop(old, None)
            return found
        return self._compiled[shapes]

    @functools.cached_property
    def _function(self) -> Any:
        return jax.jit(self._make())


def _shapes(inputs: Any) -> Any:
    leaves, structure = jax.tree.flatten(inputs)
    return structure, jax.numpy.result_type(float), tuple(map(jax.typeof, leaves))


def _path(name: object, shapes: Any) -> Path | None:
    """The file of a program; None where programs are not kept."""
    folder = os.environ.get(FOLDER)
    if not folder or jax.default_backend() != "cpu":
        return None
    settings = {name: value for name, value in jax.config.values.items() if "cache" not in name}
    flags = os.environ.get("XLA_FLAGS")
    facts = (name, shapes, sorted(settings.items()), flags, _surroundings())
    told = repr(facts)
    if "array(" in told:
        return None  # NumPy shortens long ones
    return Path(folder) / (hashlib.sha256(told.encode()).hexdigest() + _ENDING)


@functools.cache
def _surroundings() -> tuple[Any, ...]:
    """All that a trace and its compilation depend on beside settings: code, packages, devices."""
    code = hashlib.sha256()
    for path in sorted(Path(jaxact.__file__).parent.rglob("*.py")):
        code.update(path.read_bytes())
    packages = tuple(version(name) for name in ("jax", "jaxlib", "mujoco", "mujoco-mjx"))
    devices = tuple((one.platform, one.device_kind, one.id) for one in jax.local_devices())
    build = jax.local_devices()[0].client.platform_version
    return code.hexdigest(), packages, devices, build, platform.python_version(), _processor()


def _processor() -> str:
    """What the processor can do: a home folder may be that of many machines."""
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        told = {line for line in lines if line.startswith(("model name", "flags", "Features"))}
        return " ".join(sorted(told))
    return platform.processor()


def _load(path: Path, devices: int) -> Callable | None:
    """A kept program; None if there is none, or it is damaged or cannot be used here."""
    with contextlib.suppress(Exception):  # whatever is wrong with it, it can be compiled
        content = path.read_bytes()
        if hashlib.sha256(content[_DIGEST:]).digest() == content[:_DIGEST]:
            os.utime(path)
            calls, (code, inputs, outputs) = pickle.loads(zlib.decompress(content[_DIGEST:]))
            if calls:
                _start_lapack()
            chosen = jax.local_devices()[:devices]
            return serialize_executable.deserialize_and_load(
                code, inputs, outputs, execution_devices=chosen
            )
    return None


@functools.cache
def _start_lapack() -> None:
    """JAX starts it when it lowers something that calls it; without that, calls crash."""
    jax.jit(jax.lax.linalg.cholesky).lower(np.eye(1, dtype=np.float32))


def _keep(path: Path, compiled: Any) -> None:
    """Keep a program; silently not where that is impossible."""
    with contextlib.suppress(Exception):  # not every program can be, nor every folder be written
        calls = set(_CALL.findall(compiled.as_text()))
        if not all(name.startswith(_LAPACK) for name in calls):
            return
        parts = serialize_executable.serialize(compiled)
        if not any(start in parts[0] for start in _OBJECT_CODE):
            return
        content = zlib.compress(pickle.dumps((calls, parts)), level=1)
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=".", suffix=_ENDING)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(content).digest() + content)
            os.replace(name, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise
        _make_room(path.parent)


def _make_room(folder: Path) -> None:
    """Delete programs, and nothing else that somebody may keep in the folder."""
    kept = [(file.stat(), file) for file in folder.glob(f"*{_ENDING}")]
    size = 0
    for facts, file in sorted(kept, key=lambda one: -one[0].st_mtime):
        size += facts.st_size
        if size > MOST:
            file.unlink(missing_ok=True)
