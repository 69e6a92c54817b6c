"""Closed-loop roots of the sampled loop: eigenvalues of its one-period matrix."""

import math

import jax
import jax.numpy as jnp

from jaxact.analysis.sampled.period_map import SampledLoop, one_period_matrix
from jaxact.analysis.sampled.pulse import PulseTransfer, characteristic, pulse_transfer


def sampled_roots(loop: SampledLoop, max_delay_steps: int) -> jax.Array:
    """Eigenvalues of the one-period matrix [-], complex, of one loop; NaN if the delay is too long.

    Not differentiable: held commands that no longer act give defective eigenvalues at 0.

    Args:
        loop: fields scalar.
        max_delay_steps: as in `one_period_matrix`.
    """
    matrix = jax.lax.stop_gradient(one_period_matrix(loop, max_delay_steps))
    fits = jnp.all(jnp.isfinite(matrix))
    roots = jnp.linalg.eigvals(jnp.where(fits, matrix, 0.0))
    return jnp.where(fits, roots, jnp.nan)


def spectral_radius(loop: SampledLoop, max_delay_steps: int) -> jax.Array:
    """Largest |eigenvalue| over one control period [-], of one loop; below 1 = stable.

    The value is that of the eigenvalue z; the derivative is that of the implicit function
    Delta(z) = 0 of `characteristic`, which does not mind the other eigenvalues.

    Args:
        loop: fields scalar.
        max_delay_steps: as in `one_period_matrix`.
    """
    roots = sampled_roots(loop, max_delay_steps)
    return dominant_modulus(loop, pulse_transfer(loop), roots)


def dominant_modulus(loop: SampledLoop, transfer: PulseTransfer, roots: jax.Array) -> jax.Array:
    """max |z| [-] over the roots of one loop, differentiable by the loop's fields.

    Args:
        transfer: the loop's `pulse_transfer`.
        roots: of `sampled_roots`, constant, shape (k,).
    """
    root = roots[jnp.argmax(jnp.abs(roots))]

    def delta(z: jax.Array) -> jax.Array:
        return characteristic(transfer, loop.kp, loop.kd, z)

    value, slope = jax.jvp(delta, (root,), (jnp.ones_like(root),))
    slope = jax.lax.stop_gradient(slope)
    # Of a double root, as of a free mass without gains, there is no derivative.
    step = jnp.where(slope == 0.0, 0.0, value / jnp.where(slope == 0.0, 1.0, slope))
    return jnp.abs(root - (step - jax.lax.stop_gradient(step)))


def count_unstable(loop: SampledLoop, roots: jax.Array) -> jax.Array:
    """Number of roots that are not inside the unit circle, int32; what is not a number counts.

    Args:
        loop: fields scalar.
        roots: of `sampled_roots`, shape (k,).
    """
    known = _on_circle(loop)
    # Rounding moves the roots of a double root at 1 apart, by the square root of its size.
    slack = jnp.where(known > 0, 4.0 * math.sqrt(float(jnp.finfo(jnp.abs(roots).dtype).eps)), 0.0)
    outside = jnp.sum(~(jnp.abs(roots) < 1.0 - slack)).astype(jnp.int32)
    return jnp.maximum(outside, known)


def _on_circle(loop: SampledLoop) -> jax.Array:
    """How many roots are known to be on the unit circle, where rounding may put them inside it.

    One at z = 1 where no stiffness holds the joint, kp + k = 0; two where a spring without damping
    swings by itself.
    """
    damping, stiffness = loop.joint or (0.0, 0.0)
    swings = (loop.kp == 0.0) & (loop.kd == 0.0) & (damping == 0.0)
    adrift = jnp.where(loop.kp + stiffness == 0.0, 1, 0)
    return jnp.where(swings & (stiffness >= 0.0), 2, adrift).astype(jnp.int32)
