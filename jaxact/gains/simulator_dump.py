"""Gains in the `env.yaml` that Isaac Lab and mjlab write beside a training run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from jaxact.errors import UserError, nearest
from jaxact.gains import configurations
from jaxact.gains.table import GainFile

_DEEPEST = 60


class _Loader(yaml.SafeLoader):
    """YAML's plain values; objects of Python, which such files have, are read as what they hold."""


def _plain(loader: _Loader, _suffix: str, node: yaml.Node) -> Any:
    if isinstance(node, yaml.MappingNode):
        return loader.construct_mapping(node, deep=True)
    if isinstance(node, yaml.SequenceNode):
        return loader.construct_sequence(node, deep=True)
    return loader.construct_scalar(node)


_Loader.add_multi_constructor("tag:yaml.org,2002:python/", _plain)
_Loader.add_multi_constructor("!", _plain)


def load(path: Path, text: str) -> Any:
    """The document of a YAML file.

    Raises:
        UserError: it is not YAML.
    """
    try:
        return yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, ValueError, TypeError, RecursionError, OverflowError) as error:
        mark = getattr(error, "problem_mark", None)
        where = f" line {mark.line + 1}" if mark is not None else ""
        problem = getattr(error, "problem", None) or str(error).split("\n", 1)[0]
        raise UserError(f"{path}{where}: is not YAML: {problem}") from None


def read(path: Path, document: Mapping[str, Any]) -> GainFile | None:
    """Of all groups of actuators anywhere in the document; None where there are none."""
    return _read(path, document, list(_groups(document, (), {}, 0)))


def named(path: Path, document: Any, name: str) -> GainFile:
    """Of the groups of one of its robots.

    Args:
        path: of the file.
        document: that it has.
        name: of the robot, in full or its last parts, such as `robot` of `scene.robot`.

    Raises:
        UserError: it has no such robot, or several.
    """
    found = list(_groups(document, (), {}, 0))
    robots = list(dict.fromkeys(one.robot for one in found))
    fits = [one for one in robots if f".{one}".endswith(f".{name}")]
    exact = [name] if name in fits else fits
    if not robots:
        raise UserError(f"{path}: has no robots with names; leave {name!r} away")
    if len(exact) != 1:
        raise UserError(f"{path}: has no single robot {name!r}; {nearest(name, robots)}")
    read_ = _read(path, document, [one for one in found if one.robot == exact[0]])
    assert read_ is not None
    return read_


@dataclass(frozen=True)
class _Group:
    """A group of actuators, and the dotted name of the robot that has it."""

    name: str
    fields: Mapping[str, Any]
    robot: str


def _read(path: Path, document: Mapping[str, Any], found: list[_Group]) -> GainFile | None:
    if not found:
        return None
    groups = [(one.name, one.fields) for one in found]
    more = configurations.beside(document)
    return configurations.groups(path, groups, [one.robot for one in found], more)


def _groups(
    part: Any, place: tuple[str, ...], around: Mapping[str, Any], depth: int
) -> Iterator[_Group]:
    """Groups below a part of the document; `around` is what gains do not carry of those above."""
    if depth > _DEEPEST:
        return
    if isinstance(part, Mapping):
        if any(key in part for key in configurations.PATTERNS) and "stiffness" in part:
            yield _Group(place[-1] if place else "", {**around, **part}, _robot(place))
            return
        init = part.get("init_state")
        if isinstance(init, Mapping) and init.get("joint_pos"):
            around = {configurations.AT_REST: configurations.WORKED_OUT}
        for key, value in part.items():
            yield from _groups(value, (*place, str(key)), around, depth + 1)
    elif isinstance(part, list | tuple):
        for value in part:
            yield from _groups(value, place, around, depth + 1)


def _robot(place: tuple[str, ...]) -> str:
    """Name of what has the `actuators` that a group stands in."""
    if "actuators" in place:
        place = place[: len(place) - 1 - place[::-1].index("actuators")]
    if place and place[-1] == "articulation":  # mjlab's, a part of each robot
        place = place[:-1]
    return ".".join(place)
