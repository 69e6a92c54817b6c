"""The closed force loop of an actuator: second order with a delay, then saturation.

    f'' + 2 zeta wn f' + wn^2 f = wn^2 u(t - delay)

The command ``u`` is held between control ticks, so the response over a step is known in closed
form (the exponential of the 2 x 2 companion matrix) and is used as such: no integration error.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import factorial, inf

import jax
import jax.numpy as jnp

from jaxact.drive.joint_motion import Joint, Rows
from jaxact.drive.joint_motion import rows as joint_rows

# Below this many (damped) radians the closed forms of the integrals lose digits to cancellation and
# the power series has converged after _TERMS terms.
_SERIES_BELOW = 2.0
_TERMS = 26


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Actuator:
    """Parameters of the force loop; every field a float or an array of shape (joints,).

    Attributes:
        natural_frequency: wn [rad/s]; inf for an ideal actuator without dynamics.
        damping_ratio: zeta [-], > 0.
        delay: command delay [s].
        force_limit: largest force in either direction [N or N m]; inf for none.
        force_rate_limit: largest rate of change of the force [N/s or N m/s]; inf for none.
        stall_force: force at standstill of the force-speed line [N or N m]; inf for none.
        no_load_speed: speed at which the force-speed line reaches zero [m/s or rad/s].
        lowest_force, highest_force: range of the force that holds too, for limits that differ by
            direction [N or N m]; None where there is no such range.
    """

    natural_frequency: jax.Array | float = inf
    damping_ratio: jax.Array | float = 1.0
    delay: jax.Array | float = 0.0
    force_limit: jax.Array | float = inf
    force_rate_limit: jax.Array | float = inf
    stall_force: jax.Array | float = inf
    no_load_speed: jax.Array | float = inf
    lowest_force: jax.Array | float | None = None
    highest_force: jax.Array | float | None = None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Free:
    """Free response of the force over a time t, from an offset e = f - u and a rate g = f'.

        f(t) = u + c e + s g,                   f'(t) = -wn^2 s e + (c - 2 zeta wn s) g,
        int_0^t f = u t + Ic e + Is g,          int_0^t (t - x) f(x) dx = u t^2/2 + Jc e + Js g

    Attributes:
        c, s, rate_e, rate_g, Ic, Is, Jc, Js: these coefficients, shape (joints,).
    """

    c: jax.Array
    s: jax.Array
    rate_e: jax.Array
    rate_g: jax.Array
    Ic: jax.Array
    Is: jax.Array
    Jc: jax.Array
    Js: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Span:
    """What limits need to know of a step; see `jaxact.drive.limiting`.

    Attributes:
        older_for, newer_for: time under each command [s], shape (joints,).
        before, after: free responses over these times; None without a rate limit.
        sag: how far the force-speed line falls by the end of the step, in the mean and in the
            moment, by the force that accelerates the joint [-]; each of shape (joints,). None
            without a line, or where the inertia is not known.
    """

    older_for: jax.Array
    newer_for: jax.Array
    before: Free | None
    after: Free | None
    sag: tuple[jax.Array, jax.Array, jax.Array] | None


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Response:
    """Response over one step in which the input goes from an older to a newer held value.

    With e = f - newer, g = f', d = older - newer, each row reads (newer +) a e + b g + c d:
    force and rate at the end of the step, the mean force over it, and the moment of the force
    (2/h^2) int_0^h (h - t) f dt, which is to the position what the mean is to the velocity.

    Attributes:
        force, rate, mean, moment: triples (e, g, d) of coefficients, each of shape (joints,).
        joint: of a joint with damping and stiffness of its own; None of any other plant.
        limits: of what limits need beside; None where they need nothing.
    """

    force: tuple[jax.Array, jax.Array, jax.Array]
    rate: tuple[jax.Array, jax.Array, jax.Array]
    mean: tuple[jax.Array, jax.Array, jax.Array]
    moment: tuple[jax.Array, jax.Array, jax.Array]
    joint: Rows | None = None
    limits: Span | None = None


def _series(x: jax.Array, zeta: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Power series of s/t, Is/t^2, Js/t^3 in x = wn t."""

    def term(carry, shares):
        older, newer, sums = carry
        sums = [total + newer * share for total, share in zip(sums, shares, strict=True)]
        return (newer * x, (-2.0 * zeta * newer - older) * x, sums), None

    # As a loop: written out, it would be most of what is compiled of a short program. Five turns at
    # once, as an environment computes it at every step, where it would cost more than the drive.
    zero = jnp.zeros_like(x)
    shares = tuple(
        jnp.asarray([1.0 / factorial(order + depth) for order in range(1, _TERMS)], x.dtype)
        for depth in range(3)
    )
    carry = zero, jnp.ones_like(x), [zero] * 3
    (_, _, sums), _ = jax.lax.scan(term, carry, shares, unroll=5)
    return sums[0], sums[1], sums[2]


