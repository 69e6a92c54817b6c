"""Small matrices of MJX, written out element by element.

XLA calls a library for every product of matrices, Cholesky factor and triangular solve, and starts
what lies between such calls operation by operation. For a robot of a joint or two that takes longer
than all its arithmetic. Without the calls, the loop over time is compiled into one kernel.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend import core

# Longest sum of products that is written out.
_LONGEST = 8


def written_out(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function of trees, with its small matrices written out.

    Args:
        function: of trees; what is no JAX array in them is taken as it is.
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
        found = list(out["leaves"])
        for place, array in zip(
            out["moving"], _evaluated(traced.jaxpr, traced.consts, arrays), strict=True
        ):
            found[place] = array
        return jax.tree.unflatten(out["structure"], found)

    return run


def _evaluated(jaxpr: Any, constants: Sequence[Any], inputs: Sequence[Any]) -> list[Any]:
    """The values of a jaxpr, operation by operation."""
    known = dict(zip(jaxpr.constvars, constants, strict=True))
    known |= dict(zip(jaxpr.invars, inputs, strict=True))

    def value(atom: Any) -> Any:
        if isinstance(atom, core.Literal):
            shaped: Any = atom.aval
            return jnp.asarray(atom.val, shaped.dtype)
        return known[atom]

    for equation in jaxpr.eqns:
        outputs = _operation(equation, [value(atom) for atom in equation.invars])
        known |= dict(zip(equation.outvars, outputs, strict=True))
    return [value(atom) for atom in jaxpr.outvars]


def _operation(equation: Any, inputs: list[Any]) -> Sequence[Any]:
    """The outputs of one operation."""
    name, params = equation.primitive.name, equation.params
    if name in ("jit", "pjit"):
        return _evaluated(params["jaxpr"].jaxpr, params["jaxpr"].consts, inputs)
    if name == "dot_general":
        (left, _), _ = params["dimension_numbers"]
        if math.prod(inputs[0].shape[axis] for axis in left) <= _LONGEST:
            return [_product(*map(jnp.asarray, inputs), params["dimension_numbers"])]
    if name == "cholesky":
        return [_cholesky(inputs[0])]
    if name == "triangular_solve":
        return [_solved(*inputs, **params)]
    bound = equation.primitive.get_bind_params(params)
    functions, bound = bound if isinstance(bound, tuple) else ((), bound)
    outputs = equation.primitive.bind(*functions, *inputs, **bound)
    return outputs if equation.primitive.multiple_results else [outputs]


def _product(left: jax.Array, right: jax.Array, dimensions: Any) -> jax.Array:
    """As `jax.lax.dot_general`: batch axes, then the free ones of both."""
    (left_sum, right_sum), (left_batch, right_batch) = dimensions

    def ordered(array: jax.Array, summed: Sequence[int], batch: Sequence[int]) -> jax.Array:
        free = [axis for axis in range(array.ndim) if axis not in (*summed, *batch)]
        moved = jnp.transpose(array, (*batch, *free, *summed))
        return moved.reshape((*moved.shape[: moved.ndim - len(summed)], length))

    length = math.prod(left.shape[axis] for axis in left_sum)
    if length == 0:
        return jax.lax.dot_general(left, right, dimensions)
    left, right = ordered(left, left_sum, left_batch), ordered(right, right_sum, right_batch)
    batch = len(left_batch)
    ours, theirs = left.shape[batch:-1], right.shape[batch:-1]
    left = left.reshape((*left.shape[:batch], *ours, *(1,) * len(theirs), length))
    right = right.reshape((*right.shape[:batch], *(1,) * len(ours), *theirs, length))
    total = left[..., 0] * right[..., 0]
    for place in range(1, length):
        total = total + left[..., place] * right[..., place]
    return total


def _cholesky(matrix: jax.Array) -> jax.Array:
    """The lower factor of a positive definite matrix, shape (..., n, n)."""
    size, zero = matrix.shape[-1], jnp.zeros_like(matrix[..., 0, 0])
    rows = [[zero] * size for _ in range(size)]
    for i in range(size):
        for j in range(i + 1):
            rest = matrix[..., i, j]
            for k in range(j):
                rest = rest - rows[i][k] * rows[j][k]
            rows[i][j] = jnp.sqrt(rest) if i == j else rest / rows[j][j]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def _solved(
    matrix: jax.Array,
    values: jax.Array,
    *,
    left_side: bool,
    lower: bool,
    transpose_a: bool,
    conjugate_a: bool,
    unit_diagonal: bool,
) -> jax.Array:
    """As `jax.lax.linalg.triangular_solve`, of real matrices."""
    del conjugate_a
    if not left_side:
        values, transpose_a = jnp.swapaxes(values, -1, -2), not transpose_a
    if transpose_a:
        matrix, lower = jnp.swapaxes(matrix, -1, -2), not lower
    size = matrix.shape[-1]
    found: dict[int, jax.Array] = {}
    for i in range(size) if lower else range(size - 1, -1, -1):
        rest = values[..., i, :]
        for j, known in found.items():
            rest = rest - matrix[..., i, j, None] * known
        found[i] = rest if unit_diagonal else rest / matrix[..., i, i, None]
    result = jnp.stack([found[i] for i in range(size)], axis=-2)
    return result if left_side else jnp.swapaxes(result, -1, -2)
