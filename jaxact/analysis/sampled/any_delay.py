"""L of one sampled loop with any delay; what the delay does not change is computed once.

Of x_{k+1} = Phi x_k + Gamma_old u_{k-d-1} + Gamma_new u_{k-d} the delay enters Gamma_new, Gamma_old
and d. A command that is held for a whole period does not feel it: Gamma_old + Gamma_new is Gamma,
the Gamma_new of no delay. With u = z^{-1} = exp(-j theta) and s = 1 - u this leaves

    L = u^{d+1} g(u) (u Gamma + s Gamma_new),    g(u) = (kp C_q + kd C_w) (1 - u Phi)^{-1},

where C_q and C_w read the position and the controller's velocity. g(u) is a polynomial for each of
the four states, of degree 3, over the denominators of `jaxact.analysis.sampled.pulse`.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from jaxact.analysis.sampled.period_map import POSITION, VELOCITY, SampledLoop, newer_command
from jaxact.analysis.sampled.pulse import (
    PulseTransfer,
    delay_polynomials,
    denominators,
    polynomial,
)
from jaxact.compilation.once import once

_STATES = 4


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class AnyDelay:
    """One loop whose delay is left open.

    Attributes:
        transfer: of the loop; its delay is not used.
        position, velocity: numerators of C_q (1 - u Phi)^{-1} and of the velocity's, coefficients
            by rising degree and state, shape (4, 4); the second of a velocity that is sampled.
        whole: Gamma, shape (4,).
    """

    transfer: PulseTransfer
    position: jax.Array
    velocity: jax.Array
    whole: jax.Array


def any_delay(transfer: PulseTransfer, phi: jax.Array, whole: jax.Array) -> AnyDelay:
    """The loop of a pulse-transfer function with another delay than its own.

    Args:
        transfer: of one loop.
        phi: Phi, shape (4, 4).
        whole: Gamma, shape (4,).
    """
    double, single = delay_polynomials(transfer)
    return AnyDelay(
        transfer,
        position=_numerators(double, phi, POSITION),
        velocity=_numerators(single, phi, VELOCITY),
        whole=whole,
    )


def _numerators(denominator: jax.Array, phi: jax.Array, output: int) -> jax.Array:
    """Coefficients of the denominator times row `output` of (1 - u Phi)^{-1}, up to degree 3."""
    rows = [jnp.eye(_STATES, dtype=phi.dtype)[output]]
    for _ in range(_STATES - 1):
        rows.append(jnp.sum(rows[-1][:, None] * phi, axis=0))
    return jnp.stack([
        sum((denominator[degree - k] * rows[k] for k in range(degree + 1)
             if degree - k < len(denominator)), start=jnp.zeros_like(rows[0]))
        for degree in range(_STATES)
    ])  # fmt: skip


def in_two_parts(
    loop: SampledLoop, late: AnyDelay, theta: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """u, u g(u) Gamma and s g(u), so that L = u^{d+1} (the second + the third Gamma_new).

    Args:
        loop: one loop; its delay is not used.
        late: of it.
        theta: [rad], shape (n,).

    Returns:
        complex, shape (n,), (n,) and (4, n).
    """
    half = 0.5 * theta
    u = jax.lax.complex(jnp.cos(theta), -jnp.sin(theta))
    s = 2.0 * jnp.sin(half) * jax.lax.complex(jnp.sin(half), jnp.cos(half))
    transfer = late.transfer
    servo, own, single = denominators(transfer, s)
    if transfer.differenced:
        by_state = polynomial(late.position[:, :, None], u[None]) / (own * servo)[None]
        pole = transfer.pole
        rate = s / transfer.period * (1.0 - pole) / (1.0 - pole + pole * s)
        by_state = (loop.kp + loop.kd * rate)[None] * by_state
    else:
        both = jnp.stack([late.position, late.velocity], axis=1)
        denominator = jnp.stack([own * servo, single * servo])
        position, velocity = polynomial(both[..., None], u[None, None]) / denominator[:, None]
        by_state = loop.kp * position + loop.kd * velocity
    by_state = once(by_state)
    held = jnp.sum(by_state * late.whole[:, None], axis=0)
    return u, u * held, s[None] * by_state


def response_with(
    loop: SampledLoop, late: AnyDelay, newer: jax.Array, steps: jax.Array | float, theta: jax.Array
) -> jax.Array:
    """L(exp(j theta)) [-], complex, with a delay of whole periods and the part that gives `newer`.

    Args:
        loop, late: as for `in_two_parts`.
        newer: Gamma_new, shape (4,).
        steps: d, whole.
        theta: [rad], shape (n,).
    """
    _, held, moved = in_two_parts(loop, late, theta)
    return hold(theta, steps) * (held + jnp.sum(moved * newer[:, None], axis=0))


def hold(theta: jax.Array, steps: jax.Array | float) -> jax.Array:
    """u^{d+1} of theta [rad], complex."""
    lag = theta * (steps + 1.0)
    return jax.lax.complex(jnp.cos(lag), -jnp.sin(lag))


def at_parts(loop: SampledLoop, parts: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Phi, shape (4, 4), and Gamma_new after each of some parts of a period, shape (n, 4).

    Args:
        loop: one loop.
        parts: [-], shape (n,), the first of which is 0.
    """
    phi, newer, _ = jax.vmap(lambda part: newer_command(loop, part * loop.control_period))(parts)
    return phi[0], newer
