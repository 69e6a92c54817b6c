"""Force that the counts of an encoder make, and the closed loop's bandwidth; both differentiable.

With measurement noise n the force is -C A S n = -P T n, P = m s^2 + c s + k: what holds the joint
on a noisy reading. Rounding to counts of size q is white noise of variance q^2/12 in samples a
period T apart, so the force per count is

    F = sqrt( T / (12 pi) * integral over 0 < w < pi/T of |P(jw) T(jw)|^2 dw ).

The bandwidth is the first frequency at which the position follows the setpoint by less than
1/sqrt(2): |kp Gp / (1 + L)| with Gp the response of the position to a command.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from jaxact.analysis.joint.frequency import (
    JointLoop,
    complementary_sensitivity,
    controller_response,
    plant_parts,
    servo_denominator,
)

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

    Args:
        loop: fields of shape (n,), stable.
    """
    level = -0.5 * jnp.log(2.0)
    frozen = jax.lax.stop_gradient(loop)
    stiffness = frozen.kp
    if loop.sprung:
        stiffness = jnp.maximum(frozen.kp + frozen.joint_stiffness, 1e-3 * frozen.kp)
    rigid = jnp.sqrt(stiffness / frozen.mass)
    slow = frozen.kp / frozen.kd
    low, high = 1e-3 * jnp.minimum(rigid, slow), 1e3 * rigid
    fraction = jnp.linspace(0.0, 1.0, _POINTS, dtype=rigid.dtype)[:, None]
    w = low[None] * (high / low)[None] ** fraction
    row = jax.tree.map(lambda a: a[None], frozen)
    below = follows(row, w) < level
    first = jnp.argmax(below, axis=0)
    low = jnp.take_along_axis(w, jnp.maximum(first - 1, 0)[None], axis=0)[0]
    high = jnp.take_along_axis(w, first[None], axis=0)[0]

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = jnp.sqrt(low * high)
        above = follows(frozen, middle) > level
        return jnp.where(above, middle, low), jnp.where(above, high, middle)

    low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (low, high))
    w = jnp.sqrt(low * high)
    # One Newton step with the parameters live: the derivative of the implicit function.
    slope = jax.jvp(lambda x: follows(frozen, x), (w,), (jnp.ones_like(w),))[1]
    return w - (follows(loop, w) - level) / slope
