"""Expressions of a Python source, evaluated as far as literals, names and copies go."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from jaxact.gains import source_effects
from jaxact.gains.source_effects import EVERYTHING, called, constructs, harmless
from jaxact.gains.source_methods import MADE, only_uses
from jaxact.gains.source_values import Thing, Unknown, copied, inherited, lineage, listed, reachable

_BINARY = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Pow: operator.pow,
}  # fmt: skip
_LARGEST_POWER, _LARGEST, _LONGEST = 16, 1e300, 5_000
_PI = ("math.pi", "np.pi", "numpy.pi", "torch.pi")


class Expressions:
    """Names of a source at one place of it, and the values of expressions there.

    Attributes:
        names: of the module -> their values.
        own: those of the class whose body is followed; None outside of one.
        functions: all that the source defines.
    """

    def __init__(self) -> None:
        self.names: dict[str, Any] = {}
        self.own: dict[str, Any] | None = None
        self.functions: list[Thing] = []
        self._ran: set[int] = set()

    def look_up(self, name: str, line: int) -> Any:
        """What a name stands for where it is used: the class's own, or the module's."""
        for names in (self.own, self.names):
            if names is not None and name in names:
                value = names[name]
                if isinstance(value, Unknown) and value.outside:
                    return Unknown(line, value.said, outside=True)
                return value
        return Unknown(line, outside=True)

    def bind(self, name: str, value: Any) -> None:
        """Set a name of the class or module."""
        for one in reachable(value):
            one.held = True
        (self.names if self.own is None else self.own)[name] = value

    def forget(self, name: str, unknown: Unknown, names: dict[str, Any] | None = None) -> None:
        """Set a name to what is not known."""
        names = names if names is not None else self.names if self.own is None else self.own
        before = names.get(name)
        if isinstance(before, Unknown):
            before = before.before
        names[name] = replace(unknown, before=unknown.before if before is None else before)

    def doubt(self, value: Any, unknown: Unknown, named: bool = True) -> None:
        """Something may change a value and all that belongs to it; `named` as for `reachable`."""
        for one in list(reachable(value, named)):
            one.doubt = one.doubt or unknown
            if one.kind == "function":
                self._run(one)

    def disturb(self, nodes: Sequence[ast.AST]) -> None:
        """Statements or expressions that are not followed may or may not run."""
        found = source_effects.changes(nodes)
        self._apply(found)
        links = tuple(self.look_up(name, line) for name, line in found.loaded.items())
        robots = source_effects.configured(nodes)
        for name, line in found.stored.items():
            said = f"sets `{name}` where it is not followed"
            # what it may be is not known; that it may be a configuration is
            may = Thing("made", line, {"actuators": Unknown(line)}) if name in robots else None
            self.forget(name, Unknown(line, said, links=links, before=may))

    def unknown(self, node: ast.AST) -> Unknown:
        """What cannot be told, and may be any of the things that the expression names."""
        found = source_effects.changes([node]).loaded
        links = tuple(self.look_up(name, line) for name, line in found.items())
        return Unknown(getattr(node, "lineno", 0), links=links)

    def _run(self, function: Thing) -> None:
        """A function of the file may be called: what it does to names and things outside of it."""
        if function.node is None or id(function) in self._ran:
            return
        self._ran.add(id(function))
        found = source_effects.of_function(function.node)
        self._apply(found)
        for name, line in found.stored.items():
            self.forget(name, Unknown(line, f"changes `{name}` in a function"), self.names)

    def _apply(self, found: source_effects.Changes) -> None:
        if found.everything:
            self.lose_all(found.everything)
        for name, line in found.possible.items():
            said = f"may change `{name}` in a way that is not followed"
            self.doubt(self.look_up(name, line), Unknown(line, said))
        for name, line in found.calls.items():
            for one in reachable(self.look_up(name, line)):
                if one.kind == "function":
                    self.doubt(one, Unknown(line), named=False)

    def lose_all(self, line: int) -> None:
        """Something may set any name."""
        unknown = Unknown(line, "may change any name of the file")
        for name in list(self.names):
            self.doubt(self.names[name], unknown)
            self.forget(name, unknown, self.names)
        for name in list(self.own or ()):
            self.forget(name, unknown)

    def value(self, node: ast.expr) -> Any:
        """The value of an expression; what cannot be told is an `Unknown`."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is not None:
            return method(node)
        self.disturb([node])
        return self.unknown(node)

    def _constant(self, node: ast.Constant) -> Any:
        known = node.value is None or isinstance(node.value, bool | int | float | str)
        return node.value if known else Unknown(node.lineno)

    def _name(self, node: ast.Name) -> Any:
        return self.look_up(node.id, node.lineno)

    def _lambda(self, node: ast.Lambda) -> Any:
        return Thing("function", node.lineno, node=node, scope=self.names)

    def _namedexpr(self, node: ast.NamedExpr) -> Any:
        value = self.value(node.value)
        self.bind(node.target.id, value)
        return value

    def _ifexp(self, node: ast.IfExp) -> Any:
        self.value(node.test)
        self.disturb([node.body, node.orelse])
        return self.unknown(node)

    def _attribute(self, node: ast.Attribute) -> Any:
        value = self.value(node.value)
        if not isinstance(value, Thing):
            if ast.unparse(node) in _PI and isinstance(value, Unknown) and value.outside:
                return math.pi
            return value if isinstance(value, Unknown) else Unknown(node.lineno)
        if value.doubt is not None:
            return replace(value.doubt, links=(value,))
        within = Unknown(node.lineno, links=(value,))
        if value.kind == "class":
            found = inherited(value, node.attr)
            return within if found is None else found
        if value.kind != "made" or not value.name.endswith("Cfg"):
            return within  # only configurations keep what they are given as it is
        if node.attr in value.content:
            return value.content[node.attr]
        # a default of its class, which another file has: none of the things of this one
        default = not value.others and "actuator" not in node.attr and node.attr[:2] != "__"
        return Unknown(node.lineno, outside=True) if default else within

    def _subscript(self, node: ast.Subscript) -> Any:
        value, key = self.value(node.value), self.value(node.slice)
        if isinstance(value, Unknown):
            return value
        within = Unknown(node.lineno, links=(value,))
        if not isinstance(value, Thing):
            return within
        if value.doubt is not None:
            return replace(value.doubt, links=(value,))
        place = self.place(value, key)
        return within if place is None else value.content.get(place, within)

    def place(self, of: Thing, key: Any) -> Any:
        """Where the entry of a key stands in a list or table; None where that is not known."""
        if isinstance(key, bool | Thing | Unknown) or key is None:
            return None
        if of.kind == "list":
            key = key + len(of.content) if isinstance(key, int) and key < 0 else key
            return key if isinstance(key, int) and key in of.content else None
        return key if of.kind == "table" else None

    def _elements(self, node: ast.List | ast.Tuple) -> Any:
        found: list[Any] = []
        whole: Unknown | None = None
        for one in node.elts:
            value = self.value(one.value if isinstance(one, ast.Starred) else one)
            if not isinstance(one, ast.Starred):
                found.append(value)
            elif isinstance(value, Thing) and value.kind == "list" and value.doubt is None:
                found += value.content.values()
            else:
                whole = Unknown(one.lineno)
        result = listed(found[:_LONGEST], node.lineno)
        result.doubt = whole or (Unknown(node.lineno) if len(found) > _LONGEST else None)
        return result

    _list = _tuple = _elements

    def _dict(self, node: ast.Dict) -> Any:
        result = Thing("table", node.lineno)
        for key, one in zip(node.keys, node.values, strict=True):
            at = None if key is None else self.value(key)
            value = self.value(one)
            if key is None and isinstance(value, Thing) and value.kind == "table":
                result.content |= value.content
                result.doubt = result.doubt or value.doubt
            elif key is None or isinstance(at, Thing | Unknown | None | bool):
                result.doubt = result.doubt or Unknown(node.lineno)
                result.others.append(value)
            else:
                result.content[at] = value
        return result

    def _unaryop(self, node: ast.UnaryOp) -> Any:
        value = self.value(node.operand)
        if not _is_number(value) or not isinstance(node.op, ast.USub | ast.UAdd):
            return _why(node, value)
        return -value if isinstance(node.op, ast.USub) else value

    def _binop(self, node: ast.BinOp) -> Any:
        return self.combined(node, node.op, self.value(node.left), self.value(node.right))

    def combined(self, node: ast.AST, op: ast.operator, left: Any, right: Any) -> Any:
        """`left op right` of numbers, and the sum of lists."""
        parts = [one for one in (left, right) if isinstance(one, Thing) and one.kind == "list"]
        if len(parts) == 2 and isinstance(op, ast.Add) and not any(one.doubt for one in parts):
            both = [part for one in parts for part in one.content.values()]
            return listed(both, parts[0].line) if len(both) <= _LONGEST else _why(node)
        if not _is_number(left) or not _is_number(right) or type(op) not in _BINARY:
            return _why(node, left, right)
        if isinstance(op, ast.Pow) and abs(right) > _LARGEST_POWER:
            return _why(node)
        try:
            result = _BINARY[type(op)](left, right)
            return result if _is_number(result) and abs(result) < _LARGEST else _why(node)
        except (ArithmeticError, TypeError, ValueError):
            return _why(node)

    def _call(self, node: ast.Call) -> Any:
        name = called(node)
        if name in EVERYTHING and isinstance(node.func, ast.Name):
            self.lose_all(node.lineno)
            return Unknown(node.lineno)
        receiver = self.value(node.func.value) if isinstance(node.func, ast.Attribute) else None
        function = self._callee(node, receiver)
        given = Thing("made", node.lineno, name=name)
        for one in node.args:
            given.others.append(self.value(one.value if isinstance(one, ast.Starred) else one))
        for word in node.keywords:
            value = self.value(word.value)
            if word.arg is not None:
                given.content[word.arg] = value
            elif isinstance(value, Thing) and value.kind == "table":
                given.content |= value.content
                given.doubt = given.doubt or value.doubt
            else:
                given.doubt = Unknown(node.lineno)
        if isinstance(function, Thing):
            return self._of_the_file(node, function, receiver, given)
        if constructs(name):
            for thing in reachable(given):
                thing.shared = thing.held
            return given
        known = self._known(node, name, receiver, given)
        if known is not None:
            return known
        if isinstance(receiver, Thing | Unknown):
            given.others.append(receiver)
        if not harmless(name):
            words = ast.unparse(node.func)[:40]
            said = f"calls `{words}`, which may change what it is given"
            self.doubt(given, Unknown(node.lineno, said))
        given.doubt = Unknown(node.lineno)
        return given

    def _callee(self, node: ast.Call, receiver: Any) -> Any:
        """The class or function of the file that is called; None where it is from elsewhere."""
        if isinstance(node.func, ast.Name):
            return self.look_up(node.func.id, node.lineno)
        if isinstance(node.func, ast.Attribute):
            if isinstance(receiver, Thing) and receiver.kind == "class":
                return inherited(receiver, node.func.attr)
            return None
        return self.value(node.func)

    def _of_the_file(self, node: ast.Call, what: Thing, receiver: Any, given: Thing) -> Thing:
        """A call of what the file itself defines: what a function returns is not followed."""
        given.others.append(what)
        made = any(name in one.content for one in lineage(what) for name in MADE)
        if what.kind == "class" and (not made or only_uses(what, self.functions, self.names)):
            for one in reachable(given):
                one.shared = one.held and one.kind != "class"
            return given
        words = given.name or " ".join(ast.unparse(node.func).split())[:40]
        said = f"calls `{words}`, which this file defines"
        unknown = Unknown(node.lineno, said)
        self.doubt(receiver, unknown, named=False)
        self.doubt(given, unknown, named=False)
        return given

    def _known(self, node: ast.Call, name: str, receiver: Any, given: Thing) -> Any:
        """What copies and builders give; None of any other call."""
        line, words, first = node.lineno, given.content, [*given.others, None][0]
        method = isinstance(receiver, Thing)
        if given.doubt is not None or len(given.others) > 1:
            return None
        if name in ("copy", "deepcopy", "replace"):
            source = receiver if method else first
            if not isinstance(source, Thing) or method and given.others:
                return None
            if source.kind in ("list", "table") and name == "copy":
                return Thing(source.kind, line, dict(source.content), doubt=source.doubt)
            if source.kind != "made" or name != "replace" and words:
                return copied(source) if name == "deepcopy" and not words else None
            if name == "deepcopy" or name == "copy" and method:
                return copied(source)
            for one in reachable(source):
                one.shared = True  # a shallow copy or a deep one, as its class has it
            return Thing("made", line, source.content | words, source.name, list(source.others),
                         doubt=source.doubt)  # fmt: skip
        if method and name == "update" and receiver.kind == "table" and not receiver.shared:
            more = first if isinstance(first, Thing) else None
            if receiver.doubt is None and (more is None or more.kind == "table" and not more.doubt):
                if more is None and given.others:
                    return None
                receiver.content |= {**(more.content if more else {}), **words}
                for one in reachable(receiver):
                    one.held = receiver.held or one.held
                return Unknown(line)
            return None
        if (
            isinstance(node.func, ast.Name)
            and name == "dict"
            and (first is None or isinstance(first, Thing))
        ):
            if given.others and (first is None or first.kind != "table"):
                return None
            before = first.content if first is not None else {}
            return Thing("table", line, before | words, doubt=first.doubt if first else None)
        if isinstance(node.func, ast.Name) and name in ("list", "tuple") and not words:
            if isinstance(first, Thing) and first.kind == "list":
                return Thing("list", line, dict(first.content), doubt=first.doubt)
        return None


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _why(node: ast.AST, *parts: Any) -> Unknown:
    """Why the result of an operation is not known: of its parts, or of what it does."""
    things = tuple(one for one in parts if isinstance(one, Thing | Unknown))
    for one in parts:
        known = one.doubt if isinstance(one, Thing) else one
        if isinstance(known, Unknown):
            return replace(known, outside=False, links=things)
    return Unknown(getattr(node, "lineno", 0), links=things)
