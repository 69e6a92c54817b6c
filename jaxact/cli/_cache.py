"""Compiled kernels kept from run to run, in the user's cache folder."""

from __future__ import annotations

import os
import sys
import warnings

from jaxact.sweep import cache

_FOLDER = "JAX_COMPILATION_CACHE_DIR"
_SHORTEST = "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"
_LOUDNESS = "TF_CPP_MIN_LOG_LEVEL"


def prepare(*, wanted: bool = True, quiet: bool = False) -> None:
    """Turn JAX's compilation cache on, before JAX starts; the user's own settings are respected.

    wanted: False turns it off
    quiet: do not say, in one line, where the folder cannot be used and everything is compiled anew
    """
    if not wanted:
        os.environ.pop(_FOLDER, None)
        return
    if _FOLDER not in os.environ:
        reason = cache.usable()
        if reason and quiet:
            return
        if reason:
            print(
                f"jaxact: {cache.folder()}: cannot be used as cache ({reason}); compiling anew,"
                " --no-cache does so silently",
                file=sys.stderr,
            )
            return
        os.environ[_FOLDER] = str(cache.folder() / "kernels")
    os.environ.setdefault(_SHORTEST, "0.3")
    # XLA tells of every kernel it loads which CPU it was compiled for
    os.environ.setdefault(_LOUDNESS, "3")
    # a full or damaged cache costs time, no results
    warnings.filterwarnings("ignore", message="Error (reading|writing) persistent compilation")
