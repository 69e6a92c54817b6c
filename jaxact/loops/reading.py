"""Reading a specification: TOML text and overrides in, checked, or one clear line out.

Nothing here needs JAX, so that a mistake is told at once.
"""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from jaxact import engines
from jaxact.errors import UserError, nearest, shown
from jaxact.gains import table as gains_table
from jaxact.loops import anew, checks, drives, toml
from jaxact.loops.axes import read_axis
from jaxact.loops.drives import DRIVE
from jaxact.loops.specification import (
    OPTIONS,
    SECTIONS,
    TABLES,
    Motion,
    Plant,
    Push,
    Sampling,
    Specification,
)
from jaxact.parameters import (
    INERTIA,
    MASS,
    PARAMETERS,
    SHARED,
    as_number,
    base,
    canonical,
    check,
    check_actuator,
    known,
)

_WORD = re.compile(r"[^\W\d][\w.-]*")
Section = TypeVar("Section")


def load(path: Path, overrides: Sequence[str] = (), drive: Path | None = None) -> Specification:
    """Read and check a specification file.

    Args:
        path: TOML file; a model or a drive that it names is relative to its folder.
        overrides: `key=value` each, applied over the file and checked like it.
        drive: file of an identified drive in place of the one that it names.

    Raises:
        UserError: it names the file or the override, the key, what was given, what is allowed.
    """
    try:
        document = _canonical(given := toml.read(path))
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    overridden = _overridden(document, overrides, _has_inertia(given))
    document |= {} if drive is None else {DRIVE: str(drive.resolve())}
    try:
        return _checked(document, path.parent)
    except UserError as error:
        where = "--set" if _blames(str(error), overridden) else path
        raise UserError(f"{where}: {error}") from None


def parse(text: str, folder: Path = Path(), overrides: Sequence[str] = ()) -> Specification:
    """Read and check a specification from TOML text.

    Args:
        text: as in a file.
        folder: what the paths of a model and of a drive are relative to.
        overrides: as for `load`.

    Raises:
        UserError: as `load`.
    """
    document = _canonical(given := toml.loads(text))
    _overridden(document, overrides, _has_inertia(given))
    return _checked(document, folder)


def _overridden(document: dict[str, Any], overrides: Sequence[str], rotary: bool) -> list[str]:
    """Apply overrides to a document, rotary if it has an inertia; the keys that they went to."""
    try:
        keys = []
        for override in overrides:
            keys.append(_apply(document, override))
            key = override.partition("=")[0]
            words = re.findall(r"\w+", override if key.strip() in SECTIONS else key)
            rotary = INERTIA in words or (rotary and MASS not in map(canonical, words))
        if rotary and document.get("unit") == "m":
            raise UserError("unit=m: an inertia is of a rotary joint; leave it out, or give mass")
    except UserError as error:
        raise UserError(f"--set {error}") from None
    return keys


def _checked(document: Mapping[str, Any], folder: Path) -> Specification:
    if DRIVE in document:
        file = _file(document[DRIVE], folder, DRIVE, "a file of jaxact identify")
        document = drives.written_out(document, drives.load_drive(file))
    specification = _build(document, folder)
    checks.check(specification)
    return specification


def _blames(message: str, overridden: Iterable[str]) -> bool:
    """Whether a message is about a key that an override gave."""
    key = re.split(r"[ :=\[]", message, maxsplit=1)[0]
    return bool(key) and any(
        full.startswith(key) or key.startswith(full) or key in full.split(".")
        for full in overridden
    )


def _canonical(document: Mapping[str, Any]) -> dict[str, Any]:
    """The document with short parameter names, its sections tables that are there."""
    result = dict(document)
    if "unit" in _keys(result.get("parameters")):  # said among the parameters, as on a command line
        own = dict(result["parameters"])
        result |= {"unit": own.pop("unit"), "parameters": own}
    _say_rotary(result, _has_inertia(result))
    for section in SECTIONS[:2]:
        table = result.get(section, {})
        if not isinstance(table, dict):
            raise UserError(
                f"{section} = {shown(table)} is not a table; write [{section}] above its keys"
            )
        result[section] = _named(section, table)
    return result


def _has_inertia(document: Mapping[str, Any]) -> bool:
    """Whether a document says inertia where it could say mass."""
    return any(INERTIA in _keys(document.get(section)) for section in SECTIONS[:2])


def _keys(table: Any) -> tuple[str, ...]:
    return tuple(table) if isinstance(table, dict) else ()


def _say_rotary(document: dict[str, Any], inertia: bool) -> None:
    """An inertia given for the mass says that the joint is rotary."""
    if not inertia:
        return
    if "plant" in document:
        raise UserError("inertia: only for a single joint; a robot's inertias are its model's")
    if document.get("unit") == "m":
        raise UserError('inertia: is that of a rotary joint; drop unit = "m", or give mass')
    document["unit"] = "rad"


