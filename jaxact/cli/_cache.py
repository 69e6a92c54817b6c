"""What is compiled is kept from run to run, in the user's cache folder."""

from __future__ import annotations

import importlib.util
import os
import sys
import warnings
from importlib.metadata import entry_points
from pathlib import Path

from jaxact import files
from jaxact.sweeping import cache

_KERNELS = "JAX_COMPILATION_CACHE_DIR"
_PROGRAMS = "JAXACT_PROGRAMS"  # of `jaxact.compilation.programs`, which imports JAX
_FOLDERS = {_KERNELS: "kernels", _PROGRAMS: "programs"}
_SHORTEST = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
_LOUDNESS = "TF_CPP_MIN_LOG_LEVEL"


def prepare(*, wanted: bool = True, quiet: bool = False) -> None:
    """Have whole programs kept, and JAX's kernels where it may use more than the processor.

    To be called before JAX starts. Folders that the user names in the environment are respected.

    Args:
        wanted: False turns both off.
        quiet: do not say, in one line, where the folder cannot be written to and everything is
            compiled anew; of one that others can write to it is said in any case.
    """
    if not wanted:
        for name in _FOLDERS:
            os.environ.pop(name, None)
        return
    names = _FOLDERS if _accelerated() else (_PROGRAMS,)
    missing = [name for name in names if name not in os.environ]
    reason = cache.usable() if missing else ""
    if reason:
        if not quiet:
            silent = "compiling anew, --no-cache does so silently"
            _say(cache.folder(), f"cannot be used as cache ({reason}); {silent}")
        return
    for name in missing:
        os.environ[name] = str(cache.folder() / _FOLDERS[name])
    _drop_shared(missing)
    os.environ.setdefault(_SHORTEST, "0.3")
    # XLA tells of every kernel it loads which CPU it was compiled for
    os.environ.setdefault(_LOUDNESS, "3")
    # a full or damaged cache costs time, no results
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation")


def _drop_shared(ours: list[str]) -> None:
    """Keep nothing where others can write: it is run, and they could run anything as this user.

    Args:
        ours: variables of folders that the user has not named; JAX's own is checked if it is one.
    """
    if ours and (reason := files.shared(cache.folder())):
        _say(cache.folder(), f"{reason}; compiling anew")
        for name in ours:
            del os.environ[name]
    for name in dict.fromkeys([*ours, _PROGRAMS]):
        if name in os.environ and (reason := files.shared(Path(os.environ[name]))):
            _say(Path(os.environ[name]), f"{reason}; compiling anew")
            del os.environ[name]


def _say(folder: Path, reason: str) -> None:
    print(f"jaxact: {folder}: {reason}", file=sys.stderr)


def _accelerated() -> bool:
    """Whether JAX may find a GPU or the like; programs of the processor only can be kept whole."""
    if os.environ.get("JAX_PLATFORMS") == "cpu":
        return False
    return bool(entry_points(group="jax_plugins") or importlib.util.find_spec("jax_plugins"))
