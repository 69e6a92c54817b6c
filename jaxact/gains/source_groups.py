"""Groups of actuators in the values of a Python source that has been followed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from jaxact.gains import configurations
from jaxact.gains.source_values import Thing, Unknown, UnknownError, plain, reachable

GAINS = ("stiffness", "damping")
_SET = frozenset((*GAINS, *configurations.LIMITS))


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
            if key in (*configurations.PATTERNS, *GAINS):
                raise
            found[key] = configurations.WORKED_OUT
    return found


def has_groups(value: Any) -> bool:
    """Whether groups of actuators belong to a value."""
    return any(_is_group(one) for one in reachable(value))


def groups(value: Any, place: Group, seen: set[int]) -> Iterator[Group | Unknown]:
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
    if not has_groups(value) and "actuators" not in value.content:
        return
    around = {**place.around, **_around(value)}
    listed = place.listed or value.kind in ("list", "table")
    if value.doubt is not None:
        yield value.doubt
    if value.kind == "made" and _SET & set(value.content):
        yield Unknown(value.line, f"wraps actuators in `{value.name}`, which sets gains as well")
    for key, part in [*value.content.items(), *((None, one) for one in value.others)]:
        label = key if value.kind == "table" and isinstance(key, str) and key else place.label
        yield from groups(part, Group(label, value, around, listed), seen)
        if value.kind == "made" and key == "actuators":
            yield from _left_out(part)


def _is_group(of: Thing) -> bool:
    return any(key in of.content for key in configurations.PATTERNS)


def _around(value: Thing) -> dict[str, Any]:
    """What a configuration has beside its groups, and gains do not carry."""
    if value.kind != "made":
        return {}
    found = {k: v for k, v in value.content.items() if k in configurations.NOT_TAKEN}
    init = value.content.get("init_state")
    if isinstance(init, Thing) and "joint_pos" in init.content:
        found[configurations.AT_REST] = configurations.WORKED_OUT
    return found


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
            elif not isinstance(one, Thing) or not list(groups(one, Group("", one), set())):
                yield Unknown(getattr(one, "line", actuators.line))