def _named(section: str, table: Mapping[str, Any]) -> dict[str, Any]:
    """A section with short names; `kp = { ".*_knee" = 300 }` as `kp@.*_knee = 300`."""
    named: dict[str, Any] = {}
    for given, value in table.items():
        name = canonical(given)
        spread = {name: value}
        if isinstance(value, dict) and name in PARAMETERS and section == "parameters":
            spread = {f"{name}@{pattern}": inner for pattern, inner in value.items()}
            gains_table.tell_shadowed(name, value)
        for key, inner in spread.items():
            if key in named:
                raise UserError(f"{section}.{given}: the same parameter is given twice; remove one")
            named[key] = inner
    return named


def _apply(document: dict[str, Any], override: str) -> str:
    """Put one `key=value` into the document; returns the full key it went to."""
    given, equals, text = override.partition("=")
    keys = [part.strip() for part in given.split(".")]
    if not equals or not all(keys):
        raise UserError(f"{shown(override)}: write it as key=value, e.g. kp=400")
    value = _literal(text.strip(), override)
    if "@" in given:  # a pattern may hold dots
        section, dot, rest = given.strip().partition(".")
        keys = [section, rest] if dot and section in SECTIONS[:2] else [given.strip()]
    if keys == ["damping"] and value in ("joint", "drive"):
        raise UserError(f"{shown(override)}: of a robot, write it as plant.damping={value}")
    _say_rotary(document, INERTIA in keys)
    if len(keys) == 1 and keys[0] not in (*OPTIONS, *SECTIONS, DRIVE):
        name = canonical(keys[0])
        if not known(name) and name != "actuator":
            raise UserError(_unknown(keys[0], (*OPTIONS, *PARAMETERS, "actuator", DRIVE)))
        varied = isinstance(value, list | dict)
        if not varied:
            document["axes"].pop(name, None)
        elif "@" in name:  # a fixed value would keep its place among others
            document["parameters"].pop(name, None)
        keys = ["axes" if varied else "parameters", name]
    elif len(keys) > 1 and keys[0] in SECTIONS[:2]:
        keys[1] = canonical(keys[1])
    if len(keys) == 2 and keys[0] in SECTIONS[:2]:  # given anew: the last key counts
        _drop_replaced(document, *keys)
    table = document
    for key in keys[:-1]:
        table = table.setdefault(key, {})
        if not isinstance(table, dict):
            raise UserError(f"{shown(override)}: {key} is not a table, it has no keys in it")
    table[keys[-1]] = value
    document |= _canonical(document)  # a whole section may have been given
    return ".".join(keys)


def _drop_replaced(document: dict[str, Any], section: str, name: str) -> None:
    """Leave out what a parameter that goes to this section replaces."""
    for part in SECTIONS[:2]:
        for key in _keys(document[part]):
            if anew.replaced(key, (name,)) and (key != name or part == section):
                del document[part][key]


def _literal(text: str, override: str) -> Any:
    """A TOML value; a bare word is taken as a string, so that the shell needs no second quotes."""
    if _WORD.fullmatch(text) and text not in ("true", "false", "inf", "nan"):
        return text
    try:
        if "\n" in text or "\r" in text:
            raise ValueError
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        raise UserError(
            f"{shown(override)}: {shown(text)} is not a value; write a number, a word,"
            " a list [1, 2] or a range {min=1, max=10, num=5}"
        ) from None


def _build(document: Mapping[str, Any], folder: Path) -> Specification:
    """The specification that a document with canonical names describes; raises UserError."""
    for key in document:
        if key not in (*OPTIONS, *SECTIONS):
            raise UserError(_unknown(key, (*OPTIONS, DRIVE, *SECTIONS)))
    options = {key: document[key] for key in OPTIONS if key in document}
    options |= {t: TABLE_READERS[t](document[t], folder) for t in TABLES if t in document}
    if "plant" in options:
        options.setdefault("engine", "auto")
    engines.check_name(options.get("engine"), robot="plant" in options, margins=True)
    drawn = document.get("sampling")
    sampling = None if drawn is None else _filled(Sampling, "sampling", drawn)
    parameters = _parameters(document["parameters"])
    axes = tuple(
        read_axis(name, given, sampled=sampling is not None)
        for name, given in _known_parameters("axes", document["axes"])
    )
    try:
        return Specification(**options, parameters=parameters, axes=axes, sampling=sampling)
    except ValidationError as error:
        raise UserError(explained(error)) from None


def _known_parameters(section: str, table: Mapping[str, Any]) -> Iterable[tuple[str, Any]]:
    for name in table:
        if not known(name) and name != "actuator":
            raise UserError(_unknown(name, (*PARAMETERS, "actuator"), f"{section}."))
    return table.items()


def _wrong_pattern(key: str, name: str) -> str:
    """What is wrong with a parameter for some joints."""
    if name in SHARED:
        return f"{key}: {name} is one number for all joints; write {name} alone"
    return f"{key}: what follows the @ is not a regular expression; write e.g. {name}@.*_knee"


def _parameters(table: Mapping[str, Any]) -> dict[str, float | str]:
    return {
        name: check_actuator(value, f"parameters.{name}")
        if name == "actuator"
        else check(name, value, f"parameters.{name}")
        for name, value in _known_parameters("parameters", table)
    }


