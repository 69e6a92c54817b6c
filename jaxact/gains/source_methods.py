"""What the methods that run when an object of a class is made do to configurations.

They are not followed step by step: `self` is whatever the class and its bases, of which other files
have most, make it. So it is only told whether they create or change gains, and in which line.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field

from jaxact.gains import configurations
from jaxact.gains.source_effects import WRITING, called, constructs, harmless, root
from jaxact.gains.source_values import Thing, Unknown, lineage

MADE = ("__init__", "__post_init__", "__new__")
# legged_gym's, which looks at all that an object has: it runs getters of properties too.
_ALSO_RUN = (*MADE, "init_member_classes")
_GETTERS = ("property", "cached_property")
_LEAVES = frozenset(("stiffness", "damping", *configurations.LIMITS))
_FIELDS = frozenset((*_LEAVES, *configurations.PATTERNS, "actuators"))
_ARITHMETIC = ("math", "np", "numpy", "torch", "jnp")
_COPYING = ("replace", "copy")
ANY = "any field"


@dataclass
class Touch:
    """What methods do.

    Attributes:
        gains: where they create or change gains of something that the object has; None: nowhere.
        own: fields of the object that they set; `ANY` where the name is worked out.
        uncopied: names of the module that they use without copying.
    """

    gains: Unknown | None = None
    own: dict[str, Unknown] = field(default_factory=dict)
    uncopied: set[str] = field(default_factory=set)

    @property
    def anything(self) -> Unknown | None:
        """Where they create or change gains, be it the object's own."""
        own = [one for name, one in self.own.items() if name in _FIELDS]
        return self.gains or (own[0] if own else None)


def indexed(functions: Sequence[Thing]) -> dict[str, list[ast.AST]]:
    """Functions and methods of a source by name, without those that every class has its own of."""
    index: dict[str, list[ast.AST]] = {}
    for one in functions:
        if one.node is not None and one.name not in MADE:
            index.setdefault(one.name, []).append(one.node)
    return index


def touch(of: Thing, index: Mapping[str, Sequence[ast.AST]], robots: Set[str]) -> Touch:
    """What is done to configurations when an object of a class is made.

    Args:
        of: the class.
        index: of `indexed`; which of those that have a name is called is not known.
        robots: names of the module that configurations of actuators stand behind.
    """
    found = Touch()
    waiting = [one.node for one in _run(of) if one.node is not None]
    seen: set[int] = set()
    while waiting:
        node = waiting.pop(0)
        if id(node) in seen:
            continue
        seen.add(id(node))
        _Method(node, robots, index).into(found, of.name)
        calls = [called(one) for one in ast.walk(node) if isinstance(one, ast.Call)]
        waiting += [one for name in calls for one in index.get(name, ())]
    return found


def _run(of: Thing) -> Iterator[Thing]:
    """Methods that run when an object of a class is made, of the class and its bases."""
    for one in lineage(of):
        for name, value in one.content.items():
            if isinstance(value, Thing) and value.kind == "function":
                marks = getattr(value.node, "decorator_list", [])
                getter = any(ast.unparse(mark).split(".")[-1] in _GETTERS for mark in marks)
                if name in _ALSO_RUN or getter:
                    yield value


