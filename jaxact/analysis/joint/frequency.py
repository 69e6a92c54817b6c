"""The loop of one joint on the frequency axis, with the exact delay.

    L(s) = (kp + kd s) / (m s^2) * exp(-s delay) * wn^2 / (s^2 + 2 zeta wn s + wn^2)

The open-loop phase is known without unwrapping, so it is measured from the critical point:

    phase(w) = arg L(jw) + pi = arg(kp + j kd w) - arg D(jw) - w delay,
    D(jw) = 1 - (w/wn)^2 + 2 j zeta w/wn,

and the loop passes the negative real axis wherever `phase` is a multiple of 2 pi. Where the
velocity is filtered, kp + kd s becomes C(s) = kp + kd s / (1 + s tau), tau = 1 / velocity_filter:

    C(jw) = kp(w) + j w kd(w),  kd(w) = kd / (1 + (w tau)^2),  kp(w) = kp + kd(w) w^2 tau,

or, as a fraction of polynomials, C(s) = (kp + (kd + kp tau) s) / (1 + s tau). A joint with damping
c and stiffness k has P(s) = m s^2 + c s + k for m s^2, and arg(-P) beside the other phases.
All functions are elementwise: the fields of the loop and the frequencies broadcast.
"""

from dataclasses import dataclass, fields, replace

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class JointLoop:
    """One joint under continuous PD control through a force servo, or a batch of them.

    The fields broadcast against each other (for a rotary joint read N m and rad).

    Attributes:
        kp: stiffness [N/m], > 0; of a sprung joint of any sign.
        kd: damping [N s/m], >= 0.
        mass: m [kg], > 0.
        natural_frequency: wn of the force servo [rad/s], > 0, inf = ideal.
        damping_ratio: zeta of the force servo [-], > 0, any finite value if ideal.
        delay: sum of command, measurement and output delay [s], >= 0.
        velocity_filter: cutoff of the first-order filter of the velocity that kd acts on [rad/s], >
            0, inf = none; None: no loop of the batch has one, and nothing is computed for it.
        joint_damping: c of the joint itself [N s/m], >= 0; None: of no loop of the batch.
        joint_stiffness: k of the joint itself [N/m], negative where gravity topples it; None as
            before.
    """

    kp: jax.Array
    kd: jax.Array
    mass: jax.Array
    natural_frequency: jax.Array
    damping_ratio: jax.Array
    delay: jax.Array
    velocity_filter: jax.Array | None = None
    joint_damping: jax.Array | None = None
    joint_stiffness: jax.Array | None = None

    @property
    def sprung(self) -> bool:
        """Whether some joint of the batch has a damping or stiffness of its own; static."""
        return self.joint_damping is not None or self.joint_stiffness is not None


def broadcast_loop(loop: JointLoop) -> JointLoop:
    """The same loop with all fields as floating-point arrays of one common shape."""
    if loop.sprung:
        c, k = (0.0 if a is None else a for a in (loop.joint_damping, loop.joint_stiffness))
        loop = replace(loop, joint_damping=c, joint_stiffness=k)
    given = {f.name: getattr(loop, f.name) for f in fields(loop)}
    values = {name: jnp.asarray(value) for name, value in given.items() if value is not None}
    dtype = jnp.result_type(*values.values(), float)
    arrays = jnp.broadcast_arrays(*(v.astype(dtype) for v in values.values()))
    return JointLoop(**dict(zip(values, arrays, strict=True)))


def filter_lag(loop: JointLoop) -> jax.Array | float:
    """tau = 1 / velocity_filter [s], 0 where there is no filter."""
    return 0.0 if loop.velocity_filter is None else 1.0 / loop.velocity_filter


def lead_gain(loop: JointLoop) -> jax.Array:
    """kd + kp tau [N s/m], of C(s) = (kp + (kd + kp tau) s) / (1 + s tau)."""
    return loop.kd if loop.velocity_filter is None else loop.kd + loop.kp * filter_lag(loop)


