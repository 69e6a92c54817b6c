"""Gains in Python sources of configurations, which are read and never run.

    class control:                          legged_gym
        stiffness = {"hip": 80.0}
        damping = {"hip": 2.0}

    GO2 = ArticulationCfg(actuators={"legs": DCMotorCfg(joint_names_expr=[".*"], stiffness=25.0,
                                                        damping=0.5)})              Isaac Lab
    LEGS = BuiltinPositionActuatorCfg(target_names_expr=(".*",), stiffness=25.0, ...)   mjlab

Its statements are followed in their order, as far as assignments, arithmetic, classes, copies and
changes of fields go; a configuration that anything else may have changed is refused.
"""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxact.errors import UserError, nearest, shown
from jaxact.gains import configurations
from jaxact.gains.source_groups import fields
from jaxact.gains.source_robots import Robot, control, robots
from jaxact.gains.source_statements import Statements
from jaxact.gains.source_values import WORKED_OUT, Thing, Unknown, UnknownError
from jaxact.gains.table import GainFile

# What `jaxact.export` writes for a framework beside the gains.
_DRIVE = "DriveParameters("
_OF_DRIVE = (
    "its drive (delays, actuator, limits by direction, ...) is not taken: give it as parameters"
)


def read(path: Path, text: str, name: str | None) -> GainFile:
    """The gains of a source.

    Args:
        path: of the file.
        text: its content.
        name: of the configuration that is meant; None where it has one only.

    Raises:
        UserError: it is not Python, has no configuration, several, or one that is worked out.
    """
    try:
        source = Statements()
        source.module(ast.parse(text))
        found, single = robots(source.names, source.touches)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = f" line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise UserError(f"{path}{line}: is not Python that can be read") from None
    if not found and single:
        found = {"actuators": _together(single)}  # others of the robot stand beside each
    if name is None and not found:
        raise UserError(
            f"{path}: has neither actuator configurations (joint_names_expr, target_names_expr)"
            " nor a class with stiffness = {...} and damping = {...}"
        )
    file = _only(path, found) if name is None else _named(path, name, found | single, source)
    return replace(file, notes=(*file.notes, _OF_DRIVE)) if _DRIVE in text else file


def _named(path: Path, name: str, known: dict[str, Robot], source: Statements) -> GainFile:
    """The gains of a configuration, or of the one that a class holds.

    Raises:
        UserError: there is none of that name, or the class holds several.
    """
    if name in known:
        return _gains(path, known[name])
    inside = {key: one for key, one in known.items() if key.startswith(f"{name}.")}
    if inside:
        return _only(path, inside)
    if name in source.names:
        raise UserError(f"{path}{_what(name, source.names[name])}")
    if not known:
        raise UserError(f"{path}: has no configuration {name!r}, nor any other that is known here")
    raise UserError(f"{path}: has no configuration {name!r}; {nearest(name, known)}")


def _what(name: str, value: Any) -> str:
    """What a name stands for that is no configuration."""
    doubt = value.doubt if isinstance(value, Thing) else value
    if isinstance(doubt, Unknown) and doubt.line:
        said = f"`{name}` {doubt.said}" if doubt.said == WORKED_OUT else doubt.said
        return f" line {_said(replace(doubt, said=said))}"
    if isinstance(doubt, Unknown):
        return f": {doubt.said}; give the file that has its gains"
    if isinstance(value, Thing):
        kind = {"made": f"is a {value.name}", "table": "is a dict"}.get(
            value.kind, f"is a {value.kind}"
        )
        return f" line {value.line}: `{name}` {kind} and has no actuators with gains"
    return f": `{name}` is {shown(value)}, which is no configuration of actuators"


def _together(single: dict[str, Robot]) -> Robot:
    """Groups that no configuration names, each once."""
    groups = {id(group.thing): group for one in single.values() for group in one.groups}
    problems = [one.problem for one in single.values() if one.problem is not None]
    return Robot(tuple(groups.values()), problem=problems[0] if problems else None)


def _only(path: Path, found: dict[str, Robot]) -> GainFile:
    """The gains of the configurations, if they all say the same.

    Raises:
        UserError: they do not.
    """
    said: list[GainFile | str] = []
    for one in found.values():
        try:
            said.append(_gains(path, one))
        except UserError as error:
            said.append(str(error))
    if all(isinstance(one, str) for one in said):
        raise UserError(str(said[0]))
    if len({one if isinstance(one, str) else repr(one.entries) for one in said}) > 1:
        raise UserError(
            f"{path}: has several configurations; name one: {path}:{next(iter(found))}"
            f" (of {', '.join(found)})" + _refused(path, found)
        )
    return next(one for one in said if isinstance(one, GainFile))


def _refused(path: Path, found: dict[str, Robot]) -> str:
    """Of the configurations that cannot be read, the first and why."""
    for name, one in found.items():
        try:
            _gains(path, one)
        except UserError as error:
            return f"; {name} cannot be read: {str(error).removeprefix(str(path)).lstrip(': ')}"
    return ""


def _gains(path: Path, robot: Robot) -> GainFile:
    try:
        if robot.problem is not None:
            raise UnknownError(robot.problem)
        if robot.control is None:
            return configurations.groups(path, [(one.label, fields(one)) for one in robot.groups])
        tables = control(robot)
    except UnknownError as error:
        raise UserError(f"{path} line {_said(error.unknown)}") from None
    for key in ("stiffness", "damping"):
        if key not in tables:
            raise UserError(
                f"{path} line {robot.control.line}: class {robot.control.name} has no {key}"
            )
    read_ = configurations.legged_gym(path, {"control": tables})
    if read_ is None:
        raise UserError(f"{path}: stiffness and damping are not tables of numbers")
    return read_


def _said(unknown: Unknown) -> str:
    """Line, what happens there, and what to give instead."""
    if unknown.said.endswith(WORKED_OUT):
        advice = "give the env.yaml that the training writes, or write the number"
    else:
        advice = "give the gains in a TOML file, or the env.yaml that the training writes"
    return f"{unknown.line}: {unknown.said}; {advice}"
