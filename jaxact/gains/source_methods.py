"""What the methods that run when an object of a class is made do to configurations.

They are not followed step by step: `self` is whatever the class and its bases, of which other files
have most, make it. So it is only told whether they create or change gains, and in which line.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any

from jaxact.gains import configurations
from jaxact.gains.source_effects import WRITING, called, constructs, harmless, of_function, root
from jaxact.gains.source_groups import has_groups
from jaxact.gains.source_values import Thing, Unknown, lineage

MADE = ("__init__", "__post_init__", "__new__")
# legged_gym's, which looks at all that an object has: it runs getters of properties too.
_ALSO_RUN = (*MADE, "init_member_classes")
_GETTERS = ("property", "cached_property")
_LEAVES = frozenset(("stiffness", "damping", *configurations.LIMITS))
_FIELDS = frozenset((*_LEAVES, *configurations.PATTERNS, "actuators"))
_ARITHMETIC = ("math", "np", "numpy", "torch", "jnp")
_WITHOUT_GAINS = ("init_state", "spawn", "prim_path")
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


class Methods:
    """The functions and methods of a source, each looked at once.

    Attributes:
        index: those of a name, without those that every class has its own of.
        robots: names of the module that configurations of actuators stand behind.
    """

    def __init__(self, functions: Sequence[Thing], robots: Set[str]) -> None:
        self.index: dict[str, list[ast.AST]] = {}
        self.robots = robots
        self._known: dict[int, _Method] = {}
        for one in functions:
            if one.node is not None and one.name not in MADE:
                self.index.setdefault(one.name, []).append(one.node)

    def touch(self, of: Thing) -> Touch:
        """What is done to configurations when an object of a class is made."""
        found = Touch()
        waiting = [(owner, one.node) for owner, one in _run(of) if one.node is not None]
        own = {name for one in lineage(of) for name in one.content}
        seen: set[int] = set()
        while waiting:
            owner, node = waiting.pop()
            if id(node) in seen:
                continue
            seen.add(id(node))
            if id(node) not in self._known:
                self._known[id(node)] = _Method(node, self.robots, self.index)
            method = self._known[id(node)]
            method.into(found, owner)
            for name in sorted(method.of_self & own):
                waiting += [
                    (f"{one.name}.", one.content[name].node)
                    for one in lineage(of)
                    if isinstance(getattr(one.content.get(name), "node", None), ast.AST)
                ]
            others = sorted(method.calls | (method.of_self - own))
            waiting += [("", one) for name in others for one in self.index.get(name, ())]
        return found


def only_uses(of: Thing, functions: Sequence[Thing], names: Mapping[str, Any]) -> bool:
    """Whether making an object of a class changes nothing but the object, and not its gains.

    Args:
        of: the class.
        functions: all that the source defines.
        names: of the module.
    """
    nodes = [one.node for _, one in _run(of) if one.node is not None]
    loaded: set[str] = set()
    defined = {one.name for one in functions} - set(MADE)
    for node in nodes:
        does = of_function(node)
        calls = {called(part) for part in ast.walk(node) if isinstance(part, ast.Call)}
        changed = set(does.changed) - {"self", "super"}
        if does.everything or does.stored or changed or calls & defined:
            return False
        loaded |= {name for name in does.loaded if isinstance(names.get(name), Thing)}
    if not all(has_groups(names[name]) for name in loaded):
        return False
    found = Methods((), loaded).touch(of)
    return found.anything is None and ANY not in found.own


def _run(of: Thing) -> Iterator[tuple[str, Thing]]:
    """What runs when an object of a class is made, with the names of the class and its bases."""
    for one in lineage(of):
        for name, value in one.content.items():
            if not isinstance(value, Thing):
                continue
            if value.kind == "function":
                marks = getattr(value.node, "decorator_list", [])
                getter = any(ast.unparse(mark).split(".")[-1] in _GETTERS for mark in marks)
                if name in _ALSO_RUN or getter:
                    yield f"{one.name}.", value
            factory = value.content.get("default_factory") if value.kind == "made" else None
            if isinstance(factory, Thing) and factory.kind == "function":
                yield f"{one.name}.{name}: ", factory


class _Method:
    """One function: which paths in it stand for configurations, and what it does to them."""

    def __init__(
        self, node: ast.AST, robots: Set[str], index: Mapping[str, Sequence[ast.AST]]
    ) -> None:
        self.nodes = list(ast.walk(node))
        self.name = getattr(node, "name", "lambda")
        self.index = index
        self.paths = set(robots)
        self.found: list[tuple[int, str | None, str, str]] = []  # line, own field, what, words
        self.calls: set[str] = set()
        self.of_self: set[str] = set()  # those called as `self.name(...)`
        pairs = [pair for one in self.nodes for pair in _bindings(one)]
        before = -1
        while before < len(self.paths):
            before = len(self.paths)
            for target, value in pairs:
                path = _path(target)
                if path is not None and path != "self" and self.mentions(value):
                    self.paths.add(path)

        for one in self.nodes:
            self._look(one)
        self.found.sort(key=lambda row: row[0])
        copied = {id(one) for call in self.nodes for one in _copied(call)}
        self.uncopied = {
            one.id for one in self.nodes
            if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load) and id(one) not in copied
        }  # fmt: skip

    def _look(self, node: ast.AST) -> None:
        """Note what a part of it does."""
        for target in _targets(node):
            self._written(target)
        if isinstance(node, ast.Call):
            own = isinstance(node.func, ast.Attribute) and _path(node.func.value) == "self"
            (self.of_self if own else self.calls).add(called(node))
            self._call(node)
        elif isinstance(node, ast.Dict):
            for key in node.keys:
                if isinstance(key, ast.Constant) and key.value in _FIELDS:
                    self._note(node, None)

    def into(self, touch: Touch, owner: str) -> None:
        """Add what it does."""
        for line, own, what, words in self.found:
            unknown = Unknown(line, f"{what} gains in `{owner}{self.name}`: `{words}`")
            if own is not None:
                touch.own.setdefault(own, unknown)
            elif touch.gains is None:
                touch.gains = unknown
        touch.uncopied |= self.uncopied

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

    def _note(self, node: ast.AST, own: str | None, what: str = "sets") -> None:
        words = " ".join(ast.unparse(node).split())
        words = words if len(words) <= 60 else words[:57] + "..."
        self.found.append((getattr(node, "lineno", 0), own, what, words))

    def _written(self, target: ast.expr) -> None:
        """A field or an entry is set or deleted."""
        if isinstance(target, ast.Attribute):
            own = isinstance(target.value, ast.Name) and target.value.id == "self"
            if own and target.attr != "actuators":
                self._note(target, target.attr)
            elif target.attr in _FIELDS:
                self._note(target, None)
        elif isinstance(target, ast.Subscript):
            if _all_fields(target.value) and _text(target.slice) is None:
                self._note(target, ANY)
            elif self.mentions(target.value) or _text(target.slice) in _FIELDS:
                self._note(target, _own(target.value))

    def _call(self, node: ast.Call) -> None:
        name = called(node)
        whose = node.func.value if isinstance(node.func, ast.Attribute) else None
        if name in ("setattr", "delattr", "__setattr__") and len(node.args) > 1:
            two = name == "__setattr__" and len(node.args) == 2 and whose is not None
            return self._setattr(node, whose if two and whose else node.args[0], node.args[1 - two])
        if name == "exec":
            return self._note(node, None, "may change")
        given = {word.arg for word in node.keywords}
        named = given - _LEAVES if constructs(name) and not name.endswith("Cfg") else given
        if named & _FIELDS and name not in MADE:
            return self._note(node, None)
        if None in given and any(self.mentions(one) for one in (*node.args, whose) if one):
            return self._note(node, None, "may change")  # replace(**fields)
        if name in WRITING and whose is not None and _all_fields(whose):
            return self._note(node, ANY)
        if name in WRITING and whose is not None:
            return self._note(node, _own(whose)) if self.mentions(whose) else None
        if harmless(name) or name in self.index or root(node.func) in _ARITHMETIC:
            return None
        if any(self._holds(one) for one in (*_arguments(node), *([whose] if whose else []))):
            self._note(node, None, "may change")
        return None

    def _setattr(self, node: ast.Call, of: ast.expr, key: ast.expr) -> None:
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


def _all_fields(node: ast.AST) -> bool:
    """Whether an expression is the table of all fields of the object itself."""
    return ast.unparse(node) in ("self.__dict__", "vars(self)")


def _text(node: ast.AST) -> str | None:
    known = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return node.value if known else None  # type: ignore[attr-defined]


def _copied(node: ast.AST) -> Iterator[ast.AST]:
    """Names that stand where only a copy, or a number that is worked out, goes further."""
    if isinstance(node, ast.BinOp):
        for one in (node.left, node.right):
            if isinstance(one, ast.Attribute) and one.attr in _LEAVES:
                yield from ast.walk(one)
    elif isinstance(node, ast.Attribute) and node.attr in _WITHOUT_GAINS:
        yield node.value
    elif isinstance(node, ast.Call):
        name = called(node)
        if isinstance(node.func, ast.Attribute) and name in _COPYING and _path(node.func.value):
            yield from ast.walk(node.func.value)
        if name == "deepcopy":
            for one in node.args:
                yield from ast.walk(one)