def controller_response(loop: JointLoop, w: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Real and imaginary part of C(jw) = kp + j w kd / (1 + j w tau) [N/m].

    Args:
        w: frequency [rad/s].
    """
    if loop.velocity_filter is None:
        return loop.kp, loop.kd * w
    turn = w / loop.velocity_filter
    rate = loop.kd * w / (1.0 + turn * turn)
    return loop.kp + rate * turn, rate


def servo_denominator(loop: JointLoop, w: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Real and imaginary part of D(jw) = 1 - (w/wn)^2 + 2 j zeta w/wn [-].

    Args:
        w: frequency [rad/s].
    """
    x = w / loop.natural_frequency
    return (1.0 - x) * (1.0 + x), 2.0 * loop.damping_ratio * x


def plant_parts(loop: JointLoop, w: jax.Array) -> tuple[jax.Array, jax.Array]:
    """m w^2 - k and c w [N/m]: -P(jw) is the first minus j times the second; sprung joints only.

    Args:
        w: frequency [rad/s].
    """
    return loop.mass * w * w - loop.joint_stiffness, loop.joint_damping * w


def _plant_size(loop: JointLoop, w: jax.Array) -> jax.Array:
    """|P(jw)|^2 of a sprung joint, not 0 where it is undamped."""
    real, imaginary = plant_parts(loop, w)
    return jnp.maximum(real**2 + imaginary**2, jnp.finfo(real.dtype).tiny)


def log_gain(loop: JointLoop, w: jax.Array) -> jax.Array:
    """ln |L(jw)| [-].

    Args:
        w: frequency [rad/s], > 0.
    """
    real, imaginary = servo_denominator(loop, w)
    stiff, rate = controller_response(loop, w)
    control = stiff**2 + rate**2
    servo = real**2 + imaginary**2
    if loop.sprung:
        return 0.5 * (jnp.log(control / servo) - jnp.log(_plant_size(loop, w)))
    return 0.5 * jnp.log(control / servo) - jnp.log(loop.mass * w * w)


def log_gain_slope(loop: JointLoop, w: jax.Array) -> jax.Array:
    """d ln |L| / d ln w [-].

    Args:
        w: frequency [rad/s], > 0.
    """
    real, imaginary = servo_denominator(loop, w)
    rate = (lead_gain(loop) * w) ** 2
    x2 = (w / loop.natural_frequency) ** 2
    servo = real**2 + imaginary**2
    control = rate / (loop.kp**2 + rate)
    if loop.velocity_filter is not None:
        turn2 = (w / loop.velocity_filter) ** 2
        control = control - turn2 / (1.0 + turn2)
    fall: jax.Array | float = 2.0
    if loop.sprung:
        stiff, damped = plant_parts(loop, w)
        fall = (2.0 * stiff * loop.mass * w * w + damped**2) / _plant_size(loop, w)
    return control - fall - 2.0 * x2 * (x2 - 1.0 + 2.0 * loop.damping_ratio**2) / servo


def phase(loop: JointLoop, w: jax.Array) -> jax.Array:
    """arg L(jw) + pi, unwrapped [rad]: 0 at w = 0+ for kp > 0, multiples of 2 pi are critical.

    Of a sprung joint with k > 0 it starts at pi, and for kp < 0 by pi higher.

    Args:
        w: frequency [rad/s], >= 0.
    """
    real, imaginary = servo_denominator(loop, w)
    stiff, rate = controller_response(loop, w)
    lead = jnp.arctan2(rate, stiff)
    if loop.sprung:
        against, damped = plant_parts(loop, w)
        lead = lead + jnp.arctan2(damped, against)
    return lead - jnp.arctan2(imaginary, real) - w * loop.delay


def phase_slope(loop: JointLoop, w: jax.Array) -> jax.Array:
    """d phase / d ln w [rad].

    Args:
        w: frequency [rad/s], >= 0.
    """
    real, imaginary = servo_denominator(loop, w)
    x = w / loop.natural_frequency
    lead_rate = lead_gain(loop) * w
    lead = loop.kp * lead_rate / (loop.kp**2 + lead_rate**2)
    if loop.velocity_filter is not None:
        turn = w / loop.velocity_filter
        lead = lead - turn / (1.0 + turn * turn)
    lag = 2.0 * loop.damping_ratio * x * (1.0 + x * x) / (real**2 + imaginary**2)
    if loop.sprung:
        damped = loop.joint_damping * w
        lag = lag + damped * (loop.mass * w * w + loop.joint_stiffness) / _plant_size(loop, w)
    return lead - lag - w * loop.delay


def loop_response(loop: JointLoop, w: jax.Array) -> jax.Array:
    """L(jw) [-], complex.

    Args:
        w: frequency [rad/s], > 0.
    """
    real, imaginary = servo_denominator(loop, w)
    stiff, rate = controller_response(loop, w)
    control = jax.lax.complex(stiff + 0.0 * w, rate)
    shift = jax.lax.complex(jnp.cos(w * loop.delay), -jnp.sin(w * loop.delay))
    plant = loop.mass * w * w
    if loop.sprung:
        against, damped = plant_parts(loop, w)
        plant = jax.lax.complex(against, -damped)
    return -control * shift / (plant * jax.lax.complex(real, imaginary))


def sensitivity(loop: JointLoop, w: jax.Array) -> jax.Array:
    """S(jw) = 1 / (1 + L(jw)) [-], complex; w: frequency [rad/s], > 0."""
    return 1.0 / (1.0 + loop_response(loop, w))


def complementary_sensitivity(loop: JointLoop, w: jax.Array) -> jax.Array:
    """T(jw) = L(jw) / (1 + L(jw)) [-], complex; w: frequency [rad/s], > 0."""
    response = loop_response(loop, w)
    return response / (1.0 + response)
