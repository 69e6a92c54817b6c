"""The specification that a report is of, which need not vary anything."""

from __future__ import annotations

import tomllib
from pathlib import Path

from jaxact.loops import reading
from jaxact.loops.axes import NO_AXIS
from jaxact.loops.specification import Specification


def load(path: Path) -> tuple[Specification, str]:
    """Read a specification of a sweep or of a single loop, and its text as it is to be shown.

    Args:
        path: TOML file. Where it has no axes, the only one is `NO_AXIS`.

    Raises:
        UserError: as `jaxact.loops.reading.load`.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        document = tomllib.loads(text)
    except (OSError, ValueError, RecursionError):
        document = {}  # what is wrong with it is said below
    if "axes" in document or not {"parameters", "plant"} & document.keys():
        found = reading.load(path)
        return found, found.text
    return reading.load(path, [f"axes.{NO_AXIS.name}={NO_AXIS.document}"]), text
