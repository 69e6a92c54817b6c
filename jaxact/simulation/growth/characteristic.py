"""The spectral radius of a small matrix from its characteristic polynomial.

The polynomial of a Hessenberg matrix follows by La Budde's recurrence, and its largest root by
Graeffe's iteration, which squares the roots of a polynomial without knowing them: after k steps

    log rho = log(max_i |c_i|^(1/i)) / 2^k   within log(n) / 2^k

Where one or two roots are largest, as in nearly all loops, those of x^2 + c_1 x + c_2 have their
size itself. Far fewer operations than the powers of the matrix, and each of them on a number of its
own, so that a batch of small matrices is a small matrix of batches, which vector units want.

Sources: R. Rehman and I. Ipsen, "La Budde's method for computing characteristic polynomials",
arXiv:1104.3769 (2011), algorithm 2; V. Pan, "Solving a polynomial equation: some history and recent
progress", SIAM Review 39 (1997), for Graeffe's iteration and the bound.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

Values = TypeVar("Values")
Kept = Callable[[Values], Values]
# Without it a compiler computes each stage anew for every result of the next one.
_barrier = jax.lax.optimization_barrier


def _same(values: Values) -> Values:
    return values


def polynomial(matrix: list[list[jax.Array]], kept: Kept = _same) -> list[jax.Array]:
    """Coefficients of the characteristic polynomial of an upper Hessenberg matrix.

    Args:
        matrix: n rows of n numbers, each of shape (); below the first subdiagonal is not read.
        kept: static; applied to the results of each stage, see `log_spectral_radius`.

    Returns:
        c_1 ... c_n of x^n + c_1 x^(n-1) + ... + c_n, each of shape ().
    """
    rows: list[list[jax.Array]] = [[]]
    for size in range(1, len(matrix) + 1):
        last = size - 1
        # Coefficients of (x - h) p_(size - 1); the leading ones are not kept.
        smaller = [*rows[last], jnp.zeros(())]
        row = [
            new - matrix[last][last] * old
            for new, old in zip(smaller, [jnp.ones(()), *rows[last]], strict=True)
        ]
        path = jnp.ones(())
        for start in range(last - 1, -1, -1):
            path = path * matrix[start + 1][start]
            factor = path * matrix[start][last]
            lower = [jnp.ones(()), *rows[start]]
            offset = size - len(lower)
            for place, coefficient in enumerate(lower):
                row[offset + place] = row[offset + place] - factor * coefficient
        rows.append(kept(row))
    return rows[-1]


def _squared(coefficients: list[jax.Array]) -> list[jax.Array]:
    """The polynomial whose roots are the squares of this one's."""
    c = [jnp.ones(()), *coefficients]
    degree = len(coefficients)
    squared = []
    for k in range(1, degree + 1):
        total = c[k] * c[k]
        for j in range(1, min(k, degree - k) + 1):
            product = 2.0 * c[k - j] * c[k + j]
            total = total - product if j % 2 else total + product
        squared.append(-total if k % 2 else total)
    return squared


def _exponent(value: jax.Array) -> jax.Array:
    """The smallest power of two above a number's size, as a float; -inf for 0 and subnormals."""
    kind = jnp.finfo(value.dtype)
    whole = jnp.uint32 if kind.bits == 32 else jnp.uint64
    bits = jax.lax.bitcast_convert_type(jnp.abs(value), whole) >> whole(kind.nmant)
    raised = bits.astype(jnp.int32)
    exponent = (raised + (2 - int(kind.maxexp))).astype(value.dtype)
    return jnp.where(raised > 0, exponent, -jnp.inf)


def _power_of_two(exponent: jax.Array) -> jax.Array:
    """2^exponent, of a whole number as a float; the nearest there is where it is beyond range."""
    kind = jnp.finfo(exponent.dtype)
    whole = jnp.uint32 if kind.bits == 32 else jnp.uint64
    within = jnp.clip(exponent, int(kind.minexp), int(kind.maxexp) - 1)
    raised = within.astype(jnp.int32) + (int(kind.maxexp) - 1)
    return jax.lax.bitcast_convert_type(raised.astype(whole) << whole(kind.nmant), exponent.dtype)


