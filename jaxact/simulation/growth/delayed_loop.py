"""The open loop of one joint with a long delay line, on the plane of log z.

    L(z) = z^-(D+1) Q(1/z) z^(2n) / prod_i (w^2 + b_i w + c_i),    w = z - 1,

with a few open-loop poles in n quadratic factors, a short polynomial Q, and D whole control periods
of delay. With z = exp(sigma + j theta), w = expm1(sigma + j theta), so that poles close to z = 1 (a
slow actuator at a high control rate) lose no digits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DelayedLoop:
    """L(z) of one loop.

    Attributes:
        factors: (b_i, c_i) of w^2 + b w + c [-], shape (n, 2).
        numerator: Q, coefficients of 1, u, u^2, ... with u = 1/z, shape (m,).
        delay: D, whole control periods, as a float, shape ().
    """

    factors: jax.Array
    numerator: jax.Array
    delay: jax.Array


Pair = tuple[Any, Any]
"""Real and imaginary part."""
apart = jax.lax.optimization_barrier
"""The same values, so that what needs them does not compute them anew."""


def _plus(x: Pair, y: Pair) -> Pair:
    """Sum of complex numbers as pairs of real ones."""
    return x[0] + y[0], x[1] + y[1]


def _times(x: Pair, y: Pair) -> Pair:
    """Product of complex numbers as pairs of real ones."""
    return x[0] * y[0] - x[1] * y[1], x[0] * y[1] + x[1] * y[0]


def _over(x: Pair, y: Pair) -> Pair:
    """Quotient of complex numbers as pairs of real ones."""
    size = y[0] * y[0] + y[1] * y[1]
    return (x[0] * y[0] + x[1] * y[1]) / size, (x[1] * y[0] - x[0] * y[1]) / size


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Logarithm:
    """log L somewhere.

    Attributes:
        size: its real part.
        short: phase of the short polynomials [rad], between -pi and pi.
        late: by how much the delay turns it back [rad].
        slope: derivative by zeta.
    """

    size: jax.Array
    short: jax.Array
    late: jax.Array
    slope: Pair


def poles(loop: DelayedLoop) -> jax.Array:
    """zeta of the open-loop poles with positive imaginary part or real, shape (2 n,)."""
    b, c = loop.factors[:, 0], loop.factors[:, 1]
    square = 0.25 * b * b - c
    root = jnp.sqrt(jnp.abs(square))
    far = -0.5 * b - jnp.where(b >= 0.0, root, -root)
    near = jnp.where(far == 0.0, 0.0, c / jnp.where(far == 0.0, 1.0, far))
    real = square >= 0.0
    w = jnp.concatenate(
        [
            jax.lax.complex(jnp.where(real, far, -0.5 * b), jnp.where(real, 0.0, root)),
            jax.lax.complex(jnp.where(real, near, -0.5 * b), jnp.where(real, 0.0, root)),
        ]
    )
    size = 2.0 * w.real + w.real**2 + w.imag**2
    tiny = jnp.finfo(size.dtype).eps - 1.0
    return jax.lax.complex(0.5 * jnp.log1p(jnp.maximum(size, tiny)), jnp.angle(1.0 + w))


def logarithm(loop: DelayedLoop, sigma: jax.Array, theta: jax.Array) -> Logarithm:
    """Of log L at exp(sigma + j theta), elementwise; in real numbers, which vector units like."""
    # Apart from each other, or a compiler computes each stage anew for every result of the next.
    half, other = apart((jnp.sin(0.5 * theta), jnp.cos(0.5 * theta)))
    grown = jnp.exp(sigma)
    cosine, sine = 1.0 - 2.0 * half * half, 2.0 * half * other
    z = grown * cosine, grown * sine
    w = jnp.expm1(sigma) - 2.0 * grown * half * half, z[1]
    u = cosine / grown, -sine / grown
    value = loop.numerator[-1] + 0.0 * theta, 0.0 * theta
    slope = 0.0 * theta, 0.0 * theta
    for coefficient in loop.numerator[-2::-1]:
        slope = _plus(_times(slope, u), value)
        value = _plus(_times(value, u), (coefficient, 0.0))
    # Without gains there is no loop; a logarithm of nothing would not be a number.
    tiny = jnp.sqrt(jnp.finfo(theta.dtype).tiny)
    value = jnp.where((value[0] == 0.0) & (value[1] == 0.0), tiny, value[0]), value[1]
    product, relative = (1.0 + 0.0 * theta, 0.0 * theta), (0.0 * theta, 0.0 * theta)
    for b, c in loop.factors:
        factor = _plus(_times(_plus(w, (b, 0.0)), w), (c, 0.0))
        product = _times(product, factor)
        relative = _plus(relative, _over((2.0 * w[0] + b, 2.0 * w[1]), factor))
    value, slope, product, relative = apart((value, slope, product, relative))
    ratio = apart(_over(value, product))
    order = loop.delay + 1.0 - 2.0 * loop.factors.shape[0]
    of_value = _over(_times(u, slope), value)
    of_product = _times(relative, z)
    at = Logarithm(
        size=0.5 * jnp.log(ratio[0] ** 2 + ratio[1] ** 2) - order * sigma,
        short=jnp.arctan2(ratio[1], ratio[0]),
        late=order * theta,
        slope=(-of_value[0] - of_product[0] - order, -of_value[1] - of_product[1]),
    )
    return apart(at)


def newton_step(at: Logarithm) -> Pair:
    """Newton's step for log(-L) = 0 on its nearest branch."""
    miss = -at.size, -wrapped(at.short - at.late - math.pi)
    return _over(miss, at.slope)


def wrapped(angle: jax.Array) -> jax.Array:
    """The same angle between -pi and pi."""
    return angle - 2.0 * math.pi * jnp.round(angle / (2.0 * math.pi))


def denominator(factors: jax.Array) -> jax.Array:
    """Coefficients of the product of the factors in falling powers of z, shape (2 n + 1,)."""
    product = jnp.ones((1,), factors.dtype)
    for b, c in factors:
        product = jnp.convolve(product, jnp.stack([jnp.ones_like(b), b - 2.0, 1.0 - b + c]))
    return product
