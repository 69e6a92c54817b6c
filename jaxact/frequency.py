"""The loop of one joint on the frequency axis, with the exact delay.

    L(s) = (kp + kd s) / (m s^2) * exp(-s delay) * wn^2 / (s^2 + 2 zeta wn s + wn^2)

The open-loop phase is known without unwrapping, so it is measured from the critical point:

    phase(w) = arg L(jw) + pi = arg(kp + j kd w) - arg D(jw) - w delay,
    D(jw) = 1 - (w/wn)^2 + 2 j zeta w/wn,

and the loop passes the negative real axis wherever `phase` is a multiple of 2 pi.
All functions are elementwise: the fields of the loop and the frequencies broadcast.
"""

from dataclasses import dataclass, fields
from functools import partial

import jax
import jax.numpy as jnp


@partial(
    jax.tree_util.register_dataclass,
    data_fields=["kp", "kd", "mass", "natural_frequency", "damping_ratio", "delay"],
    meta_fields=[],
)
@dataclass(frozen=True)
class JointLoop:
    """One joint under continuous PD control through a force servo, or a batch of them.

    The fields broadcast against each other (for a rotary joint read N m and rad).

    kp: stiffness [N/m], > 0
    kd: damping [N s/m], >= 0
    mass: m [kg], > 0
    natural_frequency: wn of the force servo [rad/s], > 0, inf = ideal
    damping_ratio: zeta of the force servo [-], > 0, any finite value if ideal
    delay: sum of command, measurement and output delay [s], >= 0
    """

    kp: jax.Array
    kd: jax.Array
    mass: jax.Array
    natural_frequency: jax.Array
    damping_ratio: jax.Array
    delay: jax.Array


def broadcast_loop(loop: JointLoop) -> JointLoop:
    """The same loop with all fields as floating-point arrays of one common shape."""
    values = [jnp.asarray(getattr(loop, f.name)) for f in fields(loop)]
    dtype = jnp.result_type(*values, float)
    return JointLoop(*jnp.broadcast_arrays(*(v.astype(dtype) for v in values)))


def servo_denominator(loop: JointLoop, w: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Real and imaginary part of D(jw) = 1 - (w/wn)^2 + 2 j zeta w/wn [-].

    w: frequency [rad/s]
    """
    x = w / loop.natural_frequency
    return (1.0 - x) * (1.0 + x), 2.0 * loop.damping_ratio * x


def log_gain(loop: JointLoop, w: jax.Array) -> jax.Array:
    """ln |L(jw)| [-].

    w: frequency [rad/s], > 0
    """
    real, imaginary = servo_denominator(loop, w)
    control = loop.kp**2 + (loop.kd * w) ** 2
    servo = real**2 + imaginary**2
    return 0.5 * jnp.log(control / servo) - jnp.log(loop.mass * w * w)


def log_gain_slope(loop: JointLoop, w: jax.Array) -> jax.Array:
    """d ln |L| / d ln w [-].

    w: frequency [rad/s], > 0
    """
    real, imaginary = servo_denominator(loop, w)
    rate = (loop.kd * w) ** 2
    x2 = (w / loop.natural_frequency) ** 2
    servo = real**2 + imaginary**2
    control = rate / (loop.kp**2 + rate)
    return control - 2.0 - 2.0 * x2 * (x2 - 1.0 + 2.0 * loop.damping_ratio**2) / servo


def phase(loop: JointLoop, w: jax.Array) -> jax.Array:
    """arg L(jw) + pi, unwrapped [rad]: 0 at w = 0+ for kp > 0, multiples of 2 pi are critical.

    w: frequency [rad/s], >= 0
    """
    real, imaginary = servo_denominator(loop, w)
    lead = jnp.arctan2(loop.kd * w, loop.kp)
    return lead - jnp.arctan2(imaginary, real) - w * loop.delay


def phase_slope(loop: JointLoop, w: jax.Array) -> jax.Array:
    """d phase / d ln w [rad].

    w: frequency [rad/s], >= 0
    """
    real, imaginary = servo_denominator(loop, w)
    x = w / loop.natural_frequency
    lead = loop.kp * loop.kd * w / (loop.kp**2 + (loop.kd * w) ** 2)
    lag = 2.0 * loop.damping_ratio * x * (1.0 + x * x) / (real**2 + imaginary**2)
    return lead - lag - w * loop.delay


def loop_response(loop: JointLoop, w: jax.Array) -> jax.Array:
    """L(jw) [-], complex.

    w: frequency [rad/s], > 0
    """
    real, imaginary = servo_denominator(loop, w)
    control = jax.lax.complex(loop.kp + 0.0 * w, loop.kd * w)
    shift = jax.lax.complex(jnp.cos(w * loop.delay), -jnp.sin(w * loop.delay))
    return -control * shift / (loop.mass * w * w * jax.lax.complex(real, imaginary))


def sensitivity(loop: JointLoop, w: jax.Array) -> jax.Array:
    """S(jw) = 1 / (1 + L(jw)) [-], complex; w: frequency [rad/s], > 0."""
    return 1.0 / (1.0 + loop_response(loop, w))


def complementary_sensitivity(loop: JointLoop, w: jax.Array) -> jax.Array:
    """T(jw) = L(jw) / (1 + L(jw)) [-], complex; w: frequency [rad/s], > 0."""
    response = loop_response(loop, w)
    return response / (1.0 + response)