def _scaled(coefficients: list[jax.Array]) -> tuple[list[jax.Array], jax.Array]:
    """The polynomial with its roots divided by a power of two, and the power's exponent.

    All roots are within 2 then. Powers of two round nothing, and ask for no logarithm.
    """
    exponent = _exponent(coefficients[0])
    for degree, coefficient in enumerate(coefficients[1:], start=2):
        exponent = jnp.maximum(exponent, _exponent(coefficient) * (1.0 / degree))
    # A polynomial without roots but 0 stays as it is.
    exponent = _barrier(jnp.where(jnp.isneginf(exponent), 0.0, jnp.ceil(exponent)))
    factor = _barrier(_power_of_two(-exponent))
    # A power that would overflow belongs to a coefficient of roots far below the largest one.
    largest = jnp.finfo(factor.dtype).max
    scaled, power = [], factor
    for coefficient in coefficients:
        scaled.append(coefficient * power)
        power = jnp.minimum(power * factor, largest)
    return _barrier(scaled), exponent


def _log_of_two(first: jax.Array, second: jax.Array) -> jax.Array:
    """Logarithm of the larger size of the roots of x^2 + first x + second, shape ()."""
    squared = 0.25 * first * first - second
    real = 0.5 * jnp.abs(first) + jnp.sqrt(jnp.maximum(squared, 0.0))
    return jnp.where(squared < 0.0, 0.5 * jnp.log(jnp.abs(second)), jnp.log(real))


def log_largest_root(coefficients: list[jax.Array], squarings: int) -> jax.Array:
    """Logarithm of the largest modulus of the roots of a polynomial.

    Args:
        coefficients: c_1 ... c_n of x^n + c_1 x^(n-1) + ... + c_n, each of shape ().
        squarings: static; the error is at most about log(n) / 2^squarings, and far less where no
            more than two roots are of the largest size.

    Returns:
        shape (); -inf where every root is 0, NaN where a coefficient is.
    """
    # The largest scaled root is between 1 / 2n and 2: the product of n like it must stay in range.
    degree = len(coefficients)
    longest = int(jnp.finfo(coefficients[0].dtype).maxexp) / (
        degree * math.log2(2.0 * degree) + 2.0
    )
    most = max(1, math.floor(math.log2(max(longest, 1.0))))
    rounds = max(1, -(-squarings // most))
    together = -(-squarings // rounds)

    def square(coefficients, _):
        return _barrier(_squared(coefficients)), None

    def advance(carry, _):
        coefficients, total, weight = carry
        coefficients, exponent = _scaled(coefficients)
        coefficients, _ = jax.lax.scan(square, coefficients, None, length=together, unroll=True)
        return (coefficients, total + weight * exponent, weight / 2.0**together), None

    zero = jnp.zeros_like(coefficients[0])
    carry = coefficients, zero, zero + 1.0
    (last, total, weight), _ = jax.lax.scan(advance, carry, None, length=rounds)
    last, exponent = _scaled(last)
    # Divided by 2^squarings, single precision is plenty, and far cheaper.
    first, *others = (c.astype(jnp.float32) for c in last)
    logs = [_log_of_two(first, others[0] if others else jnp.zeros_like(first))]
    logs += [jnp.log(jnp.abs(c)) / k for k, c in enumerate(others[1:], start=3)]
    bound = functools.reduce(jnp.maximum, logs).astype(total.dtype)
    return math.log(2.0) * (total + weight * exponent) + weight * bound


def log_spectral_radius(
    matrix: list[list[jax.Array]], squarings: int, kept: Kept = _same
) -> jax.Array:
    """Logarithm of the spectral radius of an upper Hessenberg matrix, shape ().

    Args:
        matrix: n rows of n numbers, each of shape ().
        squarings: static; the error is at most log(n) / 2^squarings.
        kept: static; applied to the results of each stage. An optimisation barrier here keeps a
            compiler from computing them wherever they are used.
    """
    return log_largest_root(polynomial(matrix, kept), squarings)
