"""Force that the counts of an encoder make, and the closed loop's bandwidth; both differentiable.

With measurement noise n the force is -C A S n = -P T n, P = m s^2 + c s + k: what holds the joint
on a noisy reading. Rounding to counts of size q is white noise of variance q^2/12 in samples a
period T apart, so the force per count is

    F = sqrt( T / (12 pi) * integral over 0 < w < pi/T of |P(jw) T(jw)|^2 dw ).

Of a sampled loop it is that of the force at the ticks, with the pulse transfer functions for C, A
and S. The velocity's noise is the difference of the position's from tick to tick, filtered where
the velocity is; a loop that samples its velocity otherwise is taken to have as much.

The bandwidth is the first frequency at which the position follows the setpoint by less than
1/sqrt(2): |kp Gp / (1 + L)| with Gp the response of the position to a command.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.analysis.joint.frequency import (
    JointLoop,
    complementary_sensitivity,
    controller_response,
    plant_parts,
    servo_denominator,
)
from jaxact.analysis.sampled.period_map import FORCE, FORCE_RATE, SampledLoop, period_map
from jaxact.analysis.sampled.pulse import PulseTransfer, delays, plant_response, pulse_transfer

_POINTS = 1500
_DECADES = 7.0
_BISECTIONS = 45


def noise_gain(loop: JointLoop, period: float) -> jax.Array:
    """F [N/m]: rms force per count of the encoder, in the loop in continuous time; shape (n,).

    Args:
        loop: fields of shape (n,), stable.
        period: T, time between the encoder's readings [s].
    """
    top = jnp.pi / period
    w = top * jnp.logspace(-_DECADES, 0.0, _POINTS, dtype=loop.kp.dtype)[:, None]
    row = jax.tree.map(lambda a: a[None], loop)
    force = jnp.abs(_plant(row, w)) * jnp.abs(complementary_sensitivity(row, w))
    density = w * force * force  # over ln w
    step = jnp.log(w[1, 0] / w[0, 0])
    area = step * (jnp.sum(density, axis=0) - 0.5 * (density[0] + density[-1]))
    return jnp.sqrt(period / (12.0 * jnp.pi) * area)


def sampled_noise_gain(loop: SampledLoop) -> jax.Array:
    """F [N/m] of the force at the ticks of sampled loops, shape (n,).

    Args:
        loop: fields of shape (n,), stable.
    """

    def one(loop: SampledLoop) -> jax.Array:
        transfer = pulse_transfer(loop)
        theta = jnp.pi * jnp.logspace(-_DECADES, 0.0, _POINTS, dtype=loop.kp.dtype)
        u, s, hold = delays(transfer, theta)
        position, rate = plant_response(transfer, u, s, hold)
        control = loop.kp + loop.kd * counted_rate(transfer, s)
        force = jnp.abs(force_response(loop, u) * control)
        force = force / jnp.abs(1.0 + loop.kp * position + loop.kd * rate)
        density = theta * force * force  # over ln theta
        step = jnp.log(theta[1] / theta[0])
        area = step * (jnp.sum(density) - 0.5 * (density[0] + density[-1]))
        return jnp.sqrt(area / (12.0 * jnp.pi))

    return jax.vmap(one)(loop)


def force_response(loop: SampledLoop, u: jax.Array) -> jax.Array:
    """Force at the ticks by command [-], but for the whole periods of delay; u = exp(-j theta)."""
    phi, older, newer, _ = period_map(loop)
    (a, b), (c, d) = phi[FORCE:, FORCE:]
    # (z - phi) f = older / z + newer, both sides times 1/z = u.
    first, second = ((older[i] * u + newer[i]) * u for i in (FORCE, FORCE_RATE))
    determinant = (1.0 - a * u) * (1.0 - d * u) - b * c * u * u
    return ((1.0 - d * u) * first + b * u * second) / determinant


def counted_rate(transfer: PulseTransfer, s: jax.Array) -> jax.Array:
    """From noise of the position at the ticks to that of the velocity [1/s]; s = 1 - u."""
    pole = transfer.pole if transfer.differenced else jnp.zeros_like(transfer.pole)
    return s / transfer.period * (1.0 - pole) / (1.0 - pole + pole * s)


def follows(loop: JointLoop, w: jax.Array) -> jax.Array:
    """ln |q / r| at w [rad/s]: how the position follows the setpoint; any shape.

    q / r = kp / C(jw) T(jw): the velocity's setpoint is zero.
    """
    real, imaginary = servo_denominator(loop, w)
    stiff, rate = controller_response(loop, w)
    control = jax.lax.complex(stiff + 0.0 * w, rate)
    shift = jax.lax.complex(jnp.cos(w * loop.delay), -jnp.sin(w * loop.delay))
    open_part = -_plant(loop, w) * jax.lax.complex(real, imaginary)
    return jnp.log(loop.kp) - jnp.log(jnp.abs(open_part + control * shift))


def _plant(loop: JointLoop, w: jax.Array) -> jax.Array:
    """-P(jw) = m w^2 - k - j c w [N/m]."""
    if not loop.sprung:
        return loop.mass * w * w
    against, damped = plant_parts(loop, w)
    return jax.lax.complex(against, -damped)


def bandwidth(loop: JointLoop) -> jax.Array:
    """First frequency with |q / r| = 1/sqrt(2) [rad/s], shape (n,).

    0 where a spring holds the joint back so much that it follows no setpoint, however slow.

    Args:
        loop: fields of shape (n,), stable.
    """
    return jax.vmap(lambda one: _where_lost(follows, one, one, jnp.inf))(loop)


def sampled_bandwidth(loop: SampledLoop) -> jax.Array:
    """The same of sampled loops, from position and setpoint at the ticks, shape (n,).

    At most the Nyquist frequency.

    Args:
        loop: fields of shape (n,), stable.
    """

    def one(loop: SampledLoop) -> jax.Array:
        own = loop, pulse_transfer(loop)
        return _where_lost(_sampled_follows, own, loop, jnp.pi / loop.control_period)

    return jax.vmap(one)(loop)


def _sampled_follows(own: tuple[SampledLoop, PulseTransfer], w: jax.Array) -> jax.Array:
    """As `follows`, of one sampled loop."""
    loop, transfer = own
    u, s, hold = delays(transfer, w * loop.control_period)
    position, rate = plant_response(transfer, u, s, hold)
    force = loop.kp * position
    return jnp.log(jnp.abs(force)) - jnp.log(jnp.abs(1.0 + force + loop.kd * rate))


def _where_lost(
    follows: Callable[[Any, jax.Array], jax.Array],
    own: Any,
    loop: JointLoop | SampledLoop,
    top: jax.Array | float,
) -> jax.Array:
    """Where |q / r| of one loop first falls to 1/sqrt(2) [rad/s]; `top` where it never does.

    Args:
        follows: ln |q / r| of what is its `own`, at frequencies [rad/s].
        own: follows from the loop.
        loop: fields scalar.
        top: the highest frequency that there is [rad/s].
    """
    level = -0.5 * jnp.log(2.0)
    still, frozen = jax.lax.stop_gradient((own, loop))
    damped, spring = (
        jnp.zeros_like(frozen.kp) if each is None else each
        for each in (frozen.joint_damping, frozen.joint_stiffness)
    )
    damping = frozen.kd + damped
    stiffness = jnp.maximum(frozen.kp + spring, 1e-3 * frozen.kp)
    rigid = jnp.sqrt(stiffness / frozen.mass)
    high = jnp.minimum(1e3 * rigid, top)
    low = 1e-3 * jnp.minimum(jnp.minimum(rigid, stiffness / damping), high)
    w = low * (high / low) ** jnp.linspace(0.0, 1.0, _POINTS, dtype=rigid.dtype)
    below = follows(still, w) < level
    first = jnp.argmax(below)
    low, high = w[jnp.maximum(first - 1, 0)], w[first]

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = jnp.sqrt(low * high)
        above = follows(still, middle) > level
        return jnp.where(above, middle, low), jnp.where(above, high, middle)

    low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (low, high))
    lost = jnp.sqrt(low * high)
    # One Newton step with the parameters live: the derivative of the implicit function.
    slope = jax.jvp(lambda x: follows(still, x), (lost,), (jnp.ones_like(lost),))[1]
    lost = lost - (follows(own, lost) - level) / slope
    lost = jnp.where(jnp.any(below), lost, top)
    # At rest it follows by kp / (kp + k).
    held = jnp.log(frozen.kp / jnp.maximum(frozen.kp + spring, 1e-300)) > level
    return jnp.where(held, lost, 0.0)
