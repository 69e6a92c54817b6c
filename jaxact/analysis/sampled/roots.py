"""Closed-loop roots of the sampled loop: eigenvalues of its one-period matrix."""

import jax
import jax.numpy as jnp

from jaxact.analysis.sampled.period_map import SampledLoop, one_period_matrix
from jaxact.analysis.sampled.pulse import PulseTransfer, plant_response, pulse_transfer


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
    1 + kp Gp(z) + kd Gv(z) = 0, which does not mind the other eigenvalues.

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

    def open_loop(z: jax.Array) -> jax.Array:
        u = 1.0 / z
        hold = u ** (transfer.steps + 1.0)
        position, rate = plant_response(transfer, u, 1.0 - u, hold)
        return loop.kp * position + loop.kd * rate

    value, slope = jax.jvp(open_loop, (root,), (jnp.ones_like(root),))
    step = value / jax.lax.stop_gradient(slope)
    return jnp.abs(root - (step - jax.lax.stop_gradient(step)))
