"""Krylov spaces of a linear map, and the spectral radius of what it does there.

Vectors are lists of arrays, or flat; a small matrix is rows of numbers, each of shape (), or an
array.

Source: Arnoldi's method, Saad, "Numerical Methods for Large Eigenvalue Problems", 2nd ed., chapter
6.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable

import jax
import jax.numpy as jnp


def dot(a: list[jax.Array], b: list[jax.Array]) -> jax.Array:
    """Scalar product."""
    return sum((jnp.sum(x * y) for x, y in zip(a, b, strict=True)), start=jnp.zeros(()))


def scaled(vector: list[jax.Array], factor: jax.Array) -> list[jax.Array]:
    """The vector times a number."""
    return [factor * leaf for leaf in vector]


def inverse(size: jax.Array) -> jax.Array:
    """1 / size, or 0 for nothing."""
    return jnp.where(size > 0.0, 1.0 / jnp.where(size > 0.0, size, 1.0), 0.0)


def hessenberg(
    apply: Callable, start: list[jax.Array], dimension: int, whole: bool, kept: Callable
) -> list[list[jax.Array]]:
    """Projection of a linear map on the Krylov space of `start`: rows of a Hessenberg matrix.

    A space that is exhausted early leaves zero rows and columns, which add no eigenvalue but 0.
    Of the `whole` space nothing may be missed, even if the start happens to be all but a mode.
    What passes through `kept` is computed once, rather than wherever it is used.
    """
    # Below this share of an image, what is new in it is rounding, amplified by the delay lines.
    exhausted = jnp.finfo(start[0].dtype).eps ** (0.6 if whole else 0.375)
    first = scaled(start, inverse(jnp.sqrt(dot(start, start))))
    empty = [jnp.zeros_like(leaf) for leaf in start]

    def column(known, carry, number):
        newest, fresh = carry
        image = kept(apply(newest))
        size = jnp.sqrt(dot(image, image))
        entries = []
        for vector in (*known, *fresh):
            entry = kept(dot(vector, image))
            image = kept([x - entry * y for x, y in zip(image, vector, strict=True)])
            entries.append(entry)
        rest = jnp.sqrt(dot(image, image))
        rest = jnp.where(rest > exhausted * size, rest, 0.0)
        newest = kept(scaled(image, kept(inverse(rest))))
        fresh = [
            jax.tree.map(functools.partial(jnp.where, number + 1 == place), newest, vector)
            for place, vector in enumerate(fresh, len(known))
        ]
        return (newest, fresh), (entries, rest)

    matrix = [[jnp.zeros(())] * dimension for _ in range(dimension)]
    known, newest, middle = [first], first, dimension // 2
    # In two loops, because vectors that are not there yet take as long as those that are.
    for begin, end in ((0, middle), (middle, dimension)) if middle else ((0, dimension),):
        carry = newest, [empty] * (end - len(known))
        numbers = jnp.arange(begin, end)
        (newest, fresh), columns = jax.lax.scan(functools.partial(column, known), carry, numbers)
        known = [*known, *fresh, newest]
        for place, number in enumerate(range(begin, end)):
            entries, rest = jax.tree.map(operator.itemgetter(place), columns)
            for row, entry in enumerate(entries):
                matrix[row][number] = entry
            if number + 1 < dimension:
                matrix[number + 1][number] = rest
    return matrix


def log_radius(matrix: jax.Array, squarings: int) -> jax.Array:
    """Logarithm of the spectral radius of a matrix of many rows, by repeated squaring.

        log rho = lim log(|A^(2k)| / |A^k|) / k

    Source: Gelfand's formula. A polynomial of so high a degree would be too sensitive to rounding.
    """

    def advance(carry, _):
        matrix, log_size, power, _ = carry
        product = matrix @ matrix
        size = jnp.linalg.norm(product)
        growth = (log_size + jnp.log(size)) / power
        return (inverse(size) * product, 2.0 * log_size + jnp.log(size), 2.0 * power, growth), None

    size = jnp.linalg.norm(matrix)
    carry = (inverse(size) * matrix, jnp.log(size), jnp.ones_like(size), size)
    (_, _, _, growth), _ = jax.lax.scan(advance, carry, None, length=squarings)
    return growth


def arnoldi(apply: Callable, start: jax.Array, dimension: int) -> tuple[jax.Array, jax.Array]:
    """As `hessenberg` for a map of one flat vector.

    Returns:
        The matrix, shape (dimension, dimension), and the space's orthonormal basis as rows; those
        of a space that is exhausted early are zero.
    """
    exhausted = jnp.finfo(start.dtype).eps ** 0.375
    basis = jnp.zeros((dimension + 1, start.size), start.dtype)
    basis = basis.at[0].set(start * inverse(jnp.linalg.norm(start)))

    def column(carry, number):
        basis, matrix = carry
        image = apply(basis[number])
        size = jnp.linalg.norm(image)
        entries = basis @ image
        image = image - entries @ basis
        # Once more, for what rounding has left of the earlier directions.
        again = basis @ image
        image, entries = image - again @ basis, entries + again
        rest = jnp.linalg.norm(image)
        rest = jnp.where(rest > exhausted * size, rest, 0.0)
        basis = basis.at[number + 1].set(image * inverse(rest))
        matrix = matrix.at[:, number].set(entries).at[number + 1, number].set(rest)
        return (basis, matrix), None

    matrix = jnp.zeros((dimension + 1, dimension), start.dtype)
    (basis, matrix), _ = jax.lax.scan(column, (basis, matrix), jnp.arange(dimension))
    return matrix[:-1], basis[:-1]
