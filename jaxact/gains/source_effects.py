"""What a piece of a Python source may change, where it is not followed step by step."""

from __future__ import annotations

import ast
from collections.abc import Sequence
from dataclasses import dataclass, field

from jaxact.gains.configurations import PATTERNS

# Functions and methods that change none of their arguments.
_READING = frozenset(
    "print len isinstance issubclass float int str bool list tuple dict set frozenset sorted"
    " reversed enumerate zip range sum min max abs round any all type repr hash id getattr hasattr"
    " iter copy deepcopy replace items keys values get index count exists format join split"
    " startswith endswith to_dict asdict array asarray tensor field partial info debug warning"
    " error getLogger warn Path clone item tolist".split()
)
# Those that change the thing whose methods they are, or their first argument, and nothing else.
WRITING = frozenset(
    "update append extend insert pop popitem clear remove setdefault sort reverse setattr"
    " delattr __setattr__ __setitem__".split()
)
EVERYTHING = frozenset(("exec", "eval", "globals", "locals", "vars"))
_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


def called(call: ast.Call) -> str:
    """The last part of the name of what is called; empty where it has none."""
    if isinstance(call.func, ast.Name):
        return call.func.id
    return call.func.attr if isinstance(call.func, ast.Attribute) else ""


def constructs(name: str) -> bool:
    """Whether a name is a class's, as everybody writes them: such a call makes a new thing."""
    return name.lstrip("_")[:1].isupper()


def harmless(name: str) -> bool:
    """Whether a call of a function or method of this name changes nothing that it is given."""
    return name in _READING or constructs(name) or "register" in name


def configured(nodes: Sequence[ast.AST]) -> set[str]:
    """Names that statements set to what they give actuators in the same line."""
    found = set()
    for one in (part for node in nodes for part in ast.walk(node)):
        if isinstance(one, ast.Assign | ast.AnnAssign) and one.value is not None:
            words = {word.arg for word in ast.walk(one.value) if isinstance(word, ast.keyword)}
            targets = one.targets if isinstance(one, ast.Assign) else [one.target]
            if words & {*PATTERNS, "actuators"}:
                found |= {target.id for target in targets if isinstance(target, ast.Name)}
    return found


def root(node: ast.AST) -> str | None:
    """The name that `name.field[key].field` starts with."""
    while isinstance(node, ast.Attribute | ast.Subscript | ast.Starred):
        node = node.value
    return node.id if isinstance(node, ast.Name) else None


@dataclass
class Changes:
    """What a piece of source may change: name -> line where it may.

    Attributes:
        stored: names that it sets or deletes, outside of functions.
        changed: names of things that it may change the inside of.
        written: those of `changed` that it plainly writes to.
        calls: names that it calls.
        loaded: all names that it reads.
        bound: names that it sets anywhere, which may stand for any of those that it reads.
        everything: the line where it may change anything.
    """

    stored: dict[str, int] = field(default_factory=dict)
    changed: dict[str, int] = field(default_factory=dict)
    written: dict[str, int] = field(default_factory=dict)
    calls: dict[str, int] = field(default_factory=dict)
    loaded: dict[str, int] = field(default_factory=dict)
    bound: set[str] = field(default_factory=set)
    everything: int = 0

    @property
    def direct(self) -> dict[str, int]:
        """Of `written`, those that stand for something outside."""
        return {name: line for name, line in self.written.items() if name not in self.bound}

    @property
    def possible(self) -> dict[str, int]:
        """Of `changed`, with all that a name which is set here may stand for."""
        inner = [line for name, line in self.changed.items() if name in self.bound]
        return {**dict.fromkeys(self.loaded, inner[0]), **self.changed} if inner else self.changed


def changes(nodes: Sequence[ast.AST]) -> Changes:
    """What statements or expressions may change, in whatever order and however often they run."""
    found = Changes()
    for node in nodes:
        _visit(node, found, inner=False, outer=frozenset())
    return found


def of_function(node: ast.AST) -> Changes:
    """What a call of a function may change; `stored` are the names that it declares global."""
    found = Changes()
    _function(node, found)
    return found


def _function(node: ast.AST, found: Changes) -> None:
    outer = frozenset(
        name for one in ast.walk(node) if isinstance(one, ast.Global) for name in one.names
    )
    found.bound.update(one.arg for one in ast.walk(node) if isinstance(one, ast.arg))
    for child in ast.iter_child_nodes(node):
        _visit(child, found, inner=True, outer=outer)


def _visit(node: ast.AST, found: Changes, inner: bool, outer: frozenset[str]) -> None:
    """Note what a node may change; `inner` names are a function's own unless they are `outer`."""
    line = getattr(node, "lineno", 0)

    def store(name: str) -> None:
        if not inner or name in outer:
            found.stored[name] = line
        if name not in outer:
            found.bound.add(name)

    if isinstance(node, _FUNCTIONS):
        if not isinstance(node, ast.Lambda):
            store(node.name)
        return _function(node, found)
    if isinstance(node, ast.Name):
        if isinstance(node.ctx, ast.Load):
            found.loaded[node.id] = line
        else:
            store(node.id)
    elif isinstance(node, ast.Attribute | ast.Subscript) and not isinstance(node.ctx, ast.Load):
        _write(node, found, line)
    elif isinstance(node, ast.AugAssign):
        _write(node.target, found, line)
    elif isinstance(node, ast.Call):
        _call(node, found)
    elif isinstance(node, ast.Import | ast.ImportFrom):
        for one in node.names:
            if one.name == "*":
                found.everything = line
            store(one.asname or one.name.split(".")[0])
    elif isinstance(node, ast.ExceptHandler | ast.MatchAs | ast.MatchStar) and node.name:
        store(node.name)
    elif isinstance(node, ast.MatchMapping) and node.rest:
        store(node.rest)
    elif isinstance(node, ast.ClassDef):
        store(node.name)
        inner, outer = True, frozenset()
    elif isinstance(node, ast.ListComp | ast.SetComp | ast.DictComp | ast.GeneratorExp):
        inner = True  # its own names; a walrus in it sets an outer one
        outer |= {one.target.id for one in ast.walk(node) if isinstance(one, ast.NamedExpr)}
    for child in ast.iter_child_nodes(node):
        _visit(child, found, inner, outer)


def _call(node: ast.Call, found: Changes) -> None:
    name = called(node)
    if isinstance(node.func, ast.Name):
        found.calls[name] = node.lineno
    if name in EVERYTHING and isinstance(node.func, ast.Name):
        found.everything = node.lineno
    if not harmless(name):
        for one in (node.func, *node.args, *(word.value for word in node.keywords)):
            if not isinstance(one, ast.Name) or one is not node.func:
                found.changed.update(_names(one, node.lineno))
    if name in WRITING:
        whose = node.func.value if isinstance(node.func, ast.Attribute) else [*node.args, None][0]
        if whose is not None:
            _write(whose, found, node.lineno)


def _write(target: ast.AST, found: Changes, line: int) -> None:
    """Note what a target is part of: its key is only read."""
    while isinstance(target, ast.Attribute | ast.Subscript | ast.Starred):
        target = target.value
    names = _names(target, line)
    found.changed.update(names)
    found.written.update(names)


def _names(node: ast.AST, line: int) -> dict[str, int]:
    return {one.id: line for one in ast.walk(node) if isinstance(one, ast.Name)}
