"""Loops listed in a TOML file, one below the other: `[[loop]]` tables of parameters.

A table may name an identified drive, `drive = "drive.toml"`, which says what the table does not.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jaxact.errors import UserError, shown
from jaxact.loops import drives
from jaxact.loops.checks import check_history
from jaxact.loops.drives import DRIVE
from jaxact.loops.given import read
from jaxact.parameters import CONTROL_RATE, PARAMETERS

_RATE = CONTROL_RATE
_VELOCITY = "velocity"
_NO_NUMBERS = ("name", _VELOCITY, DRIVE)


def rows(path: Path) -> list[dict[str, Any]] | None:
    """The tables of a file of loops; None where it is a specification.

    Raises:
        UserError: the file cannot be read, or what it lists are not tables.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "is not UTF-8 text"
        raise UserError(f"{path}: cannot be read ({reason}); give a TOML file of loops") from None
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: is not valid TOML: {str(error)[:200]}") from None
    found = document.get("loop")
    if found is None:
        return None
    if not isinstance(found, list) or not found or not all(isinstance(r, dict) for r in found):
        raise UserError(
            f"{path}: loop is not a list of tables; write [[loop]] above each loop's keys"
        )
    return found


def values(
    path: Path, tables: Sequence[Mapping[str, Any]], given: Mapping[str, Any]
) -> tuple[list[str], dict[str, np.ndarray], str | None]:
    """Names of the loops, every parameter that is given of one of them, shape (n,) each, and the
    unit of their drives, None where none has one.

    Args:
        path: of the file, for messages.
        tables: from `rows`.
        given: parameter (or `actuator`, or `drive`) -> value, of what a table does not say itself.

    Raises:
        UserError: an unknown parameter, a value out of bounds, a delay too long to keep, or drives
            of joints that slide beside those of rotary ones.
    """
    common = read({name: v for name, v in given.items() if name != DRIVE}, robot=False)
    names, filled, units = [], [], set()
    for index, table in enumerate(tables):
        key = f"{path}: loop[{index}]"
        name = table.get("name", f"loop {index}")
        if not isinstance(name, str):
            raise UserError(f"{key}.name = {shown(name)} is not text")
        own = common | _read(key, {k: v for k, v in table.items() if k not in _NO_NUMBERS})
        drive = _drive(key, path, table) or given.get(DRIVE)
        if drive is not None:
            known = drives.taken(drive)
            units.add(known.unit)
            own = drives.filled(known.moving(own).parameters(), own)
        if _RATE in own:
            every = {name: parameter.default for name, parameter in PARAMETERS.items()} | own
            check_history(every, every[_RATE], f"{key}: ")
        names.append(name)
        filled.append(own)
    if len(units) > 1:
        raise UserError(f"{path}: some drives are of joints that slide, others of rotary ones")
    kept = dict.fromkeys(name for own in filled for name in own)
    rows = {
        name: np.array([own.get(name, PARAMETERS[name].default) for own in filled]) for name in kept
    }
    return names, rows, next(iter(units), None)


def velocity(
    path: Path, tables: Sequence[Mapping[str, Any]], given: Mapping[str, Any]
) -> str | None:
    """The velocity that the controllers see by their tables, or by their drives; None for unsaid.

    Args:
        path, tables, given: as for `values`.

    Raises:
        UserError: it is not the same of all.
    """
    found = set()
    for index, table in enumerate(tables):
        drive = _drive(f"{path}: loop[{index}]", path, table) or given.get(DRIVE)
        by_drive = None if drive is None else drives.taken(drive).velocity
        found.add(str(table.get(_VELOCITY, by_drive or "sampled")))
    if len(found) > 1:
        raise UserError(
            f"{path}: the controllers of some loops difference positions, of others not; give one"
            ' `velocity`, "sampled" or "differenced"'
        )
    return next(iter(found), None)


def _drive(key: str, path: Path, table: Mapping[str, Any]) -> Path | None:
    """The file of a loop's drive, relative to that of the loops."""
    given = table.get(DRIVE)
    if given is not None and not isinstance(given, str):
        raise UserError(f"{key}.{DRIVE} = {shown(given)} is not a path of a drive")
    return None if given is None else path.parent / given


def _read(key: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """The parameters of one loop, numbers all of them."""
    several = [name for name, value in table.items() if isinstance(value, list | dict)]
    if several:
        raise UserError(f"{key}.{several[0]} = {shown(table[several[0]])}; give one value")
    try:
        return read(table, robot=False)
    except UserError as error:
        raise UserError(f"{key}.{str(error).replace('`', '')}") from None
