"""What limits leave of a force over a span of time: a bound, a force-speed line, a rate limit.

A rate limit makes the force follow what the force loop gives, and it follows from where it was:

    f' = R sign(g - f) until f meets g,   then f' = g' as far as |g'| <= R

so its mean over a step is not that of g, clipped to what the force may change in a step: a force
that slews over a whole step gives half of that change. Over each part of a step under one held
command, g is taken as a straight line to its end that has its mean or, where it only begins to
rise, its beginning; then f is known in closed form. For an ideal actuator that is exact, for
another one of second order in the step. No step gives more than a bounded force can that changes
no faster.

The force-speed line of a joint whose inertia is known falls while the force accelerates it:

    m v' + c v + k q = f = F - s v,   s = stall force / no-load speed

exact while the line holds (the spring force k q as it was at the beginning of the step), and no
faster than the no-load speed whatever the step. Of any other plant the line is that of the velocity
at the beginning of the step.
"""

from __future__ import annotations

from dataclasses import replace
from math import factorial

import jax
import jax.numpy as jnp

from jaxact.drive.actuator import Actuator, Response, Span, free_response, impulse, limits, slope
from jaxact.drive.joint_motion import Joint, Motion, held_back, pushed
from jaxact.drive.options import DriveOptions

# Below it the closed forms of the phi functions lose digits, and this many terms suffice.
_SERIES_BELOW = 1.0
_TERMS = 18

Pair = tuple[jax.Array, jax.Array]


