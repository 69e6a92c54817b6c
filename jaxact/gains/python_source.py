"""Gains in Python sources of configurations, which are read and never run.

    class control:                          legged_gym
        stiffness = {"hip": 80.0}
        damping = {"hip": 2.0}

    GO2 = ArticulationCfg(actuators={"legs": DCMotorCfg(joint_names_expr=[".*"], stiffness=25.0,
                                                        damping=0.5)})              Isaac Lab
    LEGS = BuiltinPositionActuatorCfg(target_names_expr=(".*",), stiffness=25.0, ...)   mjlab

Numbers may be worked out from literals, from names that the file itself sets, and `math.pi`.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jaxact.errors import UserError, nearest
from jaxact.gains import configurations
from jaxact.gains.table import GainFile

_BINARY = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul,
    ast.Div: operator.truediv, ast.Pow: operator.pow,
}  # fmt: skip
_LARGEST_POWER = 16


class _UnknownError(Exception):
    """A value that only running the file would tell; its line."""

    def __init__(self, node: ast.AST) -> None:
        super().__init__()
        self.line = getattr(node, "lineno", 0)


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
        tree = ast.parse(text)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        line = f" line {error.lineno}" if isinstance(error, SyntaxError) else ""
        raise UserError(f"{path}{line}: is not Python that can be read") from None
    known = _assigned(tree)
    found = {
        label: (groups, control) for label, groups, control in _configurations(tree)
    }  # fmt: skip
    if not found:
        raise UserError(
            f"{path}: has neither actuator configurations (joint_names_expr, target_names_expr)"
            " nor a class with stiffness = {...} and damping = {...}"
        )
    if name is None and len(found) > 1:
        raise UserError(
            f"{path}: has several configurations; name one: {path}:{next(iter(found))}"
            f" (of {', '.join(found)})"
        )
    if name is not None and name not in found:
        raise UserError(f"{path}: has no configuration {name!r}; {nearest(name, found)}")
    groups, control = found[next(iter(found)) if name is None else name]
    try:
        if control is not None:
            tables = {key: _value(node, known) for key, node in control.items()}
            read_ = configurations.legged_gym(path, tables)
            if read_ is None:
                raise UserError(f"{path}: stiffness and damping are not tables of numbers")
            return read_
        fields = [(label, _fields(call, known)) for label, call in groups]
    except _UnknownError as error:
        raise UserError(
            f"{path} line {error.line}: is worked out when the file runs; give the env.yaml that"
            " the training writes, or write the number"
        ) from None
    return configurations.groups(path, fields)


def _assigned(tree: ast.Module) -> dict[str, ast.expr]:
    """What the names of the module are set to, the last time."""
    found: dict[str, ast.expr] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and len(node.targets) == 1:
            target, value = node.targets[0], node.value
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            target, value = node.target, node.value
        else:
            continue
        if isinstance(target, ast.Name):
            found[target.id] = value
    return found


_Group = tuple[str, ast.Call]


def _configurations(
    tree: ast.Module,
) -> Iterator[tuple[str, list[_Group], dict[str, ast.expr] | None]]:
    """Name of each configuration, and its groups, or what legged_gym's class sets."""
    parts: list[_Group] = []
    for node in tree.body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            label = target.id if isinstance(target, ast.Name) else ast.unparse(target)
            if isinstance(node.value, ast.Call) and _is_group(node.value):
                parts.append((label, node.value))  # one group; others of the robot stand beside it
                continue
            groups = list(_groups(node.value, label))
            if groups:
                yield label, groups, None
        elif isinstance(node, ast.ClassDef):
            for one in ast.walk(node):
                if isinstance(one, ast.ClassDef):
                    own = _set_in(one)
                    if {"stiffness", "damping"} <= set(own):
                        yield node.name, [], own
    if parts:
        yield "actuators", parts, None


def _is_group(call: ast.Call) -> bool:
    return any(one.arg in configurations.PATTERNS for one in call.keywords)


def _groups(node: ast.expr, label: str) -> Iterator[_Group]:
    if isinstance(node, ast.Call) and _is_group(node):
        yield label, node
        return
    if isinstance(node, ast.Dict):
        for key, value in zip(node.keys, node.values, strict=True):
            own = key.value if isinstance(key, ast.Constant) and isinstance(key.value, str) else ""
            yield from _groups(value, own or label)
        return
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.keyword):
            yield from _groups(child.value, label)
        elif isinstance(child, ast.expr):
            yield from _groups(child, label)


def _set_in(node: ast.ClassDef) -> dict[str, ast.expr]:
    return {
        one.targets[0].id: one.value
        for one in node.body
        if isinstance(one, ast.Assign)
        and isinstance(one.targets[0], ast.Name)
        and one.targets[0].id in ("stiffness", "damping")
    }


def _fields(call: ast.Call, known: dict[str, ast.expr]) -> dict[str, Any]:
    """The fields of a group; those that are not gains and cannot be told are left out."""
    found = {}
    for one in call.keywords:
        if one.arg is None:
            raise _UnknownError(call)  # **fields
        try:
            found[one.arg] = _value(one.value, known)
        except _UnknownError:
            if one.arg in (*configurations.PATTERNS, "stiffness", "damping"):
                raise
    return found


def _value(node: ast.expr, known: dict[str, ast.expr], depth: int = 0) -> Any:
    """The value of an expression of literals, names that are set in the file, and arithmetic."""
    if depth > _LARGEST_POWER * 2:
        raise _UnknownError(node)
    inner = depth + 1
    if isinstance(node, ast.Constant):
        return node.value
    if isinstance(node, ast.Name) and node.id in known:
        return _value(known[node.id], known, inner)
    if isinstance(node, ast.Attribute) and ast.unparse(node) in ("math.pi", "np.pi", "torch.pi"):
        return math.pi
    if isinstance(node, ast.List | ast.Tuple):
        return [_value(one, known, inner) for one in node.elts]
    if isinstance(node, ast.Dict):
        if any(key is None for key in node.keys):
            raise _UnknownError(node)
        if not all(isinstance(key, ast.Constant | ast.Name) for key in node.keys):
            raise _UnknownError(node)  # a key that is not a name, such as a list
        return {
            str(_value(key, known, inner)): _value(value, known, inner)
            for key, value in zip(node.keys, node.values, strict=True)
            if key is not None
        }
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        value = _number(node.operand, known, inner)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        left, right = (_number(one, known, inner) for one in (node.left, node.right))
        if isinstance(node.op, ast.Pow) and abs(right) > _LARGEST_POWER:
            raise _UnknownError(node)
        try:
            return _BINARY[type(node.op)](left, right)
        except (ArithmeticError, TypeError, ValueError):
            raise _UnknownError(node) from None
    raise _UnknownError(node)


def _number(node: ast.expr, known: dict[str, ast.expr], depth: int) -> float:
    value = _value(node, known, depth)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise _UnknownError(node)
    return value
