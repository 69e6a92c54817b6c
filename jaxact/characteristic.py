"""The spectral radius of a small matrix from its characteristic polynomial.

The polynomial of a Hessenberg matrix follows by La Budde's recurrence, and its largest root by
Graeffe's iteration, which squares the roots of a polynomial without knowing them: after k steps

    log rho = log(max_i |c_i|^(1/i)) / 2^k   within log(n) / 2^k

Far fewer operations than the powers of the matrix, and each of them on a number of its own, so that
a batch of small matrices is a small matrix of batches, which is what vector units want.

Sources: R. Rehman and I. Ipsen, "La Budde's method for computing characteristic polynomials",
arXiv:1104.3769 (2011), algorithm 2; V. Pan, "Solving a polynomial equation: some history and recent
progress", SIAM Review 39 (1997), for Graeffe's iteration and the bound.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp

Values = TypeVar("Values")
Kept = Callable[[Values], Values]


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


def _scaled(coefficients: list[jax.Array]) -> tuple[list[jax.Array], jax.Array]:
    """The polynomial with its roots divided by a bound of them, and the logarithm of the bound."""
    logs = [jnp.log(jnp.abs(c)) / (k + 1) for k, c in enumerate(coefficients)]
    bound = logs[0]
    for log in logs[1:]:
        bound = jnp.maximum(bound, log)
    # A polynomial without roots but 0 stays as it is.
    factor = jnp.exp(-jnp.where(jnp.isneginf(bound), 0.0, bound))
    # A power that would overflow belongs to a coefficient of roots far below the largest one.
    largest = jnp.finfo(factor.dtype).max
    scaled, power = [], factor
    for coefficient in coefficients:
        scaled.append(coefficient * power)
        power = jnp.minimum(power * factor, largest)
    return scaled, bound


def log_largest_root(
    coefficients: list[jax.Array], squarings: int, kept: Kept = _same
) -> jax.Array:
    """Logarithm of the largest modulus of the roots of a polynomial.

    Args:
        coefficients: c_1 ... c_n of x^n + c_1 x^(n-1) + ... + c_n, each of shape ().
        squarings: static; the error is at most log(n) / 2^squarings.
        kept: static; applied to the results of each stage, see `log_spectral_radius`.

    Returns:
        shape (); -inf where every root is 0, NaN where a coefficient is.
    """
    # Scaled roots are within 2, so that their product after this many squarings is no overflow.
    exponent = int(jnp.finfo(coefficients[0].dtype).maxexp)
    together = max(1, (exponent // (len(coefficients) + 2)).bit_length() - 1)

    def square(coefficients, _):
        return kept(_squared(coefficients)), None

    def advance(carry, _):
        coefficients, total, weight = carry
        coefficients, _ = jax.lax.scan(square, coefficients, None, length=together)
        weight = weight / 2.0**together
        coefficients, bound = _scaled(coefficients)
        return (coefficients, total + weight * bound, weight), None

    scaled, bound = _scaled(coefficients)
    carry = scaled, bound, jnp.ones_like(bound)
    (_, total, _), _ = jax.lax.scan(advance, carry, None, length=-(-squarings // together))
    return total


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
    return log_largest_root(polynomial(matrix, kept), squarings, kept)
