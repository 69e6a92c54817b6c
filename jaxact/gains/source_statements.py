"""Statements of a Python source, followed one after the other and never run.

Plain assignments, arithmetic, classes, copies and changes of fields and entries are followed
exactly. Of everything else (conditions, loops, functions that are called) it is found out what it
may change, and that is not known from there on.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Sequence
from typing import Any

from jaxact.gains import source_effects
from jaxact.gains.source_effects import root
from jaxact.gains.source_expressions import Expressions
from jaxact.gains.source_groups import has_groups
from jaxact.gains.source_methods import Methods, Touch
from jaxact.gains.source_values import Thing, Unknown, inherited, reachable


class Statements(Expressions):
    """A source that is followed: `names` are the module's at its end."""

    def __init__(self) -> None:
        super().__init__()
        self.classes: list[Thing] = []
        self.touches: dict[int, Touch] = {}

    def module(self, tree: ast.Module) -> None:
        """Follow a whole source."""
        self.follow(tree.body)
        for function in self.functions:  # whoever imports the file may call them
            if function.node is not None:
                direct = source_effects.of_function(function.node).direct
                for name, line in direct.items():
                    said = f"changes `{name}` in a function"
                    self.doubt(self.names.get(name), Unknown(line, said))
        robots = {name for name, value in self.names.items() if has_groups(value)}
        methods = Methods(self.functions, robots)
        for one in self.classes:
            self.touches[id(one)] = found = methods.touch(one)
            if found.anything is not None:
                self._touched(one, found, found.anything)

    def _touched(self, of: Thing, touch: Touch, unknown: Unknown) -> None:
        """Methods of a class may change what they use as it is, and what the class holds."""
        if touch.gains is not None:
            for name in touch.uncopied:
                _mark(self.names.get(name), touch.gains)
        marks = getattr(of.node, "decorator_list", [])
        if not any("configclass" in ast.unparse(one) for one in marks):  # those hold copies
            for value in of.content.values():
                _mark(value, unknown)

    def follow(self, statements: Sequence[ast.stmt]) -> None:
        """Follow statements in their order."""
        for node in statements:
            method = getattr(self, f"_on_{type(node).__name__.lower()}", None)
            if method is not None:
                method(node)
            else:
                self.disturb([node])

    def _on_assign(self, node: ast.Assign) -> None:
        value = self.value(node.value)
        for target in node.targets:
            self._put(target, value)

    def _on_annassign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self._put(node.target, self.value(node.value))

    def _on_augassign(self, node: ast.AugAssign) -> None:
        before = self.value(node.target)
        change = self.value(node.value)
        if isinstance(before, Thing):  # a list or table changes in place
            said = f"changes `{ast.unparse(node.target)}` in a way that is not followed"
            self.doubt(before, Unknown(node.lineno, said))
            return
        self._put(node.target, self.combined(node, node.op, before, change))

    def _on_expr(self, node: ast.Expr) -> None:
        self.value(node.value)

    def _on_assert(self, node: ast.Assert) -> None:
        self.value(node.test)

    def _on_pass(self, node: ast.Pass) -> None:
        pass

    def _on_global(self, node: ast.Global) -> None:
        for name in node.names if self.own is not None else ():
            self.forget(name, Unknown(node.lineno, f"sets `{name}` in a class"), self.names)

    def _on_delete(self, node: ast.Delete) -> None:
        names = self.names if self.own is None else self.own
        for target in node.targets:
            if isinstance(target, ast.Name):
                names.pop(target.id, None)
            elif isinstance(target, ast.Attribute | ast.Subscript):
                self._lost(target, self.value(target.value))
            else:
                self.disturb([target])

    def _on_import(self, node: ast.Import) -> None:
        for one in node.names:
            self._from_outside(one.asname or one.name.split(".")[0])

    def _on_importfrom(self, node: ast.ImportFrom) -> None:
        for one in node.names:
            if one.name == "*":
                self._anything_from(node)
            elif node.module == "math" and one.name == "pi":
                self.bind(one.asname or one.name, math.pi)
            else:
                self._from_outside(one.asname or one.name)

    def _from_outside(self, name: str) -> None:
        self.bind(name, Unknown(0, f"takes `{name}` from another file", outside=True))

    def _anything_from(self, node: ast.ImportFrom) -> None:
        """`import *` may set any name anew, and changes no thing."""
        said = f"imports all names of {'.' * node.level}{node.module or ''}, which may set others"
        names = self.names if self.own is None else self.own
        for name, value in names.items():
            if not isinstance(value, Unknown):
                self.forget(name, Unknown(node.lineno, said))

    def _on_if(self, node: ast.If) -> None:
        words = ast.unparse(node.test).replace('"', "'")
        if words in ("__name__ == '__main__'", "TYPE_CHECKING", "typing.TYPE_CHECKING"):
            return self.follow(node.orelse)  # what a program that imports the file sees
        test = self.value(node.test)
        if isinstance(test, bool | int | float | str):
            return self.follow(node.body if test else node.orelse)
        return self.disturb([*node.body, *node.orelse])

    def _on_functiondef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        defaults = [one for one in (*node.args.defaults, *node.args.kw_defaults) if one is not None]
        for one in (*node.decorator_list, *defaults):
            self.value(one)
        function = Thing("function", node.lineno, name=node.name, node=node, scope=self.names)
        self.functions.append(function)
        self.bind(node.name, function)

    _on_asyncfunctiondef = _on_functiondef

    def _on_classdef(self, node: ast.ClassDef) -> None:
        bases = [
            self.value(one)
            for one in node.bases
            if not isinstance(one, ast.Name) or one.id != "object"
        ]
        makers = [self.value(one) for one in node.decorator_list]
        makers += [self.value(word.value) for word in node.keywords]
        makers += [inherited(one, "__init_subclass__") for one in bases if isinstance(one, Thing)]
        # a class's body sees its own names and the module's, not those of the class around it
        around, self.own = self.own, {}
        self.follow(node.body)
        made = Thing("class", node.lineno, self.own, node.name, bases, node)
        self.classes.append(made)
        self.own = around
        if any(isinstance(one, Thing) for one in makers):
            said = f"gives `{node.name}` to what this file defines, which may change it"
            for one in (made, *makers):
                self.doubt(one, Unknown(node.lineno, said), named=False)
        self.bind(node.name, made)

    def _put(self, target: ast.expr, value: Any) -> None:
        """Carry out an assignment to a target."""
        if isinstance(target, ast.Name):
            return self.bind(target.id, value)
        if isinstance(target, ast.Tuple | ast.List):
            return self._unpack(target, value)
        if isinstance(target, ast.Attribute | ast.Subscript):
            return self._put_inside(target, value)
        self.disturb([target])
        return None

    def _unpack(self, target: ast.Tuple | ast.List, value: Any) -> None:
        starred = any(isinstance(one, ast.Starred) for one in target.elts)
        whole = isinstance(value, Thing) and value.kind == "list" and value.doubt is None
        parts = list(value.content.values()) if whole and not starred else []
        if len(parts) == len(target.elts):
            for one, part in zip(target.elts, parts, strict=True):
                self._put(one, part)
            return
        self.disturb([target])
        for name, line in source_effects.changes([target]).stored.items():
            self.forget(name, Unknown(line, links=(value,)))

    def _put_inside(self, target: ast.Attribute | ast.Subscript, value: Any) -> None:
        of = self.value(target.value)
        place = None
        if isinstance(of, Thing) and of.doubt is None and not of.shared:
            if isinstance(target, ast.Subscript):
                place = self.place(of, self.value(target.slice))
            elif of.kind in ("made", "class"):
                place = target.attr
        if place is None:
            return self._lost(target, of)
        of.content[place] = value
        for one in reachable(value):
            one.held = True
        return None

    def _lost(self, target: ast.expr, of: Any) -> None:
        """Something is changed in a thing, and it is not known what, or in which others too."""
        words = " ".join(ast.unparse(target).split())[:60]
        unknown = Unknown(target.lineno, f"changes `{words}` in a way that is not followed")
        self.doubt(of, unknown)
        name = root(target)
        if name is not None and not isinstance(of, Thing) and not getattr(of, "outside", False):
            self.doubt(self.look_up(name, target.lineno), unknown)


def _mark(value: Any, unknown: Unknown) -> None:
    """Something may have changed a value, but not what it shares with those it is a copy of."""
    waiting, seen = [value], set()
    while waiting:
        one = waiting.pop()
        if isinstance(one, Thing) and one.kind != "function" and id(one) not in seen:
            seen.add(id(one))
            one.doubt = one.doubt or unknown
            waiting += [part for part in one.content.values() if not getattr(part, "shared", False)]