class _Method:
    """One function: which paths in it stand for configurations, and what it does to them."""

    def __init__(
        self, node: ast.AST, robots: Set[str], index: Mapping[str, Sequence[ast.AST]]
    ) -> None:
        self.nodes = list(ast.walk(node))
        self.name = getattr(node, "name", "lambda")
        self.index = index
        self.paths = set(robots)
        self.found: list[tuple[int, str | None, str]] = []  # line, own field, words
        pairs = [pair for one in self.nodes for pair in _bindings(one)]
        before = -1
        while before < len(self.paths):
            before = len(self.paths)
            for target, value in pairs:
                path = _path(target)
                if path is not None and path != "self" and self.mentions(value):
                    self.paths.add(path)

    def into(self, touch: Touch, owner: str) -> None:
        """Add what it does."""
        for one in self.nodes:
            for target in _targets(one):
                self._written(target)
            if isinstance(one, ast.Call):
                self._call(one)
            elif isinstance(one, ast.Dict):
                for key in one.keys:
                    if isinstance(key, ast.Constant) and key.value in _FIELDS:
                        self._note(one, None)
        for line, own, words in sorted(self.found, key=lambda row: row[0]):
            unknown = Unknown(line, f"sets gains in `{owner}.{self.name}`: `{words}`")
            if own is None:
                touch.gains = touch.gains or unknown
            else:
                touch.own.setdefault(own, unknown)
        copied = {id(one) for call in self.nodes for one in _copied(call)}
        touch.uncopied |= {
            one.id for one in self.nodes
            if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load) and id(one) not in copied
        }  # fmt: skip

    def mentions(self, node: ast.AST) -> bool:
        """Whether a configuration, or a part of one that has gains, is part of a value."""
        if isinstance(node, ast.Call):
            func = node.func.value if isinstance(node.func, ast.Attribute) else node.func
            return any(self.mentions(one) for one in (func, *_arguments(node)))
        if _path(node) in self.paths:
            return True
        if isinstance(node, ast.Attribute):  # other fields, such as positions, have no gains
            inner = node.attr == "__dict__" and self.mentions(node.value)
            return inner or node.attr in _FIELDS
        if isinstance(node, ast.Subscript):
            return _text(node.slice) in _FIELDS or self.mentions(node.value)
        return any(self.mentions(one) for one in ast.iter_child_nodes(node))

    def _holds(self, node: ast.AST) -> bool:
        """As `mentions`, or what it names has a field that is such a configuration."""
        path = _path(node)
        within = path is not None and any(one.startswith(f"{path}.") for one in self.paths)
        return within or self.mentions(node)

    def _note(self, node: ast.AST, own: str | None) -> None:
        words = " ".join(ast.unparse(node).split())
        words = words if len(words) <= 60 else words[:57] + "..."
        self.found.append((getattr(node, "lineno", 0), own, words))

    def _written(self, target: ast.expr) -> None:
        """A field or an entry is set or deleted."""
        if isinstance(target, ast.Attribute):
            own = isinstance(target.value, ast.Name) and target.value.id == "self"
            if own and target.attr != "actuators":
                self._note(target, target.attr)
            elif target.attr in _FIELDS:
                self._note(target, None)
        elif isinstance(target, ast.Subscript):
            if self.mentions(target.value) or _text(target.slice) in _FIELDS:
                self._note(target, _own(target.value))

    def _call(self, node: ast.Call) -> None:
        name = called(node)
        whose = node.func.value if isinstance(node.func, ast.Attribute) else None
        if name in ("setattr", "delattr", "__setattr__") and len(node.args) > 1:
            return self._setattr(node)
        given = {word.arg for word in node.keywords}
        named = given - _LEAVES if constructs(name) and not name.endswith("Cfg") else given
        if named & _FIELDS and name not in MADE:
            return self._note(node, None)
        if name in WRITING and whose is not None:
            return self._note(node, _own(whose)) if self.mentions(whose) else None
        if harmless(name) or name in self.index or root(node.func) in _ARITHMETIC:
            return None
        if any(self._holds(one) for one in (*_arguments(node), *([whose] if whose else []))):
            self._note(node, None)
        return None

    def _setattr(self, node: ast.Call) -> None:
        of, key = node.args[-3:-1] if len(node.args) > 2 else node.args[:2]
        name = _text(key)
        if isinstance(of, ast.Name) and of.id == "self":
            self._note(node, name or ANY)
        elif name in _FIELDS or name is None and self.mentions(of):
            self._note(node, None)


def _arguments(node: ast.Call) -> list[ast.expr]:
    return [*node.args, *(word.value for word in node.keywords)]


def _targets(node: ast.AST) -> Iterator[ast.expr]:
    """Fields and entries that a statement sets or deletes."""
    if isinstance(node, ast.Attribute | ast.Subscript) and not isinstance(node.ctx, ast.Load):
        yield node


def _bindings(node: ast.AST) -> Iterator[tuple[ast.expr, ast.expr]]:
    """What a statement sets, and to what."""
    if isinstance(node, ast.Assign):
        wholes = [(target, node.value) for target in node.targets]
    elif isinstance(node, ast.For | ast.AsyncFor | ast.comprehension):
        wholes = [(node.target, node.iter)]
    elif isinstance(node, ast.AnnAssign | ast.NamedExpr) and node.value is not None:
        wholes = [(node.target, node.value)]
    elif isinstance(node, ast.withitem) and node.optional_vars is not None:
        wholes = [(node.optional_vars, node.context_expr)]
    else:
        return
    for target, value in wholes:
        for one in ast.walk(target):
            if isinstance(one, ast.Name | ast.Attribute | ast.Subscript):
                if isinstance(one.ctx, ast.Store):
                    yield one, value


def _path(node: ast.AST) -> str | None:
    """`name.field[]` of such an expression."""
    ends = ""
    while isinstance(node, ast.Attribute | ast.Subscript):
        ends = (f".{node.attr}" if isinstance(node, ast.Attribute) else "[]") + ends
        node = node.value
    return node.id + ends if isinstance(node, ast.Name) else None


def _own(node: ast.AST) -> str | None:
    """The gain of the object itself that an expression is, or is an entry of."""
    while isinstance(node, ast.Subscript):
        node = node.value
    if isinstance(node, ast.Attribute) and node.attr in _LEAVES:
        return node.attr if _path(node.value) == "self" else None
    return None


def _text(node: ast.AST) -> str | None:
    known = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return node.value if known else None  # type: ignore[attr-defined]


def _copied(node: ast.AST) -> Iterator[ast.AST]:
    """Names that stand where only a copy, or a number that is worked out, goes further."""
    if isinstance(node, ast.BinOp):
        for one in (node.left, node.right):
            if isinstance(one, ast.Attribute) and one.attr in _LEAVES:
                yield from ast.walk(one)
    elif isinstance(node, ast.Call):
        name = called(node)
        if isinstance(node.func, ast.Attribute) and name in _COPYING and _path(node.func.value):
            yield from ast.walk(node.func.value)
        if name == "deepcopy":
            for one in node.args:
                yield from ast.walk(one)