def _closed(x: jax.Array, zeta: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Closed form of s/t and c in x = wn t, smooth through zeta = 1."""
    y = zeta * x
    square = (zeta - 1.0) * (zeta + 1.0) * x * x
    near = jnp.abs(square) < 1.0
    small = jnp.where(near, square, 0.0)
    decay = jnp.exp(-y)
    sinhc = jnp.ones_like(x)
    cosh = jnp.ones_like(x)
    for order in range(9, 0, -1):
        sinhc = 1.0 + sinhc * small / (2 * order * (2 * order + 1))
        cosh = 1.0 + cosh * small / (2 * order * (2 * order - 1))
    ringing = square < 0.0
    angle = jnp.sqrt(jnp.where(near | ~ringing, 1.0, -square))
    spread = jnp.sqrt(jnp.where(near | ringing, 1.0, square))
    # (y - spread)(y + spread) = x^2: neither exponent below cancels, and neither overflows.
    slow = jnp.exp(-x * x / jnp.where(near | ringing, 1.0 + x * x, y + spread))
    fast = jnp.exp(-jnp.where(near | ringing, 1.0, y + spread))
    over_s, over_c = 0.5 * (slow - fast) / spread, 0.5 * (slow + fast)
    under_s, under_c = decay * jnp.sin(angle) / angle, decay * jnp.cos(angle)
    s = jnp.where(near, decay * sinhc, jnp.where(ringing, under_s, over_s))
    half = jnp.where(near, decay * cosh, jnp.where(ringing, under_c, over_c))
    return s, half + y * s


def free_response(natural_frequency: jax.Array, damping_ratio: jax.Array, time: jax.Array) -> Free:
    """Closed-form free response of the force loop over `time`; see `Free` for the equations.

    Exact for every damping ratio > 0, with finite derivatives at 1, and for an infinite natural
    frequency (an ideal actuator, which is where the limit goes).

    Args:
        natural_frequency: [rad/s], shape (joints,), may be inf.
        damping_ratio: [-], shape (joints,).
        time: [s], shape (joints,), >= 0.

    Returns:
        The coefficients.

    Source: Astrom, Wittenmark, "Computer-Controlled Systems", 3rd ed., section 2.3.
    """
    dtype = jnp.result_type(float, natural_frequency, damping_ratio, time)
    wn, zeta, t = (jnp.asarray(a, dtype) for a in (natural_frequency, damping_ratio, time))
    wn, zeta, t = jnp.broadcast_arrays(wn, zeta, t)
    ideal = jnp.isinf(wn)
    w = jnp.where(ideal, 1.0, wn)
    x = w * t
    short = x * (1.0 + 2.0 * zeta) < _SERIES_BELOW
    s1, s2, s3 = _series(jnp.where(short, x, 0.0), zeta)
    far = jnp.where(short, 1.0, x)
    closed_s, closed_c = _closed(far, zeta)
    closed_Is = (1.0 - closed_c) / (far * far)
    closed_Js = (1.0 - closed_s - 2.0 * zeta * far * closed_Is) / (far * far)
    s = t * jnp.where(short, s1, closed_s)
    Is = t * t * jnp.where(short, s2, closed_Is)
    Js = t * t * t * jnp.where(short, s3, closed_Js)
    c = jnp.where(short, 1.0 - w * w * Is, closed_c)
    gone = ideal & (t > 0.0)
    c, s, Is, Js = (jnp.where(gone, 0.0, a) for a in (c, s, Is, Js))
    two_zeta_w = 2.0 * zeta * w
    return Free(
        c=c,
        s=s,
        rate_e=-w * w * s,
        rate_g=jnp.where(ideal, 0.0, c - two_zeta_w * s),
        Ic=jnp.where(ideal, 0.0, s + two_zeta_w * Is),
        Is=Is,
        Jc=jnp.where(ideal, 0.0, Is + two_zeta_w * Js),
        Js=Js,
    )


def response(
    natural_frequency: jax.Array,
    damping_ratio: jax.Array,
    step: jax.Array,
    older_for: jax.Array,
    joint: Joint | None = None,
) -> Response:
    """Exact response over one step whose input is the older value for `older_for`, then the newer.

    By superposition: the free response over the whole step, plus a pulse of height
    d = older - newer that ends `older_for` into the step.

    Args:
        natural_frequency: [rad/s], shape (joints,).
        damping_ratio: [-], shape (joints,).
        step: length h of the step [s], shape (joints,), > 0.
        older_for: [s], shape (joints,), between 0 and h.
        joint: that the force moves, if it is neither a bare mass nor a model.

    Returns:
        The coefficients of one step.

    Source: sampling of systems with a delay, Astrom, Wittenmark, "Computer-Controlled Systems",
    3rd ed., section 2.3.
    """
    left = step - older_for
    # Together, as a program with half as many operations is compiled in half the time.
    over = jax.vmap(lambda time: free_response(natural_frequency, damping_ratio, time))(
        jnp.stack(jnp.broadcast_arrays(step, left))
    )
    whole, rest = (jax.tree.map(lambda row, at=at: row[at], over) for at in (0, 1))
    half = 0.5 * step * step
    # Not a division of each: a compiler may or may not make these of it, and round otherwise.
    per_step, per_half = 1.0 / step, 1.0 / half
    return Response(
        force=(whole.c, whole.s, rest.c - whole.c),
        rate=(whole.rate_e, whole.rate_g, rest.rate_e - whole.rate_e),
        mean=(
            whole.Ic * per_step,
            whole.Is * per_step,
            (older_for - whole.Ic + rest.Ic) * per_step,
        ),
        moment=(
            whole.Jc * per_half,
            whole.Js * per_half,
            (half - 0.5 * left * left - whole.Jc + rest.Jc) * per_half,
        ),
        joint=None
        if joint is None
        else joint_rows(joint, natural_frequency, damping_ratio, step, older_for),
    )


def _row(row: tuple[jax.Array, jax.Array, jax.Array], e, g, d) -> jax.Array:
    return row[0] * e + row[1] * g + row[2] * d


def advance(
    response: Response, force: jax.Array, rate: jax.Array, older: jax.Array, newer: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Force and its rate one step later; all shapes (joints,), [N or N m] and per second."""
    e, d = force - newer, older - newer
    return newer + _row(response.force, e, rate, d), _row(response.rate, e, rate, d)


def impulse(
    response: Response, force: jax.Array, rate: jax.Array, older: jax.Array, newer: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Mean and moment of the force over the step; all shapes (joints,), [N or N m]."""
    e, d = force - newer, older - newer
    return newer + _row(response.mean, e, rate, d), newer + _row(response.moment, e, rate, d)


def slope(actuator: Actuator) -> jax.Array:
    """Slope of the force-speed line [N s/m or N m s/rad], shape (joints,); 0 without one."""
    none = jnp.isinf(actuator.stall_force)
    return jnp.where(none, 0.0, jnp.where(none, 1.0, actuator.stall_force) / actuator.no_load_speed)


def limits(
    actuator: Actuator,
    velocity: jax.Array,
    sag: jax.Array | None = None,
    resistance: jax.Array | float = 0.0,
) -> tuple[jax.Array, jax.Array]:
    """Smallest and largest force that the actuator can give at this velocity.

    The force-speed line ``f <= stall_force * (1 - v / no_load_speed)`` when driving in the
    direction of motion, the force limit everywhere, and the range of the force where there is one.

    Args:
        actuator: fields of shape (joints,).
        velocity: [m/s or rad/s], shape (joints,).
        sag: share of the accelerating force by which the line falls from there on [-], shape
            (joints,); None for the line at this velocity.
        resistance: part of the force that does not accelerate the joint [N or N m].

    Returns:
        (lowest, highest) [N or N m], each of shape (joints,).
    """
    falls = slope(actuator) * velocity
    high, low = actuator.stall_force - falls, -actuator.stall_force - falls
    if sag is not None:
        none = jnp.isinf(actuator.stall_force)
        high, low = (
            line - sag * (jnp.where(none, 0.0, inside) - resistance)
            for line, inside in ((high, jnp.maximum(high, 0.0)), (low, jnp.minimum(low, 0.0)))
        )
    highest = jnp.minimum(high, actuator.force_limit)
    lowest = jnp.maximum(low, -actuator.force_limit)
    lowest, highest = jnp.minimum(lowest, 0.0), jnp.maximum(highest, 0.0)
    if actuator.lowest_force is None:
        return lowest, highest
    return (
        jnp.clip(lowest, actuator.lowest_force, actuator.highest_force),
        jnp.clip(highest, actuator.lowest_force, actuator.highest_force),
    )
