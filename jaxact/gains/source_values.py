"""Values in a Python source that is followed and not run.

A number, a string, a truth value or None stands for itself; what has parts is a `Thing`; what only
running the file would tell is an `Unknown`, which says the line and why.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

from jaxact.gains.source_effects import of_function

WORKED_OUT = "is worked out when the file runs"
_DEEPEST, _MOST = 60, 20_000


@dataclass(frozen=True)
class Unknown:
    """A value that only running the file would tell.

    Attributes:
        line: of the source, from 1; 0 where a name is not set in the file.
        said: what happens there, as the words that follow the line's number.
        outside: it comes from another file, so it is none of the things of this one.
        before: what the name stood for until then.
        links: things that it may be, or be part of.
    """

    line: int
    said: str = WORKED_OUT
    outside: bool = False
    before: Any = None
    links: tuple[Any, ...] = ()


@dataclass(eq=False)
class Thing:
    """A list, a table, what a call makes, a class or a function of the source.

    Attributes:
        kind: which of them; tuples are lists.
        line: where it is made.
        content: entries by place or key, fields by name, what a class sets.
        name: of the class that is called, or of the class itself.
        others: what belongs to it without a name: positional arguments, bases, what is called.
        node: of a function.
        scope: of a function, the names that it sees.
        doubt: what may have changed it in a way that is not followed.
        held: a name or another thing holds it.
        shared: it was given to a call, which keeps it or a copy of it: which one is not known here.
    """

    kind: Literal["list", "table", "made", "class", "function"]
    line: int
    content: dict[Any, Any] = field(default_factory=dict)
    name: str = ""
    others: list[Any] = field(default_factory=list)
    node: ast.AST | None = None
    scope: dict[str, Any] | None = None
    doubt: Unknown | None = None
    held: bool = False
    shared: bool = False


class UnknownError(Exception):
    """An unknown value is needed."""

    def __init__(self, unknown: Unknown) -> None:
        super().__init__()
        self.unknown = unknown


def reachable(value: Any, named: bool = False) -> Iterator[Thing]:
    """All things that belong to a value, or may, itself among them, each once.

    Args:
        value: where to begin.
        named: those too that its functions name, which may return them.
    """
    seen: set[int] = set()
    waiting = [value]
    while waiting:
        one = waiting.pop()
        if not isinstance(one, Thing | Unknown) or id(one) in seen:
            continue
        seen.add(id(one))
        if isinstance(one, Unknown):
            waiting += [one.before, *one.links]
        else:
            yield one
            waiting += [*one.content.values(), *one.others]
            if named and one.node is not None and one.scope is not None:
                waiting += [one.scope.get(name) for name in of_function(one.node).loaded]


def copied(value: Any) -> Any:
    """A deep copy, as `copy.deepcopy` makes it: classes and functions stay the same."""
    things = {id(one): one for one in reachable(value) if one.kind not in ("class", "function")}
    copies = {
        key: Thing(one.kind, one.line, name=one.name, doubt=one.doubt)
        for key, one in things.items()
    }
    for key, one in things.items():
        copies[key].content = {k: copies.get(id(v), v) for k, v in one.content.items()}
        copies[key].others = [copies.get(id(v), v) for v in one.others]
    return copies.get(id(value), value)


def listed(values: list[Any], line: int) -> Thing:
    """A list."""
    return Thing("list", line, dict(enumerate(values)))


def inherited(of: Thing, name: str) -> Any:
    """What a class has under a name, its own or its bases'; None where it has nothing.

    With several bases that may have it, Python's order of bases would decide: that is not followed.
    """
    if of.doubt is not None:
        return of.doubt
    if name in of.content:
        return of.content[name]
    found = []
    for base in of.others:
        if isinstance(base, Thing) and base.kind == "class":
            one = inherited(base, name)
        else:
            said = f"takes `{name}` from a class that is not in this file"
            one = Unknown(of.line, said, outside=True)
        found += [] if one is None else [one]
    return found[0] if len(found) < 2 and found else Unknown(of.line) if found else None


def lineage(of: Thing) -> Iterator[Thing]:
    """A class of the file and those that it inherits from, as far as the file has them."""
    yield of
    for base in of.others:
        if isinstance(base, Thing) and base.kind == "class":
            yield from lineage(base)


def names_of(of: Thing) -> list[str]:
    """Names that a class of the file sets, its bases' first."""
    found: dict[str, None] = {}
    for base in of.others:
        if isinstance(base, Thing) and base.kind == "class":
            found |= dict.fromkeys(names_of(base))
    return [*(found | dict.fromkeys(of.content))]


def plain(value: Any) -> Any:
    """A value as Python's own lists and dictionaries.

    Raises:
        UnknownError: part of it is not known, or it has more than gains have.
    """
    left = [_MOST]

    def of(one: Any, line: int, depth: int) -> Any:
        left[0] -= 1
        if depth > _DEEPEST or left[0] < 0:
            raise UnknownError(Unknown(line))
        if isinstance(one, Unknown):
            raise UnknownError(one)
        if not isinstance(one, Thing):
            return one
        if one.doubt is not None or one.kind not in ("list", "table"):
            raise UnknownError(one.doubt or Unknown(one.line))
        parts = {key: of(part, one.line, depth + 1) for key, part in one.content.items()}
        if one.kind == "list":
            return list(parts.values())
        return {str(key): part for key, part in parts.items()}

    return of(value, 0, 0)