def _phi(x: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """phi_1, phi_2 and phi_3 of -x, where phi_k(z) = sum z^j / (j + k)!.

    Source: Hochbruck, Ostermann, "Exponential integrators", Acta Numerica 19, 2010, section 2.1.
    """
    short = jnp.abs(x) < _SERIES_BELOW
    near, far = jnp.where(short, x, 0.0), jnp.where(short, 1.0, x)
    # by Horner's rule, each sum_j (-x)^j / (j + k)!
    sums = [jnp.zeros_like(x)] * 3
    for j in range(_TERMS, -1, -1):
        sums = [1.0 / factorial(j + k) - near * total for k, total in enumerate(sums, 1)]
    one = -jnp.expm1(-far) / far
    two = (1.0 - one) / far
    closed = one, two, (0.5 - two) / far
    first, second, third = (jnp.where(short, *both) for both in zip(sums, closed, strict=True))
    return first, second, third


def span(
    options: DriveOptions,
    actuator: Actuator,
    step: jax.Array,
    older_for: jax.Array,
    body: Joint | None = None,
) -> Span | None:
    """Coefficients of the limits over a span with the older command for `older_for`.

    Args:
        options: static.
        actuator: fields of shape (joints,).
        step: length of the span [s], shape (joints,) or ().
        older_for: [s], shape (joints,), between 0 and `step`.
        body: that the force accelerates, for the force-speed line; None where it is not known.

    Returns:
        The coefficients; None where the limits need none.
    """
    line = options.speed_limited and body is not None
    if not (options.rate_limited or line):
        return None
    newer_for, before, after, sag = step - older_for, None, None, None
    if options.rate_limited:
        before, after = (
            free_response(actuator.natural_frequency, actuator.damping_ratio, time)
            for time in (older_for, newer_for)
        )
    if line and body is not None:
        falls = slope(actuator) / body.mass * step
        first, second, third = _phi(falls + body.damping / body.mass * step)
        sag = falls * first, falls * second, 2.0 * falls * third
    return Span(older_for, newer_for, before, after, sag)


def limited(
    options: DriveOptions,
    actuator: Actuator,
    older: jax.Array,
    newer: jax.Array,
    velocity: jax.Array | None,
) -> Pair:
    """Both commands of a period as far as an ideal actuator follows them; others as they are.

    Its force is the one command and then the other: each is limited, and not their mean.

    Args:
        options: static.
        actuator: fields of shape (joints,).
        older, newer: commands [N or N m], shape (joints,).
        velocity: of the joint, for the force-speed line [m/s or rad/s], shape (joints,); None where
            the line falls within a step, which `held` knows.
    """
    if not options.ideal:
        return older, newer
    if velocity is None:
        none = jnp.full_like(actuator.stall_force, jnp.inf)
        actuator, velocity = replace(actuator, stall_force=none), jnp.zeros_like(none)
    bounds, ideal = limits(actuator, velocity), jnp.isinf(actuator.natural_frequency)
    older, newer = (jnp.where(ideal, jnp.clip(one, *bounds), one) for one in (older, newer))
    return older, newer


def held(
    options: DriveOptions,
    actuator: Actuator,
    response: Response,
    inputs: tuple[jax.Array, jax.Array, jax.Array, jax.Array],
    applied: jax.Array | None,
    velocity: jax.Array,
    resistance: jax.Array | float,
    motion: Motion | None,
) -> tuple[Pair, Motion | None, jax.Array | None]:
    """What limits leave of the force over a span.

    Args:
        options: static; with a limit.
        actuator: fields of shape (joints,).
        response: of the force loop over the span.
        inputs: force [N or N m], rate, older and newer command, each of shape (joints,).
        applied: force at the beginning of the span [N or N m], shape (joints,); rate limit only.
        velocity: of the joint then [m/s or rad/s], shape (joints,).
        resistance: force that the joint's own damping and stiffness take then [N or N m].
        motion: of the joint over the span without limits; None where the plant computes its own.

    Returns:
        Mean and moment of the force, as in `jaxact.drive.step.Force`; the motion; the force at the
        end of the span, None without a rate limit.
    """
    free = impulse(response, *inputs)
    sag = None if response.limits is None else response.limits.sag

    def bounds(falls: jax.Array | float | None = None) -> Pair:
        return limits(actuator, velocity, falls, resistance)

    mean, moment = (
        jnp.clip(value, *bounds(None if sag is None else sag[i])) for i, value in enumerate(free, 1)
    )
    if motion is not None:
        clipped = (mean != free[0]) | (moment != free[1])
        motion = held_back(response.joint, motion, clipped, mean, moment)
    if not options.rate_limited:
        return (mean, moment), motion, None
    pair = mean, moment
    mean, moment, end = _followed(actuator, response, inputs, applied, bounds, pair)
    if motion is not None:
        motion = pushed(response.joint, motion, mean - pair[0], moment - pair[1])
    return (mean, moment), motion, end


def _followed(actuator, response, inputs, applied, bounds, target: Pair):
    """Mean, moment and end of a force that follows its target no faster than the rate limit."""
    span = response.limits
    step, sag = span.older_for + span.newer_for, span.sag
    unlimited = jnp.isinf(actuator.force_rate_limit)
    fastest = jnp.where(unlimited, 0.0, actuator.force_rate_limit)
    mean = moment = line_moment = off_mean = off_moment = share = 0.0
    force, begun, unclipped, held_back = applied, 0.0, True, False
    for time, first, average, last in _parts(span, inputs):
        # The bounds fall evenly from the beginning of the span to its end, or nearly so.
        places = (begun, begun + 0.5 * time, begun + time)
        start, middle, end = (
            bounds(None if sag is None else sag[0] * (place / step)) for place in places
        )
        kept, ends = jnp.clip(average, *middle), jnp.clip(last, *end)
        starts = jnp.clip(first, *start)
        begins = _beginning(starts, kept, ends, start)
        unclipped &= ((starts == first) & (kept == average) & (ends == last)) | (time <= 0.0)
        rise = (ends - begins) / jnp.where(time > 0.0, time, 1.0)
        own, line, follows, force = _ramp(force, begins, rise, fastest, time)
        left = step - begun - time
        mean, moment = mean + own[0], moment + own[1] + own[0] * left
        line_moment = line_moment + line[1] + line[0] * left
        held_back |= follows < time
        part = follows / jnp.where(time > 0.0, time, 1.0)
        off = part * (kept * time - line[0])
        off_mean, off_moment = off_mean + off, off_moment + off * (left + 0.5 * time)
        share, begun = share + follows / step, begun + time
    half = 0.5 * step * step
    # As far as the force follows, it has the curve of its target, of which the line is a chord.
    curve = jnp.where(unclipped, share * (target[1] - line_moment / half), off_moment / half)
    own = mean / step, moment / half
    followed = (
        jnp.where(held_back, own[0] + off_mean / step, target[0]),
        jnp.where(held_back, own[1] + curve, target[1]),
    )
    reach = _reach(applied, force, fastest, step)
    found = [
        _possible(followed[i], own[i], reach[i], bounds(None if sag is None else sag[i + 1]))
        for i in range(2)
    ]
    return tuple(
        jnp.where(unlimited, free, own)
        for free, own in zip((*target, last), (*found, force), strict=True)
    )


def _beginning(first, average, last, bounds: Pair):
    """Where a line begins that stands for a force with this beginning, mean and end.

    It has the mean, unless it would begin beyond both ends: a force that an actuator builds up does
    not fall first.
    """
    low, high = jnp.minimum(first, last), jnp.maximum(first, last)
    return jnp.clip(jnp.clip(2.0 * average - last, low, high), *bounds)


def _possible(value: jax.Array, own: jax.Array, reach: Pair, bounds: Pair) -> jax.Array:
    """A mean or moment within what can be reached and what is allowed; `own` is, if any is."""
    least, most = (jnp.minimum(bounds[0], own), jnp.maximum(bounds[1], own))
    return jnp.clip(value, jnp.maximum(reach[0], least), jnp.minimum(reach[1], most))


def _reach(first, last, fastest, step) -> tuple[Pair, Pair]:
    """Least and largest means, and moments, of forces between two no faster than a rate limit.

    Those of the force that goes down and then up as fast as it may, and of its opposite.
    """
    half, ends = 0.5 * step * step, []
    for rate in (-fastest, fastest):
        turn = 0.5 * (step + (last - first) / jnp.where(rate == 0.0, 1.0, rate))
        turn = jnp.clip(turn, 0.0, step)
        rest = step - turn
        mean = turn * (first + 0.5 * rate * turn) + rest * (last + 0.5 * rate * rest)
        moment = turn * (first * (step - 0.5 * turn) + rate * turn * (0.5 * step - turn / 3.0))
        moment = moment + rest * rest * (0.5 * last + rate * rest / 3.0)
        ends.append((mean / step, moment / half))
    (low, low_moment), (high, high_moment) = ends
    return (low, high), (low_moment, high_moment)


def _parts(span: Span, inputs):
    """Length, and beginning, mean and end of the force loop's force, under each of the commands."""
    force, rate, older, newer = inputs
    assert span.before is not None and span.after is not None
    for free, time, command in (
        (span.before, span.older_for, older),
        (span.after, span.newer_for, newer),
    ):
        e = force - command
        impulse = command * time + free.Ic * e + free.Is * rate
        first = force
        force, rate = command + free.c * e + free.s * rate, free.rate_e * e + free.rate_g * rate
        yield time, first, impulse / jnp.where(time > 0.0, time, 1.0), force


def _ramp(force, first, rise, fastest, time):
    """How a force follows the line `first + rise t` no faster than `fastest`, from `force`.

    Returns:
        (int_0^T f, int_0^T (T - t) f dt) of the force and of the line, how long the force is on it
        and not held back, and the force at the end.
    """
    gap = first - force
    side = jnp.sign(gap)
    closing = fastest - side * rise
    meets = closing > 0.0
    until = jnp.where(meets, jnp.abs(gap) / jnp.where(meets, closing, 1.0), time)
    until = jnp.minimum(jnp.where(gap == 0.0, 0.0, until), time)
    rest = time - until
    speed, after = side * fastest, jnp.clip(rise, -fastest, fastest)
    half, sixth = 0.5 * time * time, time * time * time / 6.0
    late, later = 0.5 * rest * rest, rest * rest * rest / 6.0
    own = (
        force * time + speed * (half - late) + after * late,
        force * half + speed * (sixth - later) + after * later,
    )
    line = first * time + rise * half, first * half + rise * sixth
    follows = jnp.where(jnp.abs(rise) <= fastest, rest, 0.0)
    return own, line, follows, force + speed * until + after * rest
