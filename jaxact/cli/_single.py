"""The specification of one loop from the command line: a file, then --set, then the options."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxact.cli import _loops
from jaxact.errors import UserError
from jaxact.loops.specification import Specification


def specification(
    path: Path | None,
    overrides: tuple[str, ...],
    static: Mapping[str, Any],
    plant: Mapping[str, str],
    given: Mapping[str, Any],
    *,
    push: Mapping[str, Any] | None = None,
    duration: float = 1.0,
) -> Specification:
    """The loop to simulate.

    path: of a specification of a sweep, whose fixed values are taken; None for none
    overrides: `key=value` each, of that file, or of the robot
    static: options of the whole sweep that were given
    plant: keys of the robot that were given
    given: parameters that were given
    push: keys of the push, None where none was given
    duration: where nothing gives one [s]

    Raises UserError for overrides with neither, and as `jaxact.loops.reading`.
    """
    if path is None and overrides and not plant:
        raise UserError("--set changes a specification; give one with --spec, or use the options")
    tables: dict[str, Any] = {} if push is None else {"push": dict(push)}
    if path is None:
        single = static.get("engine") == "warp" or "engine=warp" in overrides  # it knows no other
        defaults = {"precision": "float32" if single else "float64", "duration": duration}
        tables |= {"plant": dict(plant)} if plant else {}
        document = {**defaults, **static, **tables, "parameters": dict(given)}
        return _loops.specified(document, overrides)
    base = _loops.nominal_of(path, overrides).document | tables
    if plant:
        base["plant"] = base.get("plant", {}) | dict(plant)
    if "actuator" in given:
        for name in ("wn", "zeta"):
            base["parameters"].pop(name, None)
    elif {"wn", "zeta"} & set(given):
        base["parameters"] |= _loops.without_preset(base["parameters"].pop("actuator", None))
    fixed = base["parameters"] | dict(given)
    return _loops.specified({**base, **static, "parameters": fixed, "axes": {}, "sampling": None})
