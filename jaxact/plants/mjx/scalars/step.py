"""MJX's step of a small robot, unrolled to scalar operations.

MJX is written for many bodies: slices, look-ups, products of small matrices, Cholesky factors. For
a robot of a few joints, moving numbers about takes longer than computing with them, and XLA calls a
library for every product. Here such a function is traced as it is and then evaluated again, each
number of each array by itself. What is known when it is traced, the model above all, is computed
then, and what is multiplied by zero is gone. Of a mass on a slide little more remains than the
mass, the force and the step, and XLA compiles the loop over time into one kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core

from jaxact.plants.mjx.scalars import arrays as mjx_arrays
from jaxact.plants.mjx.scalars.numbers import Arithmetic, Number, each_by_itself, is_known, settled

_LARGEST = 512


def written_out(function: Callable[..., Any], largest: int = _LARGEST) -> Callable[..., Any]:
    """The same function of trees, evaluated number by number.

    Loops of a fixed number of turns that do nothing once a flag is down end there, as they would
    without `vmap`; they have no derivative in reverse.

    Args:
        function: of trees; what is not a JAX array in them is taken as it is.
        largest: most numbers of an array that is written out.
    """

    def run(*inputs: Any) -> Any:
        leaves, structure = jax.tree.flatten(inputs)
        moving = [place for place, leaf in enumerate(leaves) if isinstance(leaf, jax.Array)]
        out: dict[str, Any] = {}

        def of_arrays(*arrays: jax.Array) -> list[jax.Array]:
            filled = list(leaves)
            for place, array in zip(moving, arrays, strict=True):
                filled[place] = array
            found, out["structure"] = jax.tree.flatten(
                function(*jax.tree.unflatten(structure, filled))
            )
            out["leaves"] = found
            out["moving"] = [p for p, leaf in enumerate(found) if isinstance(leaf, jax.Array)]
            return [found[place] for place in out["moving"]]

        arrays = [leaves[place] for place in moving]
        traced = jax.make_jaxpr(of_arrays)(*arrays)
        results = _Evaluation(largest).values(traced, arrays)
        found = list(out["leaves"])
        for place, result, shaped in zip(out["moving"], results, traced.out_avals, strict=True):
            found[place] = _packed(result, shaped)
        return jax.tree.unflatten(out["structure"], found)

    return run


@dataclass(frozen=True)
class _Evaluation:
    """A program evaluated number by number, or a part of it that a loop repeats.

    Its values are arrays of numbers (`jaxact.plants.mjx.scalars.numbers`); large ones are arrays of
    JAX.

    Attributes:
        largest: most numbers of an array that is written out.
        arithmetic: computes with numbers.
    """

    largest: int
    arithmetic: Arithmetic = field(default_factory=Arithmetic)

    def values(self, closed: Any, inputs: Sequence[Any]) -> list[Any]:
        """The results of a closed jaxpr, operation by operation."""
        jaxpr = closed.jaxpr
        known = dict(zip(jaxpr.constvars, map(self._unpacked, closed.consts), strict=True))
        known |= dict(zip(jaxpr.invars, map(self._unpacked, inputs), strict=True))

        def value(atom: Any) -> Any:
            if isinstance(atom, core.Literal):
                shaped: Any = atom.aval
                return np.asarray(atom.val, shaped.dtype)
            return known[atom]

        for equation in _needed(jaxpr):
            outputs = self._operation(equation, [value(atom) for atom in equation.invars])
            known |= dict(zip(equation.outvars, outputs, strict=True))
        return [value(atom) for atom in jaxpr.outvars]

    def _operation(self, equation: Any, inputs: list[Any]) -> Sequence[Any]:
        """The results of one operation."""
        name, params = equation.primitive.name, equation.params
        if name in ("jit", "pjit"):
            return self.values(params["jaxpr"], inputs)
        if name in ("while", "scan", "cond"):
            return {"while": self._while, "scan": self._scan, "cond": self._cond}[name](
                equation, inputs
            )
        atoms = (*equation.invars, *equation.outvars)
        if all(atom.aval.size <= self.largest for atom in atoms):
            out = equation.outvars[0].aval
            if each_by_itself(name):
                dtype = np.dtype(out.dtype)
                return [self.arithmetic.each(equation.primitive, params, inputs, dtype)]
            found = mjx_arrays.moved(name, inputs, params, out)
            if found is None:
                found = mjx_arrays.combined(self.arithmetic, name, inputs, params, out)
            if found is not None:
                pairs = zip(found, equation.outvars, strict=True)
                return [settled(array, np.dtype(to.aval.dtype)) for array, to in pairs]
        return self._as_it_is(equation, inputs)

    def _as_it_is(self, equation: Any, inputs: list[Any]) -> list[Any]:
        """The results of an operation as JAX does it, at once where its operands are known."""
        atoms = zip(inputs, equation.invars, strict=True)
        operands = [_packed(each, atom.aval) for each, atom in atoms]
        bound = equation.primitive.get_bind_params(equation.params)
        functions, bound = bound if isinstance(bound, tuple) else ((), bound)
        if any(isinstance(operand, jax.core.Tracer) for operand in operands):
            outputs = equation.primitive.bind(*functions, *operands, **bound)
        else:
            with jax.ensure_compile_time_eval():
                outputs = equation.primitive.bind(*functions, *operands, **bound)
        outputs = outputs if equation.primitive.multiple_results else [outputs]
        return list(map(self._unpacked, outputs))

    def _inside(self, closed: Any, inputs: Sequence[Any], shapes: Sequence[Any]) -> list[jax.Array]:
        """The results of a part that is traced by itself, one number after the other."""
        return self._apart(_Evaluation(self.largest).values(closed, inputs), shapes)

    def _while(self, equation: Any, inputs: list[Any]) -> list[Any]:
        """As `jax.lax.while_loop`."""
        params = equation.params
        ahead = params["cond_nconsts"]
        begin = ahead + params["body_nconsts"]
        asked, shared, start = inputs[:ahead], inputs[ahead:begin], inputs[begin:]
        shapes = _shapes(equation.outvars)
        condition, body = params["cond_jaxpr"], params["body_jaxpr"]

        def going(carry: list[jax.Array]) -> jax.Array:
            carried = self._joined(carry, shapes)
            return self._inside(condition, [*asked, *carried], condition.out_avals)[0]

        def once(carry: list[jax.Array]) -> list[jax.Array]:
            return self._inside(body, [*shared, *self._joined(carry, shapes)], shapes)

        found = jax.lax.while_loop(going, once, self._apart(start, shapes))
        return self._joined(found, shapes)

    def _scan(self, equation: Any, inputs: list[Any]) -> list[Any]:
        """As `jax.lax.scan`."""
        params, body = equation.params, equation.params["jaxpr"]
        # What is another row in every turn has an axis more outside.
        first = sum(map(_alike, equation.invars, body.jaxpr.invars))
        carried = sum(map(_alike, equation.outvars, body.jaxpr.outvars))
        begin = first - carried
        shared, start, rows = inputs[:begin], inputs[begin:first], inputs[first:]
        out_shapes = _shapes(body.jaxpr.outvars)
        shapes, kept_shapes = out_shapes[:carried], out_shapes[carried:]
        flag = _flag(body.jaxpr, begin, carried) if len(inputs) == first else None
        if flag is not None and not kept_shapes:
            return self._until_down(equation, flag, shared, start)

        def once(carry: list[jax.Array], row: list[jax.Array]) -> tuple[list[jax.Array], Any]:
            values = [*shared, *self._joined(carry, shapes), *row]
            found = _Evaluation(self.largest).values(body, values)
            kept = map(_packed, found[carried:], kept_shapes)
            return self._apart(found[:carried], shapes), list(kept)

        over = list(map(_packed, rows, _shapes(equation.invars[first:])))
        names = ("length", "reverse", "unroll")
        settings = {name: params[name] for name in names}
        carry, kept = jax.lax.scan(once, self._apart(start, shapes), over, **settings)
        return [*self._joined(carry, shapes), *map(self._unpacked, kept)]

    def _until_down(self, equation: Any, flag: int, shared: list[Any], start: list[Any]) -> Any:
        """A scan that does nothing once the flag among what it carries is down."""
        body = equation.params["jaxpr"]
        shapes = _shapes(equation.outvars)
        place = sum(shaped.size if shaped.size <= self.largest else 1 for shaped in shapes[:flag])

        def going(at: tuple[jax.Array, list[jax.Array]]) -> jax.Array:
            count, carry = at
            return (count < equation.params["length"]) & jnp.reshape(carry[place], ())

        def once(at: tuple[jax.Array, list[jax.Array]]) -> tuple[jax.Array, list[jax.Array]]:
            count, carry = at
            return count + 1, self._inside(body, [*shared, *self._joined(carry, shapes)], shapes)

        _, found = jax.lax.while_loop(going, once, (jnp.int32(0), self._apart(start, shapes)))
        return self._joined(found, shapes)

    def _cond(self, equation: Any, inputs: list[Any]) -> list[Any]:
        """As `jax.lax.switch`."""
        which, *others = inputs
        branches = equation.params["branches"]
        if isinstance(which, np.ndarray) and is_known(which):
            return self.values(branches[int(np.clip(which, 0, len(branches) - 1))], others)
        shapes = _shapes(equation.outvars)
        ways = [lambda branch=branch: self._inside(branch, others, shapes) for branch in branches]
        number = _packed(which, equation.invars[0].aval)
        return self._joined(jax.lax.switch(number, ways), shapes)

    def _apart(self, values: Sequence[Any], shapes: Sequence[Any]) -> list[jax.Array]:
        """The numbers of some values one after the other, and their large arrays."""
        found = []
        for value, shaped in zip(values, shapes, strict=True):
            if shaped.size > self.largest:
                found.append(_packed(value, shaped))
                continue
            for number in value.reshape(-1):
                traced = number.traced if isinstance(number, Number) else number
                found.append(jax.lax.convert_element_type(traced, shaped.dtype))
        return found

    def _joined(self, numbers: Sequence[jax.Array], shapes: Sequence[Any]) -> list[Any]:
        """The values that `_apart` took apart."""
        rest = iter(numbers)
        found: list[Any] = []
        for shaped in shapes:
            if shaped.size > self.largest:
                found.append(next(rest))
                continue
            row = np.empty(shaped.size, object)
            for place in range(shaped.size):
                row[place] = Number(next(rest))
            found.append(settled(row.reshape(shaped.shape), np.dtype(shaped.dtype)))
        return found

    def _unpacked(self, array: Any) -> Any:
        """The numbers of an array, or the array itself where it is large and not known."""
        if isinstance(array, np.ndarray):
            return array
        if not isinstance(array, jax.core.Tracer):
            return np.asarray(array)
        if array.size > self.largest:
            return array
        if not array.size:
            return np.zeros(array.shape, array.dtype)
        row = jnp.reshape(array, (-1,))
        found = np.empty(array.size, object)
        for place in range(array.size):
            found[place] = Number(row[place] if array.ndim else array)
        return found.reshape(array.shape)


def _needed(jaxpr: Any) -> list[Any]:
    """The operations that the results come of, in order."""
    wanted = {atom for atom in jaxpr.outvars if not isinstance(atom, core.Literal)}
    found = []
    for equation in reversed(jaxpr.eqns):
        if not wanted.isdisjoint(equation.outvars):
            found.append(equation)
            wanted |= {atom for atom in equation.invars if not isinstance(atom, core.Literal)}
    return found[::-1]


def _shapes(atoms: Sequence[Any]) -> list[Any]:
    """Shapes and types of variables."""
    return [atom.aval for atom in atoms]


def _alike(outer: Any, inner: Any) -> bool:
    return outer.aval.shape == inner.aval.shape


def _flag(body: Any, begin: int, carried: int) -> int | None:
    """Which carried value is a flag that, once down, stays down with all others unchanged.

    MJX writes loops of a largest number of turns so, for the sake of derivatives in reverse.

    Args:
        body: jaxpr of a scan.
        begin: number of values that all turns share.
        carried: number of values that it carries.
    """
    carry = body.invars[begin : begin + carried]
    *before, last = body.eqns or [None]
    if last is None or last.primitive.name != "cond" or list(last.outvars) != list(body.outvars):
        return None
    flag = last.invars[0]
    for equation in before:
        if equation.primitive.name != "convert_element_type" or [flag] != equation.outvars:
            return None
        flag = equation.invars[0]
    idle = last.params["branches"][0].jaxpr
    given = dict(zip(idle.invars, last.invars[1:], strict=True))
    for kept, result in zip(carry, idle.outvars, strict=True):
        down = kept is flag and isinstance(result, core.Literal) and not result.val
        same = not isinstance(result, core.Literal) and given.get(result) is kept
        if not (down or same):
            return None
    return next((place for place, kept in enumerate(carry) if kept is flag), None)


def _packed(value: Any, shaped: Any) -> Any:
    """A value as an array of JAX, which is not a tracer where all of its numbers are known."""
    if not isinstance(value, np.ndarray):
        return value
    if is_known(value):
        with jax.ensure_compile_time_eval():
            return jnp.asarray(value, shaped.dtype)
    row = [
        number.traced if isinstance(number, Number) else jnp.asarray(number, shaped.dtype)
        for number in value.reshape(-1)
    ]
    return row[0] if not value.ndim else jnp.stack(row).reshape(value.shape)
