"""Gains in the `env.yaml` that Isaac Lab and mjlab write beside a training run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from jaxact.errors import UserError
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
    found = list(_groups(document, "", 0))
    return configurations.groups(path, found) if found else None


def _groups(part: Any, name: str, depth: int) -> Iterator[tuple[str, Mapping[str, Any]]]:
    if depth > _DEEPEST:
        return
    if isinstance(part, Mapping):
        if any(key in part for key in configurations.PATTERNS) and "stiffness" in part:
            yield name, part
            return
        for key, value in part.items():
            yield from _groups(value, str(key), depth + 1)
    elif isinstance(part, list | tuple):
        for value in part:
            yield from _groups(value, name, depth + 1)
