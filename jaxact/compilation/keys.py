"""What a compiled program follows from, as a key of characters that nobody has to keep up to date.

The key is made of the function itself (its name, and the digest of all of jaxact's source), of its
static arguments, of the shapes of its inputs, and of all that JAX compiles for and with. What
cannot be written out completely, so that two different things might be told alike, has no key.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
import platform
import sys
import time
from collections.abc import Callable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import jaxact

PACKAGE = "jaxact"
"""Of its functions the source is known, with that of everything that they call."""

# Of what these have, the version is.
_VERSIONED = ("builtins", "collections", "jax", "jaxlib", "mujoco", "numpy", "optax")
_PLAIN = (str, bytes, bool, int, float, complex)
_FOLDER = Path(jaxact.__file__).parent
_BEGAN = time.time()


class UnknownError(Exception):
    """A value that cannot be written out completely."""


def key(function: Callable, static: Mapping[str, Any], inputs: Any) -> str | None:
    """The key of a function compiled for inputs like these.

    Args:
        function: at the top level of a module of jaxact.
        static: its static arguments.
        inputs: a tree of arrays.

    Returns:
        None where there is none: something cannot be written out, or the source is not known.
    """
    import jax

    code = _code()
    if code is None:
        return None
    leaves, structure = jax.tree.flatten(inputs)
    settings = {name: getattr(jax.config, name, value) for name, value in jax.config.values.items()}
    settings = {name: value for name, value in settings.items() if "cache" not in name}
    try:
        told = (
            _named(function),
            written(dict(static)),
            written(structure),
            [repr(jax.typeof(leaf)) for leaf in leaves],
            repr(jax.numpy.result_type(float)),
            repr(sorted(settings.items())),
            repr(os.environ.get("XLA_FLAGS")),
            code,
            _surroundings(),
        )
    except UnknownError:
        return None
    return hashlib.sha256(repr(told).encode()).hexdigest()


def written(value: Any) -> str:
    """A static value written out completely: different values never alike.

    Raises:
        UnknownError: it cannot be.
    """
    import numpy as np
    from jax.tree_util import PyTreeDef

    kind = type(value)
    if value is None or kind in _PLAIN:
        return f"{kind.__name__} {value!r}"
    if isinstance(value, Enum):
        return f"{_named(kind)}.{value.name}"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        content = {one.name: getattr(value, one.name) for one in dataclasses.fields(value)}
        return f"{_named(kind)}({written(content)})"
    if kind in (tuple, list):
        return f"{kind.__name__} [{', '.join(map(written, value))}]"
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{written(k)}: {written(v)}' for k, v in value.items())}}}"
    if isinstance(value, (np.ndarray, np.generic)) and not value.dtype.hasobject:
        bits = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return f"array {value.dtype.descr} {value.shape} {bits}"
    if isinstance(value, Path):
        bits = hashlib.sha256(value.read_bytes()).hexdigest() if value.is_file() else "no file"
        return f"path {str(value)!r} {bits}"
    if isinstance(value, PyTreeDef):
        node, inner = value.node_data(), [written(child) for child in value.children()]
        if node is None or node[0] is type(None):
            return "leaf" if node is None else "none"
        return f"tree {_named(node[0])} {written(node[1])} {inner}"
    if isinstance(value, functools.partial):
        return f"partial {written([value.func, list(value.args), value.keywords])}"
    if callable(value):
        return _named(value)
    raise UnknownError(value)


def _named(thing: Any) -> str:
    """A class, or a function at the top level of a module, by its name.

    Raises:
        UnknownError: it is neither, not found under its name, or may change without a trace.
    """
    module, name = str(getattr(thing, "__module__", "")), getattr(thing, "__qualname__", "")
    found = getattr(sys.modules.get(module), name, None)
    itself = found is thing or getattr(found, "__wrapped__", None) is thing
    if not itself or module.partition(".")[0] not in (PACKAGE, *_VERSIONED):
        raise UnknownError(thing)
    return f"{module}:{name}"


def digest(folder: Path) -> str | None:
    """Digest of all Python source below a folder; None where there is none."""
    found = hashlib.sha256()
    paths = sorted(folder.rglob("*.py"))
    for path in paths:
        content = path.read_bytes()
        found.update(f"{path.relative_to(folder).as_posix()} {len(content)} ".encode() + content)
    return found.hexdigest() if paths else None


@functools.cache
def _code() -> str | None:
    return digest(_FOLDER) if unchanged() else None


def unchanged() -> bool:
    """Whether the source is what it was when this process began, which may have read any of it."""
    return all(path.stat().st_mtime < _BEGAN for path in _FOLDER.rglob("*.py"))


@functools.cache
def _surroundings() -> str:
    """What a trace and its compilation depend on beside settings: packages, devices, processor."""
    import jax

    installed: set[str] = set()
    for folder in filter(os.path.isdir, sys.path):
        installed |= {name for name in os.listdir(folder) if name.endswith("-info")}
    devices = [(one.platform, one.device_kind, one.id) for one in jax.local_devices()]
    build = jax.local_devices()[0].client.platform_version
    return repr((sorted(installed), devices, build, platform.python_version(), _processor()))


def _processor() -> str:
    """What the processor can do: a home folder may be that of many machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    told = {line for line in lines if line.startswith(("model name", "flags", "Features"))}
    return " ".join(sorted(told))
