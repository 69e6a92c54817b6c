"""Single numbers, known or traced, and what is done with them.

What is known is computed at once, with NumPy. A product with a known zero is zero, a sum with one
the other summand, and so on, so that nothing remains of what a model does not have. (Of a factor
that is not finite a product with zero would be none: a robot that has left every bound then shows
it in fewer of its numbers.)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np


@dataclass(frozen=True, eq=False, slots=True)
class Number:
    """A number that is not known when a program is traced; `traced` has shape ()."""

    traced: Any


Array = np.ndarray
"""Of numbers: numeric where all are known, else of objects (Number or NumPy's scalars)."""


def _quotient(x: Array, y: Array) -> Array:
    return np.trunc(np.true_divide(x, y)) if x.dtype.kind in "iu" else np.divide(x, y)


def _chosen(which: Array, *cases: Array) -> Array:
    if which.dtype == bool:
        return np.where(which, cases[1], cases[0])
    return np.choose(which, cases)


# What each operation is for known numbers; the type of the result is set by who asks.
_KNOWN: dict[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": _quotient, "rem": np.fmod,
    "max": np.maximum, "min": np.minimum, "pow": np.power, "atan2": np.arctan2,
    "neg": np.negative, "abs": np.abs, "sign": np.sign, "floor": np.floor, "ceil": np.ceil,
    "sqrt": np.sqrt, "square": np.square, "exp": np.exp, "exp2": np.exp2, "expm1": np.expm1,
    "log": np.log, "log1p": np.log1p, "sin": np.sin, "cos": np.cos, "tan": np.tan,
    "asin": np.arcsin, "acos": np.arccos, "atan": np.arctan,
    "sinh": np.sinh, "cosh": np.cosh, "tanh": np.tanh,
    "rsqrt": lambda x: 1.0 / np.sqrt(x), "is_finite": np.isfinite,
    "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal,
    "eq": np.equal, "ne": np.not_equal,
    "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert,
    "select_n": _chosen, "clamp": lambda low, x, high: np.clip(x, low, high),
    "convert_element_type": lambda x: x, "copy": lambda x: x, "stop_gradient": lambda x: x,
}  # fmt: skip


# What those are for traced numbers that sums, products and factors are made of.
_TRACED: dict[str, Callable[..., Any]] = {
    "add": jax.lax.add, "sub": jax.lax.sub, "mul": jax.lax.mul, "div": jax.lax.div,
    "sqrt": jax.lax.sqrt, "max": jax.lax.max, "min": jax.lax.min,
    "and": jax.lax.bitwise_and, "or": jax.lax.bitwise_or,
}  # fmt: skip


def each_by_itself(name: str) -> bool:
    """Whether an operation does the same to every number of its arrays, and is known here."""
    return name in _KNOWN


def is_known(array: Array) -> bool:
    """Whether all numbers of an array are known."""
    return array.dtype != object


def objects(array: Array) -> Array:
    """The array with every number an object."""
    if not is_known(array):
        return array
    out = np.empty(array.size, object)
    for place, number in enumerate(array.reshape(-1)):
        out[place] = number
    return out.reshape(array.shape)


def settled(array: Array, dtype: np.dtype) -> Array:
    """The array, numeric and of this type if all of its numbers are known."""
    if is_known(array):
        return array
    flat = array.reshape(-1)
    if any(isinstance(number, Number) for number in flat):
        return array
    return np.array(list(flat), dtype).reshape(array.shape)


@dataclass(frozen=True)
class Arithmetic:
    """Operations on numbers; the same one of the same numbers is traced once."""

    _done: dict[Any, tuple[Any, Number]] = field(default_factory=dict)

    def each(
        self, primitive: Any, params: dict[str, Any], arrays: Sequence[Array], dtype: np.dtype
    ) -> Array:
        """An operation on every number of arrays that broadcast, with a result of this type."""
        if all(map(is_known, arrays)):
            with np.errstate(all="ignore"):
                return np.asarray(_KNOWN[primitive.name](*arrays)).astype(dtype)
        columns = np.broadcast_arrays(*map(objects, arrays))
        rows = zip(*(column.reshape(-1) for column in columns), strict=True)
        out = np.empty(columns[0].size, object)
        settings = repr(params) if params else ""
        for place, row in enumerate(rows):
            out[place] = self._one(primitive, params, settings, row, dtype)
        return settled(out.reshape(columns[0].shape), dtype)

    def converted(self, array: Array, dtype: np.dtype) -> Array:
        """The array with numbers of this type."""
        if is_known(array):
            return array.astype(dtype)
        found = np.empty(array.size, object)
        for place, number in enumerate(array.reshape(-1)):
            if not isinstance(number, Number):
                number = dtype.type(number)
            elif number.traced.dtype != dtype:
                number = Number(jax.lax.convert_element_type(number.traced, dtype))
            found[place] = number
        return found.reshape(array.shape)

    def of(self, name: str, *row: Any) -> Any:
        """An operation of `_TRACED` on numbers of one type; so is its result."""
        if not any(isinstance(number, Number) for number in row):
            with np.errstate(all="ignore"):
                return row[0].dtype.type(_KNOWN[name](*row))
        return self._traced(name, "", row, _TRACED[name])

    def _one(
        self, primitive: Any, params: dict[str, Any], settings: str, row: Sequence[Any], dtype: Any
    ) -> Any:
        """An operation on one row of numbers."""
        if not any(isinstance(number, Number) for number in row):
            with np.errstate(all="ignore"):
                return dtype.type(_KNOWN[primitive.name](*map(np.asarray, row)))
        return self._traced(
            primitive.name, settings, row, lambda *values: primitive.bind(*values, **params)
        )

    def _traced(self, name: str, settings: str, row: Sequence[Any], bind: Callable) -> Any:
        """An operation whose result is not known, unless it is one of its operands."""
        found = _simplified(name, row)
        if found is not None:
            return found
        if name == "sub" and _is(row[0], 0):
            name, row, bind = "neg", row[1:], jax.lax.neg
        key = name, settings, *map(_identity, row)
        if key not in self._done:
            values = [x.traced if isinstance(x, Number) else x for x in row]
            # The operands are kept too, so that no other number takes the identity of one.
            self._done[key] = tuple(row), Number(bind(*values))
        return self._done[key][1]


def _identity(number: Any) -> Any:
    return id(number) if isinstance(number, Number) else (number.dtype, number.tobytes())


def _is(number: Any, value: float) -> bool:
    return not isinstance(number, Number) and bool(number == value)


def _simplified(name: str, row: Sequence[Any]) -> Any:
    """The result of an operation on numbers that are not all known, where it needs no computing."""
    if name == "mul":
        for number, other in (row, row[::-1]):
            if _is(number, 0):
                return number
            if _is(number, 1):
                return other
    elif name == "add":
        for number, other in (row, row[::-1]):
            if _is(number, 0):
                return other
    elif (name == "sub" and _is(row[1], 0)) or (name == "div" and _is(row[1], 1)):
        return row[0]
    elif name == "select_n":
        if not isinstance(row[0], Number):
            return row[1 + int(row[0])]
        if all(_identity(case) == _identity(row[1]) for case in row[2:]):
            return row[1]
    elif name == "copy" or (name in ("max", "min") and _identity(row[0]) == _identity(row[1])):
        return row[0]
    return None
