"""The user's cache folder: compiled kernels and programs, and how fast this machine was.

It may be lost at any time. Everything works without it; it is the command line that turns it on.
"""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
from pathlib import Path
from typing import Any

from jaxact import files

_RATES = "rates.json"


def folder() -> Path:
    """The cache folder: `$XDG_CACHE_HOME/jaxact`, or `~/.cache/jaxact`."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "jaxact"


def usable() -> str:
    """Make the cache folder; returns what is wrong with it, "" if it can be used."""
    try:
        folder().mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder()) as probe:
            probe.write(b"x")
    except (OSError, RuntimeError) as error:  # RuntimeError: no home
        return f"{getattr(error, 'strerror', None) or error}"
    return ""


def read_rates() -> dict[str, Any]:
    """What was measured on this machine, by key; empty where nothing was, or it is damaged."""
    with contextlib.suppress(OSError, ValueError, RuntimeError):
        found = json.loads((folder() / _RATES).read_text(encoding="utf-8"))
        if isinstance(found, dict):
            return found
    return {}


def write_rates(rates: dict[str, Any]) -> None:
    """Keep what was measured; silently not where the folder cannot be written."""
    with contextlib.suppress(OSError, RuntimeError):
        with files.replacing(folder() / _RATES) as partial:
            partial.write_text(json.dumps(rates, indent=1), encoding="utf-8")
