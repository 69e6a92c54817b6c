"""The positive roots of polynomials, by bisection between the roots of their derivatives.

All arrays carry roots on axis 0 and the batch behind it.
"""

import math
from functools import reduce

import jax
import jax.numpy as jnp

_CUBIC_STEPS = 44


def positive_cubic_roots(
    coefficients: list[jax.Array], scale: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The roots y > 0 of c0 + c1 y + c2 y^2 + c3 y^3, and which there are, shape (3, ...).

    With y = scale * s / (1 - s) it becomes a cubic on 0 < s < 1, whatever its degree; the roots of
    its derivative split that into three parts, each bisected.

    Args:
        coefficients: c0 ... c3, real, each of shape (1, ...).
        scale: a typical size of the roots, shape (1, ...), > 0.
    """
    c = [a * scale**i for i, a in enumerate(coefficients)]
    largest = jnp.maximum(
        jnp.maximum(jnp.abs(c[0]), jnp.abs(c[1])), jnp.maximum(jnp.abs(c[2]), jnp.abs(c[3]))
    )
    c = [a / jnp.where(largest > 0, largest, 1.0) for a in c]
    # Powers of s of sum_i c_i s^i (1 - s)^(3 - i).
    p0 = c[0]
    p1 = c[1] - 3.0 * c[0]
    p2 = c[2] - 2.0 * c[1] + 3.0 * c[0]
    p3 = c[3] - c[2] + c[1] - c[0]

    def cubic(s: jax.Array) -> jax.Array:
        return p0 + s * (p1 + s * (p2 + s * p3))

    first, second = _quadratic_roots(p1, 2.0 * p2, 3.0 * p3)
    left = jnp.concatenate([jnp.zeros_like(first), first, second])
    right = jnp.concatenate([first, second, jnp.ones_like(first)])
    rising = cubic(left) < 0.0
    present = rising != (cubic(right) < 0.0)

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = 0.5 * (low + high)
        before = (cubic(middle) < 0.0) == rising
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    low, high = jax.lax.fori_loop(0, _CUBIC_STEPS, halve, (left, right))
    s = 0.5 * (low + high)
    # Where the degree is lower, s = 1 is a root that only rounding places inside.
    rounding = 64.0 * jnp.finfo(s.dtype).eps
    present = present & (s < 1.0 - rounding)
    roots = scale * s / jnp.maximum(1.0 - s, rounding)
    return jnp.where(present, roots, scale), present


def _quadratic_roots(a: jax.Array, b: jax.Array, c: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Ordered real parts of the roots of a + b s + c s^2, clipped to [0, 1]."""
    discriminant = jnp.sqrt(jnp.maximum(b * b - 4.0 * a * c, 0.0))
    q = -0.5 * (b + jnp.where(b < 0, -discriminant, discriminant))
    one = a / jnp.where(q == 0, 1.0, q)
    two = q / jnp.where(c == 0, 1.0, c)
    one = jnp.where(q == 0, 0.0, one)
    two = jnp.where(c == 0, 1.0, two)
    one, two = jnp.clip(one, 0.0, 1.0), jnp.clip(two, 0.0, 1.0)
    return jnp.minimum(one, two), jnp.maximum(one, two)


def positive_roots(coefficients: list[jax.Array], scale: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The roots y > 0 of c0 + c1 y + ... + cn y^n, and which there are, shape (n, ...).

    As `positive_cubic_roots`, the polynomial on 0 < s < 1 split by the roots of its derivative, and
    those by the roots of the derivative's derivative, and so on. Slots of missing roots hold
    `scale`.

    Args:
        coefficients: c0 ... cn, real, each of shape (1, ...), n >= 3.
        scale: a typical size of the roots, shape (1, ...), > 0.
    """
    degree = len(coefficients) - 1
    c = [a * scale**i for i, a in enumerate(coefficients)]
    largest = reduce(jnp.maximum, map(jnp.abs, c))
    c = [a / jnp.where(largest > 0, largest, 1.0) for a in c]
    # Powers of s of sum_i c_i s^i (1 - s)^(n - i).
    p = [jnp.zeros_like(c[0]) for _ in c]
    for i, a in enumerate(c):
        for k in range(i, degree + 1):
            p[k] = p[k] + a * (-1.0) ** (k - i) * math.comb(degree - i, k - i)
    chain = [p]
    while len(chain[-1]) > 3:
        chain.append([k * chain[-1][k] for k in range(1, len(chain[-1]))])
    quadratic = chain.pop()
    s = jnp.concatenate(_quadratic_roots(quadratic[0], quadratic[1], quadratic[2]))
    present = jnp.zeros_like(s, dtype=bool)
    for part in reversed(chain):
        s, present = _roots_between(part, s)
    rounding = 64.0 * jnp.finfo(s.dtype).eps
    present = present & (s < 1.0 - rounding)
    return jnp.where(present, scale * s / jnp.maximum(1.0 - s, rounding), scale), present


def _roots_between(coefficients: list[jax.Array], splits: jax.Array) -> tuple[jax.Array, jax.Array]:
    """One point of each of the parts of [0, 1], its root where it has one; ascending, (k + 1, ...).

    Args:
        coefficients: of powers of s; the polynomial is monotone between splits.
        splits: in [0, 1], ascending, shape (k, ...).
    """

    def value(s: jax.Array) -> jax.Array:
        total = jnp.zeros_like(s)
        for coefficient in reversed(coefficients):
            total = coefficient + s * total
        return total

    edge = jnp.zeros_like(splits[:1])
    left, right = jnp.concatenate([edge, splits]), jnp.concatenate([splits, edge + 1.0])
    rising = value(left) < 0.0
    present = rising != (value(right) < 0.0)

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = 0.5 * (low + high)
        before = (value(middle) < 0.0) == rising
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    low, high = jax.lax.fori_loop(0, _CUBIC_STEPS, halve, (left, right))
    return 0.5 * (low + high), present


def apart(factors: tuple[float, ...], like: jax.Array) -> jax.Array:
    """Distinct factors along axis 0, for slots that hold nothing: points must not coincide."""
    column = jnp.asarray(factors, dtype=like.dtype)
    return column.reshape((-1,) + (1,) * (like.ndim - 1))


def insert_sorted(rows: jax.Array, value: jax.Array) -> jax.Array:
    """`value`, shape (1, ...), put in its place among rows ascending along axis 0, shape (k, ...).

    out_i = max(row_{i-1}, min(value, row_i)): elementwise, so vectorised over the batch.
    """
    edge = jnp.full_like(value, jnp.inf)
    below = jnp.concatenate([-edge, rows])
    above = jnp.concatenate([rows, edge])
    return jnp.maximum(below, jnp.minimum(value, above))


def sort_rows(values: jax.Array) -> jax.Array:
    """Sorted along axis 0, by insertion: made for a handful of rows and a large batch."""
    rows = values[:1]
    for i in range(1, values.shape[0]):
        rows = insert_sorted(rows, values[i : i + 1])
    return rows
