"""Which configurations of robots a Python source has, once it has been followed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from jaxact.gains import configurations
from jaxact.gains.source_groups import GAINS, Group, groups
from jaxact.gains.source_methods import ANY, Touch
from jaxact.gains.source_values import (
    Thing,
    Unknown,
    UnknownError,
    inherited,
    lineage,
    names_of,
    plain,
)

_DEEPEST = 8


@dataclass(frozen=True)
class Robot:
    """A configuration: its groups, or what legged_gym's class sets; `problem` says why neither."""

    groups: tuple[Group, ...] = ()
    control: Thing | None = None
    init: Any = None
    problem: Unknown | None = None


Found = Iterator[tuple[str, Robot, bool]]  # with its name, and whether it is a robot's as a whole


def robots(
    names: Mapping[str, Any], touches: Mapping[int, Touch]
) -> tuple[dict[str, Robot], dict[str, Robot]]:
    """Configurations of a module, and single groups of actuators beside them.

    Args:
        names: of the module.
        touches: what methods of its classes do, by the class's id.

    Returns:
        Both by their names; what a class holds is called `Class.field`.
    """
    parts: tuple[dict[str, Robot], dict[str, Robot]] = {}, {}
    for label, value in names.items():
        for name, robot, whole in _Finder(touches).find(label, value):
            parts[0 if whole else 1][name] = robot
    return parts


class _Finder:
    """Of one name of the module."""

    def __init__(self, touches: Mapping[int, Touch]) -> None:
        self.touches = touches

    def find(self, label: str, value: Any, around: tuple[Thing, ...] = ()) -> Found:
        """What stands behind a name; `around` are the classes that it is a field of."""
        if isinstance(value, Unknown):
            yield from self._unknown(label, value, [value.before], around)
        elif isinstance(value, Thing) and value.kind == "class":
            yield from self._class(label, value, around)
        elif isinstance(value, Thing):
            fields = _noted(around[-1]) if around else {}
            parts = list(groups(value, Group(label, value, fields), set()))
            problem = next((one for one in parts if isinstance(one, Unknown)), None)
            own = tuple(one for one in parts if isinstance(one, Group))
            whole = problem is not None and not own or any(one.listed for one in own)
            if parts:
                yield label, Robot(own, problem=problem), whole
            for one in value.others:  # an object of a class of the file has the class's fields
                if isinstance(one, Thing) and one.kind == "class" and value.kind == "made":
                    yield from self._made(label, value, one, around)

    def _made(self, label: str, value: Thing, of: Thing, around: tuple[Thing, ...]) -> Found:
        for name, robot, whole in self._class(label, of, around):
            if name[len(label) + 1 :].split(".")[0] not in value.content:
                yield name, replace(robot, problem=robot.problem or value.doubt), whole

    def _class(self, label: str, of: Thing, around: tuple[Thing, ...]) -> Found:
        if of in around or len(around) > _DEEPEST:
            return
        touch = self.touches.get(id(of), Touch())
        own = _of_class(of, self.touches) if not around else None
        if own is not None:
            yield label, own, True
        problem, some = touch.gains or of.doubt, own is not None
        for key in names_of(of):
            if key.startswith("__") or key == "class_type":
                continue
            unknown = problem or touch.own.get(key)
            for name, robot, whole in self._field(f"{label}.{key}", of, key, around):
                some = some or whole
                yield name, replace(robot, problem=unknown or robot.problem), whole
        if touch.gains is not None and not some:
            yield label, Robot(problem=touch.gains), True

    def _field(self, label: str, of: Thing, key: str, around: tuple[Thing, ...]) -> Found:
        value, around = inherited(of, key), (*around, of)
        if not isinstance(value, Unknown):
            return self.find(label, value, around)
        may = [one.content[key] for one in lineage(of) if key in one.content]
        may = [one.before if isinstance(one, Unknown) else one for one in may]
        return self._unknown(label, value, may, around)

    def _unknown(
        self, label: str, value: Unknown, may: list[Any], around: tuple[Thing, ...]
    ) -> Found:
        """What may be any of some values is a problem where one of them is a configuration."""
        if any(whole for one in may for _, _, whole in self.find(label, one, around)):
            yield label, Robot(problem=value), True


def _noted(of: Thing) -> dict[str, Any]:
    """Fields of a class that gains do not carry."""
    return {
        key: configurations.WORKED_OUT for key in configurations.OF_CONTROL if key in names_of(of)
    }


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
            if key in GAINS:
                raise
            found[key] = configurations.WORKED_OUT
    for key in GAINS:
        value = inherited(of, key)
        if isinstance(value, Unknown):
            raise UnknownError(value)
    if isinstance(robot.init, Thing) and "default_joint_angles" in names_of(robot.init):
        found["default_joint_angles"] = configurations.WORKED_OUT
    return found


def _of_class(of: Thing, touches: Mapping[int, Touch]) -> Robot | None:
    """legged_gym's, with what methods that run when it is made do to its gains."""
    found = _legged_gym(of)
    if found is None or found.problem is not None:
        return found
    for one, fields in ((of, ("control",)), (found.control, GAINS)):
        touch = touches.get(id(one), Touch())
        known = [touch.own[name] for name in (*fields, *GAINS, ANY) if name in touch.own]
        problem = touch.gains or (known[0] if known else None)
        if problem is not None:
            return replace(found, problem=problem)
    return found


def _legged_gym(of: Thing) -> Robot | None:
    """It reads `control` and no other class inside."""
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
    own = [one.content.get(key) for key in GAINS for one in lineage(of)]
    return any(isinstance(one, Unknown | Thing) for one in own)


def _inner(of: Thing) -> list[Thing]:
    found = []
    for one in of.content.values():
        if isinstance(one, Thing) and one.kind == "class":
            found += [one] if all(key in names_of(one) for key in GAINS) else _inner(one)
    return found
