"""Gains in jaxact's own TOML, and in MJCF."""

from __future__ import annotations

import math
import tomllib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from pathlib import Path

from jaxact.errors import UserError, shown
from jaxact.gains.deployment import number
from jaxact.gains.table import FORCE_HIGH, FORCE_LOW, READ, Entry, GainFile, tell_shadowed
from jaxact.parameters import DELAY, FORCE_LIMIT, KD, KP, PARAMETERS, canonical

# What a position actuator may act on in place of a joint.
_OTHER_TARGETS = (
    "tendon", "jointinparent", "site", "refsite", "body", "cranksite", "slidersite",
)  # fmt: skip
# What a <default> may have that is none of actuators; these share their defaults.
_OTHER_DEFAULTS = (
    "default", "mesh", "material", "joint", "geom", "site", "camera", "light", "pair", "equality",
    "tendon",
)  # fmt: skip
_NOT_TAKEN = {
    "limits of its setpoints": ("ctrlrange", "inheritrange"),
    "filters and delays of its setpoints": ("timeconst", DELAY),
}


def toml(path: Path, text: str) -> GainFile:
    """Tables `[kp]` and `[kd]`, or one of them, and perhaps `[force_limit]`: joint = number.

    A joint may be a pattern.

    Raises:
        UserError: it is not TOML, or has no such tables.
    """
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise UserError(f"{path}: is not TOML: {error}") from None
    tables = {name: document[name] for name in READ if isinstance(document.get(name), Mapping)}
    if not {KP, KD} & set(tables):
        if isinstance(document.get("gains"), Mapping):
            raise UserError(
                f"{path}: has the gains of a single joint; give them with --kp and --kd"
            )
        raise UserError(f"{path}: has no table [kp] or [kd] of joint = number")
    entries = tuple(
        Entry(name, key, number(path, f"{name}.{key}", value))
        for name, table in tables.items()
        for key, value in table.items()
    )
    for name, table in tables.items():
        tell_shadowed(f"{path}: {name}", table)
    others = {name: canonical(name) for name, table in document.items() if isinstance(table, dict)}
    left = [name for name, own in others.items() if own in PARAMETERS and own not in READ]
    notes = (f"not taken, to be given as parameters: {', '.join(left)}",) if left else ()
    return GainFile(path, "toml", entries, "pattern", notes)


def mjcf(path: Path, text: str) -> GainFile:
    """Position actuators, of a whole model or of an `<actuator>` section alone.

    Raises:
        UserError: it is not MJCF, or has no position actuators with gains.
    """
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UserError(f"{path}: is not XML: {error}") from None
    if root.tag not in ("mujoco", "mujocoinclude"):
        raise UserError(f"{path}: <{shown(root.tag)[1:-1]}> is not MJCF; gains are read from MJCF")
    whole = root.find("worldbody") is not None or root.find("include") is not None
    entries = tuple(_of_model(path) if whole else _of_section(path, root))
    notes = () if whole else tuple(_not_taken(root))
    if not any(one.parameter == KP for one in entries):
        raise UserError(f"{path}: has no position actuators with gains")
    return GainFile(path, "mjcf", entries, "name", notes)


def _of_model(path: Path) -> Iterator[Entry]:
    """Gains at the joints, as MuJoCo compiles them, classes and gears and all."""
    from jaxact.robots import model

    for joint in model.read(path).joints:
        if math.isnan(joint.kp) or math.isnan(joint.kd):
            continue
        yield Entry(KP, joint.name, joint.kp)
        yield Entry(KD, joint.name, joint.kd)
        yield from _limits(joint.name, joint.force_low, joint.force_high)


def _not_taken(root: ElementTree.Element) -> Iterator[str]:
    """What a section says besides gains and limits of the force, in words."""
    servos = root.findall("actuator/position")
    for what, keys in _NOT_TAKEN.items():
        found = [key for key in keys if any(one.get(key) for one in servos)]
        if found:
            yield f"{what} ({', '.join(found)}) are not taken"
    others = [one for one in root.iterfind("actuator/*") if one.tag not in ("position", "motor")]
    if others:
        named = [f"<{one.tag} {_label(one)}>" for one in others]
        yield f"its other actuators are not taken: {', '.join(named)}"


def _label(one: ElementTree.Element) -> str:
    """The joint of an actuator, or its name, as in the file."""
    key = "joint" if one.get("joint") else "name"
    return f"{key}={one.get(key)!r}"


def _demand_complete(path: Path, root: ElementTree.Element) -> None:
    """Raise UserError where a class or the robot's tree has a part in the gains of a section."""
    for one in root.iterfind("default/*"):
        if one.tag not in _OTHER_DEFAULTS:
            raise UserError(
                f"{path}: its <default> has <{shown(one.tag)[1:-1]}>, which counts for actuators;"
                " give the whole model"
            )
    for one in root.iterfind("actuator/position"):
        own = [key for key in ("class", *_OTHER_TARGETS) if one.get(key)]
        if own:
            raise UserError(
                f"{path}: <position {_label(one)}> has a {own[0]}; give the whole model, which"
                " says what that is"
            )


def _of_section(path: Path, root: ElementTree.Element) -> Iterator[Entry]:
    """Gains at the joints of elements that say all themselves."""
    _demand_complete(path, root)
    taken: set[str] = set()
    for one in root.iterfind("actuator/position"):
        name = one.get("joint") or one.get("name")
        if name is None:
            raise UserError(f"{path}: a <position> has no joint; name it")
        where = f"<position joint={name!r}>"
        if name in taken:
            raise UserError(f"{path}: has several {where}, whose forces add up; leave one of them")
        taken.add(name)
        gear = _number(path, where, "gear", one.get("gear", "1"))
        for parameter, key in ((KP, KP), (KD, "kv")):
            value = one.get(key)
            if value is None:
                raise UserError(
                    f"{path}: {where} has no {key}; give the whole model if a class has it"
                )
            yield Entry(parameter, name, _number(path, where, key, value) * gear**2)
        if one.get("forcelimited") != "false" and one.get("forcerange"):
            low, high = sorted(gear * end for end in _pair(path, where, one.get("forcerange", "")))
            yield from _limits(name, low, high)


def _limits(joint: str, low: float, high: float) -> Iterator[Entry]:
    """The force limit of a joint, or its range where that differs by direction."""
    if high != -low:
        yield Entry(FORCE_LOW, joint, low)
        yield Entry(FORCE_HIGH, joint, high)
    elif math.isfinite(high):
        yield Entry(FORCE_LIMIT, joint, high)


def _number(path: Path, where: str, key: str, text: str) -> float:
    """The first of the numbers of an attribute."""
    try:
        return float(text.split()[0])
    except (ValueError, IndexError):
        raise UserError(f"{path}: {where}: {key} = {shown(text)} is not a number") from None


def _pair(path: Path, where: str, text: str) -> tuple[float, float]:
    parts = text.split()
    if len(parts) != 2:
        raise UserError(f"{path}: {where}: forcerange = {shown(text)}; give two numbers")
    return _number(path, where, "forcerange", parts[0]), _number(
        path, where, "forcerange", parts[1]
    )
