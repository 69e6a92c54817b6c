"""Which configurations of robots a Python source has, once it has been followed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from jaxact.gains import configurations
from jaxact.gains.source_values import (
    Thing,
    Unknown,
    UnknownError,
    inherited,
    lineage,
    names_of,
    plain,
    reachable,
)

_GAINS = ("stiffness", "damping")
_SET = frozenset((*_GAINS, *configurations.LIMITS))


@dataclass(frozen=True)
class Group:
    """Actuators that are alike.

    Attributes:
        label: what the source calls them.
        thing: that has their fields.
        around: fields of those that it stands in, such as the delay of a wrapper.
        listed: it stands in a list or table, so it is part of a robot's configuration.
    """

    label: str
    thing: Thing
    around: Mapping[str, Any] = field(default_factory=dict)
    listed: bool = False


@dataclass(frozen=True)
class Robot:
    """A configuration: its groups, or what legged_gym's class sets; `problem` says why neither."""

    groups: tuple[Group, ...] = ()
    control: Thing | None = None
    init: Any = None
    problem: Unknown | None = None


def robots(names: Mapping[str, Any]) -> tuple[dict[str, Robot], dict[str, Robot]]:
    """Configurations of the names of a module, and single groups of actuators beside them."""
    whole: dict[str, Robot] = {}
    single: dict[str, Robot] = {}
    for label, value in names.items():
        if isinstance(value, Unknown):
            if robots({label: value.before})[0]:
                whole[label] = Robot(problem=value)
        elif isinstance(value, Thing) and value.kind == "class":
            found = _of_class(value)
            if found is not None:
                whole[label] = found
        elif isinstance(value, Thing):
            parts = list(_groups(value, Group(label, value), set()))
            problem = next((one for one in parts if isinstance(one, Unknown)), None)
            groups = tuple(one for one in parts if isinstance(one, Group))
            listed = problem is not None and not groups or any(one.listed for one in groups)
            if parts:
                (whole if listed else single)[label] = Robot(groups, problem=problem)
    return whole, single


def fields(group: Group) -> dict[str, Any]:
    """The fields of a group; of those that are not gains it may only be known that they are there.

    Raises:
        UnknownError: a pattern or a gain is worked out.
    """
    found: dict[str, Any] = {}
    for key, value in {**group.around, **group.thing.content}.items():
        try:
            found[key] = plain(value)
        except UnknownError:
            if key in (*configurations.PATTERNS, *_GAINS):
                raise
            found[key] = configurations.WORKED_OUT
    return found


def control(robot: Robot) -> dict[str, Any]:
    """What legged_gym's `control` sets, and the positions at rest.

    Raises:
        UnknownError: a gain is worked out, or another file has it.
    """
    of = robot.control
    assert of is not None
    found: dict[str, Any] = {}
    for key in names_of(of):
        value = inherited(of, key)
        if key.startswith("__") or isinstance(value, Thing) and value.kind in ("class", "function"):
            continue
        try:
            found[key] = plain(value)
        except UnknownError:
            if key in _GAINS:
                raise
            found[key] = configurations.WORKED_OUT
    for key in _GAINS:
        value = inherited(of, key)
        if isinstance(value, Unknown):
            raise UnknownError(value)
    if isinstance(robot.init, Thing) and "default_joint_angles" in names_of(robot.init):
        found["default_joint_angles"] = configurations.WORKED_OUT
    return found


def _of_class(of: Thing) -> Robot | None:
    """legged_gym's: it reads `control` and no other class inside."""
    own = inherited(of, "control")
    if isinstance(own, Unknown) and not own.outside:
        may = any("control" in one.content or _inner(one) for one in lineage(of)) or _has(of)
        return Robot(problem=own) if may else None
    if isinstance(own, Thing) and own.kind == "class" and _has(own):
        return Robot(control=own, init=inherited(of, "init_state"))
    if _has(of):
        return Robot(control=of)
    inner = [one for one in _inner(of) if one is not own]
    if len(inner) > 1:
        names = ", ".join(one.name for one in inner)
        said = f"has several classes with gains in `{of.name}` ({names}), and none is `control`"
        return Robot(problem=Unknown(of.line, said))
    return Robot(control=inner[0]) if inner else None


def _has(of: Thing) -> bool:
    """Whether a class sets tables of gains, or in a way that is not followed."""
    own = [one.content.get(key) for key in _GAINS for one in lineage(of)]
    return any(isinstance(one, Unknown | Thing) for one in own)


def _inner(of: Thing) -> list[Thing]:
    found = []
    for one in of.content.values():
        if isinstance(one, Thing) and one.kind == "class":
            found += [one] if all(key in names_of(one) for key in _GAINS) else _inner(one)
    return found


def _is_group(of: Thing) -> bool:
    return any(key in of.content for key in configurations.PATTERNS)


def _groups(value: Any, place: Group, seen: set[int]) -> Iterator[Group | Unknown]:
    """Groups in a value, each once, and what keeps others from being known."""
    if not isinstance(value, Thing) or id(value) in seen:
        return
    seen.add(id(value))
    if value.kind in ("class", "function"):
        return
    if _is_group(value):
        if value.doubt is not None:
            yield value.doubt
        yield Group(place.label, value, place.around, place.listed)
        return
    if not any(_is_group(one) for one in reachable(value)) and "actuators" not in value.content:
        return
    around = {k: v for k, v in value.content.items() if k in configurations.NOT_TAKEN}
    around = {**place.around, **around} if value.kind == "made" else dict(place.around)
    listed = place.listed or value.kind in ("list", "table")
    if value.doubt is not None:
        yield value.doubt
    if value.kind == "made" and _SET & set(value.content):
        yield Unknown(value.line, f"wraps actuators in `{value.name}`, which sets gains as well")
    for key, part in [*value.content.items(), *((None, one) for one in value.others)]:
        label = key if value.kind == "table" and isinstance(key, str) and key else place.label
        yield from _groups(part, Group(label, value, around, listed), seen)
        if value.kind == "made" and key == "actuators":
            yield from _left_out(part)


def _left_out(actuators: Any) -> Iterator[Unknown]:
    """Entries of `actuators` that are not groups which can be told."""
    if isinstance(actuators, Unknown):
        yield actuators
    elif isinstance(actuators, Thing):
        if actuators.doubt is not None:
            yield actuators.doubt
        for one in actuators.content.values() if actuators.kind in ("list", "table") else ():
            if isinstance(one, Unknown):
                yield one
            elif not isinstance(one, Thing) or not list(_groups(one, Group("", one), set())):
                yield Unknown(getattr(one, "line", actuators.line))
