"""The exponential of small matrices whose rates lie many orders of magnitude apart."""

import jax
import jax.numpy as jnp

_TERMS = 14
_REACH = 0.5
_SQUARINGS = 60


def exponential_less_one(matrix: jax.Array) -> jax.Array:
    """exp(A) - 1, differentiable, in single and double precision.

    Taylor's series of A / 2^n with |A / 2^n| < 1/2, then n times E <- 2 E + E^2: squared without
    the identity, slow rates keep their digits beside fast ones (Higham, Functions of Matrices,
    chapter 10, for scaling and squaring).

    Args:
        matrix: shape (size, size), norm up to 2^60 / 2.
    """
    norm = jax.lax.stop_gradient(jnp.max(jnp.sum(jnp.abs(matrix), axis=1)))
    halvings = jnp.ceil(jnp.log2(jnp.maximum(norm / _REACH, 1.0)))
    scaled = matrix * jnp.exp2(-halvings)

    def product(a: jax.Array, b: jax.Array) -> jax.Array:
        # Not a matrix product: of a batch of small ones this is the vectorised form.
        return jnp.sum(a[:, :, None] * b[None], axis=1)

    def horner(series: jax.Array, order: jax.Array) -> tuple[jax.Array, None]:
        return (scaled + product(scaled, series)) / order, None

    def square(grown: jax.Array, number: jax.Array) -> tuple[jax.Array, None]:
        return jnp.where(number < halvings, 2.0 * grown + product(grown, grown), grown), None

    orders = jnp.arange(_TERMS, 0, -1, dtype=matrix.dtype)
    series, _ = jax.lax.scan(horner, jnp.zeros_like(scaled), orders)
    numbers = jnp.arange(_SQUARINGS, dtype=matrix.dtype)
    return jax.lax.scan(square, series, numbers)[0]
