"""Cholesky factors of small matrices, of many robots side by side.

    A = L L',    L_jj = sqrt(A_jj - sum_k<j L_jk^2),    L_ij = (A_ij - sum_k<j L_ik L_jk) / L_jj

column by column. Arrays have the robots along their last axis.

Source: Golub & Van Loan, "Matrix Computations", 4th ed., section 4.2.5.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from operator import add
from typing import NamedTuple

import jax
import jax.numpy as jnp


class Factor(NamedTuple):
    """The factor of some matrices.

    Attributes:
        columns: of L, one after the other, shape (n, n, robots).
        inverses: 1 / L_jj, shape (n, robots).
    """

    columns: jax.Array
    inverses: jax.Array


def total(terms: Sequence[jax.Array]) -> jax.Array:
    """A sum that XLA computes for a vector of robots at once, as it does not compute `jnp.sum`."""
    return reduce(add, terms)


def dot(x: jax.Array, y: jax.Array) -> jax.Array:
    """The products of vectors, shape (n, robots) each."""
    return jnp.sum(x * y, axis=0)


def factor(column: Callable[[jax.Array], jax.Array], size: int, robots: int) -> Factor:
    """The factor of positive definite matrices of float32.

    Args:
        column: one of A, by its number; shape (n, robots), of which only what is not above the
            diagonal counts.
        size: n.
        robots: how many.
    """
    rows = jnp.arange(size)[:, None]

    def once(j: jax.Array, found: Factor) -> Factor:
        row = jax.lax.dynamic_index_in_dim(found.columns, j, 1, keepdims=False)
        rest = column(j) - total([found.columns[k] * row[k] for k in range(size)])
        rest = jax.lax.optimization_barrier(rest)
        inverse = 1.0 / jnp.sqrt(jax.lax.dynamic_index_in_dim(rest, j, 0, keepdims=False))
        inverse = jax.lax.optimization_barrier(inverse)
        below = jnp.where(rows >= j, rest * inverse, 0.0)
        update = jax.lax.dynamic_update_index_in_dim
        return Factor(update(found.columns, below, j, 0), update(found.inverses, inverse, j, 0))

    return jax.lax.fori_loop(0, size, once, blank(size, robots))


def blank(size: int, robots: int) -> Factor:
    """Of no matrix; of the shapes that `factor` gives."""
    return Factor(jnp.zeros((size, size, robots)), jnp.zeros((size, robots)))


def solve(factor: Factor, values: jax.Array) -> jax.Array:
    """The solution x of L L' x = b; b and x of shape (n, robots)."""
    columns, inverses = factor
    size = len(inverses)

    def forward(j: jax.Array, y: jax.Array) -> jax.Array:
        row = jax.lax.dynamic_index_in_dim(columns, j, 1, keepdims=False)
        return _filled(y, j, values, dot(row, y), inverses)

    half = jax.lax.fori_loop(0, size, forward, jnp.zeros_like(values))

    def back(i: jax.Array, x: jax.Array) -> jax.Array:
        j = size - 1 - i
        column = jax.lax.dynamic_index_in_dim(columns, j, 0, keepdims=False)
        return _filled(x, j, half, dot(column, x), inverses)

    return jax.lax.fori_loop(0, size, back, jnp.zeros_like(values))


def _filled(
    found: jax.Array, j: jax.Array, values: jax.Array, known: jax.Array, inverses: jax.Array
) -> jax.Array:
    """With the j-th unknown, of which the part that others make up is known."""
    value, inverse = (
        jax.lax.dynamic_index_in_dim(each, j, 0, keepdims=False) for each in (values, inverses)
    )
    return jax.lax.dynamic_update_index_in_dim(found, (value - known) * inverse, j, 0)