def _filled(kind: type[Section], section: str, table: Any, **changed: Any) -> Section:
    """A section as the dataclass that describes it."""
    if not isinstance(table, dict):
        raise UserError(
            f"{section} = {shown(table)} is not a table; write [{section}] above its keys"
        )
    names = tuple(field.name for field in dataclasses.fields(kind))  # type: ignore[arg-type]
    for key in table:
        if key not in names:
            raise UserError(_unknown(key, names, f"{section}."))
    try:
        return kind(**{**table, **changed})
    except ValidationError as error:
        raise UserError(explained(error, f"{section}.")) from None


def _plant(table: Any, folder: Path) -> Plant:
    readers: dict[str, Callable[[Any], Any]] = {
        "model": lambda given: _file(given, folder, "plant.model", "an MJCF or URDF file"),
        "gains": lambda given: _gains(given, folder),
        "joints": _patterns,
    }
    changed = {key: read(table[key]) for key, read in readers.items() if key in _keys(table)}
    return _filled(Plant, "plant", table, **changed)


def _gains(given: Any, folder: Path) -> str:
    """A file of gains, perhaps with the name of one of its configurations behind a colon."""
    name = gains_table.split(folder / given)[1] if isinstance(given, str) else None
    if name is None:
        return str(_file(given, folder, "plant.gains", "a file of gains"))
    return f"{_file(given[: -len(name) - 1], folder, 'plant.gains', 'a file of gains')}:{name}"


def _patterns(given: Any) -> tuple[str, ...]:
    """Patterns of joint names: one, or a list."""
    patterns = (given,) if isinstance(given, str) else given
    if not isinstance(patterns, list | tuple) or not patterns:
        raise UserError(f"plant.joints = {shown(given)}; allowed: a list of patterns of names")
    for pattern in patterns:
        try:
            re.compile(pattern)
        except (re.error, TypeError):
            raise UserError(
                f"plant.joints: {shown(pattern)} is not a regular expression; write e.g. '.*_knee'"
            ) from None
    return tuple(patterns)


def _motion(table: Any, folder: Path) -> Motion:
    if "file" not in _keys(table):
        return _filled(Motion, "motion", table)
    file = _file(table["file"], folder, "motion.file", "a CSV or NPZ file")
    return _filled(Motion, "motion", table, file=file)


def _push(table: Any, folder: Path) -> Push:
    changed: dict[str, Any] = {}
    if "impulse" in _keys(table):
        given = table["impulse"]
        numbers = [as_number(item) for item in given] if isinstance(given, list | tuple) else []
        if len(numbers) != 3 or not all(item is not None and abs(item) <= 1e9 for item in numbers):
            raise UserError(f"push.impulse = {shown(given)}; allowed: three numbers [N s]")
        changed["impulse"] = tuple(numbers)
    return _filled(Push, "push", table, **changed)


TABLE_READERS = {"plant": _plant, "motion": _motion, "push": _push}


def _file(given: Any, folder: Path, key: str, kind: str) -> Path:
    if not isinstance(given, str) or not given or "\0" in given:
        raise UserError(f"{key} = {shown(given)} is not a path of {kind}")
    path = folder / given
    try:
        there = path.is_file()
    except OSError:
        there = False
    if not there:
        raise UserError(f"{key} = {shown(given)}: no such file (relative to the specification)")
    return path


def _unknown(key: str, names: Iterable[str], prefix: str = "") -> str:
    """What to say of a key that is not known where it stands."""
    name = canonical(key)
    if "@" in name and base(name) in PARAMETERS and not known(name):
        return _wrong_pattern(f"{prefix}{name}", base(name))
    if not prefix and (base(name) in PARAMETERS or name == "actuator"):
        return f"{key}: is a parameter; write it below [parameters], or below [axes] to vary it"
    if not prefix and key in ("model", "keyframe", "joints", "base"):
        return f"{key}: belongs to the robot; write it below [plant]"
    if prefix and key in OPTIONS:
        return f"{prefix}{key}: is an option of the whole sweep; write it above all [sections]"
    return f"{prefix}{shown(key)[1:-1]}: unknown key; {nearest(key, names)}"


def explained(error: ValidationError, prefix: str = "") -> str:
    """The first complaint of pydantic in the words of every other message.

    Args:
        error: of a specification or a section of it.
        prefix: of the key that it names.
    """
    first = error.errors(include_url=False)[0]
    key = prefix + str(first["loc"][0])
    said = (
        first["msg"]
        .replace("Input should be", "allowed:")
        .replace("a valid integer", "a whole number")
        .replace("a valid ", "a ")
    )
    if first["type"] in ("missing", "missing_argument"):
        return f"{key} is missing"
    if first["type"] == "literal_error":
        words = re.findall(r"'([^']*)'", first["ctx"]["expected"])
        said = nearest(first["input"], words)
    return f"{key} = {shown(first['input'])}; {said}"
