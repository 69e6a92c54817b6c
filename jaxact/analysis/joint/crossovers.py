"""Where the loop gain is 1 and where the phase is critical: all of them, refined.

Nothing is searched on a grid. Between the stationary points of |L| and of the phase (`stationary`)
both are monotone, so an interval holds at most one gain crossover, and which critical phases it
holds is known from the phase at its ends.

All arrays carry candidates on axis 0 and the batch behind it, so the fields of a loop have
shape (1, ...).
"""

import math

import jax
import jax.numpy as jnp

from jaxact.analysis.joint.frequency import (
    JointLoop,
    controller_response,
    lead_gain,
    log_gain,
    log_gain_slope,
    phase,
    phase_slope,
    plant_parts,
    servo_denominator,
)
from jaxact.analysis.joint.positive_roots import apart
from jaxact.analysis.joint.stationary import typical_frequency

TURN = 2.0 * math.pi
_BISECTIONS = 18
_SPRUNG_BISECTIONS = 12
_NEWTON_STEPS = 4
_PHASE_BISECTIONS = 12
_PHASE_NEWTON_STEPS = 5


def gain_crossovers(loop: JointLoop, extremes: jax.Array) -> tuple[jax.Array, jax.Array]:
    """All frequencies [rad/s] with |L(jw)| = 1 in ascending order, and which exist, (k + 1, ...).

    There are one or three: |L| falls from infinity to zero, with at most one rise between
    the extremes (two where the velocity is filtered). Slots of missing ones hold other frequencies.
    Of a sprung joint |L| starts at |kp/k|, so that there may be any number of them, or none.

    Args:
        extremes: of `gain_extremes`, shape (k, ...).
    """
    kp, kd, mass = jnp.abs(loop.kp), jnp.abs(loop.kd), loop.mass
    half = 0.5 * (kd / mass) ** 2
    rigid = jnp.sqrt(half + jnp.sqrt(half**2 + (kp / mass) ** 2))
    zeta2 = loop.damping_ratio**2
    deepest = jnp.where(zeta2 < 0.5, 4.0 * zeta2 * (1.0 - zeta2), 1.0)
    floor = jnp.minimum(rigid, loop.natural_frequency) / (1.0 + 2.0 * loop.damping_ratio)
    if loop.velocity_filter is not None:
        # Up to half its cutoff the filter takes at most a third from |C|; it never adds a quarter.
        floor = jnp.minimum(floor, loop.velocity_filter)
    if loop.sprung:
        floor, rigid = _sprung_ends(loop, floor, rigid)
    low_end = jnp.maximum(0.5 * floor, jnp.finfo(floor.dtype).tiny)
    high_end = jnp.maximum(2.0 * rigid / jnp.sqrt(deepest), 2.0 * low_end)
    inner = jnp.clip(extremes, low_end, high_end)
    left = jnp.concatenate([low_end, inner])
    right = jnp.concatenate([inner, high_end])
    above = log_gain(loop, left) > 0.0
    present = above != (log_gain(loop, right) > 0.0)

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = jnp.sqrt(low * high)
        before = _gain_above_one(loop, middle) == above
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    steps = _BISECTIONS + (_SPRUNG_BISECTIONS if loop.sprung else 0)
    low, high = jax.lax.fori_loop(0, steps, halve, (left, right))

    def newton(_: int, w: jax.Array) -> jax.Array:
        slope = log_gain_slope(loop, w)
        step = log_gain(loop, w) / jnp.where(slope == 0.0, -1.0, slope)
        return jnp.clip(w * jnp.exp(jnp.clip(-step, -1.0, 1.0)), low, high)

    w = jax.lax.fori_loop(0, _NEWTON_STEPS, newton, jnp.sqrt(low * high))
    only = jnp.max(jnp.where(present, w, 0.0), axis=0, keepdims=True)
    if loop.sprung:
        only = jnp.where(only > 0.0, only, typical_frequency(loop))
    factors = (0.55, 1.45, 3.1, 0.71, 1.9, 2.3)[: w.shape[0]]
    return jnp.where(present, w, only * apart(factors, w)), present


def _sprung_ends(
    loop: JointLoop, floor: jax.Array, rigid: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Far below every corner of |L|, where it is flat or a power of w, and above the resonance."""
    kp, kd = jnp.abs(loop.kp), jnp.abs(loop.kd)
    c, k = loop.joint_damping, jnp.abs(loop.joint_stiffness)
    far = typical_frequency(loop)
    corners = [(kp, c), (kd, loop.mass), (kp, kd), (k, c), (c, loop.mass)]
    corners += [(jnp.sqrt(kp), jnp.sqrt(loop.mass)), (jnp.sqrt(k), jnp.sqrt(loop.mass))]
    for top, bottom in corners:
        there = (top > 0) & (bottom > 0)
        far = jnp.minimum(far, jnp.where(there, top / jnp.where(bottom > 0, bottom, 1.0), far))
    low = 1e-8 * jnp.where(floor > 0, jnp.minimum(far, floor), far)
    return low, jnp.maximum(1.2 * rigid, jnp.sqrt(k / loop.mass))


def _gain_above_one(loop: JointLoop, w: jax.Array) -> jax.Array:
    """|L(jw)| > 1 without a logarithm."""
    x2 = (w / loop.natural_frequency) ** 2
    servo = (1.0 - x2) ** 2 + 4.0 * loop.damping_ratio**2 * x2
    stiff, rate = controller_response(loop, w)
    if loop.sprung:
        against, damped = plant_parts(loop, w)
        return stiff**2 + rate**2 > (against**2 + damped**2) * servo
    return stiff**2 + rate**2 > (loop.mass * w * w) ** 2 * servo


def phase_crossovers(
    loop: JointLoop, points: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """The critical crossing with the largest |L| between each two neighbours of `points`.

    Args:
        points: frequencies [rad/s] in ascending order between which |L| and the phase are monotone
            and |L| - 1 keeps its sign, shape (k, ...).

    Returns:
        Frequency [rad/s], level of the phase there (a multiple of 2 pi), direction of the phase (-1
        falling, +1 rising) and whether there is one, each of shape (k + 1, ...). Seen from |L| = 1
        it is the nearest one of its stretch if |L| < 1.
    """
    last = points[-1:]
    begin = phase_at_rest(loop) if loop.sprung else jnp.zeros_like(last)
    next_level = TURN * (jnp.ceil(_phase_at_once(loop, last) / TURN) - 1.0)
    end = _level_reached(loop, next_level)
    left = jnp.concatenate([jnp.zeros_like(last), points])
    right = jnp.concatenate(
        [points, jnp.where(jnp.isfinite(end), jnp.maximum(end, last), 2 * last)]
    )
    at_points = _phase_at_once(loop, points)
    start, stop = (
        jnp.concatenate([begin, at_points]),
        jnp.concatenate([at_points, jnp.where(jnp.isfinite(end), next_level, at_points[-1:])]),
    )
    gains = log_gain(loop, points)
    first = jnp.ones_like(last, dtype=bool)
    if loop.sprung:
        first = jnp.abs(loop.kp) > jnp.abs(loop.joint_stiffness) * jnp.exp(gains[:1])
    loud_left = jnp.concatenate([first, gains[:-1] > gains[1:], jnp.ones_like(last, dtype=bool)])
    falling = start > stop
    # The level nearest to the louder end, strictly inside.
    louder = jnp.where(loud_left, start, stop)
    below = loud_left == falling
    turns = louder / TURN
    level = TURN * jnp.where(below, jnp.ceil(turns) - 1.0, jnp.floor(turns) + 1.0)
    present = (jnp.minimum(start, stop) <= level) & (level <= jnp.maximum(start, stop))
    if loop.sprung:
        # What is critical at rest is no crossing of the axis: `margins` has it by itself.
        at_rest = jnp.zeros_like(start, dtype=bool).at[0].set(True) & (level == start)
        present = present & ((loop.kp != 0) | (loop.kd != 0)) & ~at_rest
    else:
        present = present & (loop.kp > 0)
    w = _solve_phase(loop, level, left, right, falling)
    return w, level, jnp.where(falling, -1.0, 1.0), present


def phase_at_rest(loop: JointLoop) -> jax.Array:
    """`phase` of a sprung joint at w = 0+ [rad]: a multiple of pi, or of pi/2 for k = 0."""
    lead = jnp.where(loop.kp >= 0, 0.0, jnp.where(loop.kd < 0, -math.pi, math.pi))
    lead = jnp.where(loop.kp == 0, 0.5 * math.pi * jnp.sign(loop.kd), lead)
    free = jnp.where(loop.joint_damping > 0, 0.5 * math.pi, 0.0)
    k = loop.joint_stiffness
    return lead + jnp.where(k > 0, math.pi, jnp.where(k < 0, 0.0, free))


def _phase_at_once(loop: JointLoop, w: jax.Array) -> jax.Array:
    """`phase` by one arctangent: for kp > 0, kd >= 0 the two parts together stay within a turn."""
    if loop.sprung:
        return phase(loop, w)
    real, imaginary = servo_denominator(loop, w)
    stiff, rate = controller_response(loop, w)
    lead = jnp.arctan2(rate * real - stiff * imaginary, stiff * real + rate * imaginary)
    return lead - w * loop.delay


def _level_reached(loop: JointLoop, level: jax.Array) -> jax.Array:
    """A frequency [rad/s] beyond which the phase is below `level` for good; inf if never.

    phase <= pi/2 - w td, and beyond wn the phase is negative whatever the delay. Of a sprung joint
    it is at most 2 pi - w td, and negative where the servo's lag beyond pi/2 exceeds what is left
    of the joint's lead, atan(c / (m w - k/w)), and of that of the controller beyond pi/2.
    """
    highest: float = 0.5 * math.pi
    beyond = 1.01 * loop.natural_frequency
    if loop.sprung:
        highest, beyond = 2.0 * math.pi, _servo_wins(loop)
    by_delay = (highest - level) / jnp.where(loop.delay > 0, loop.delay, 1.0)
    by_delay = jnp.where(loop.delay > 0, by_delay, jnp.inf)
    by_servo = jnp.where(level >= 0, beyond, jnp.inf)
    return jnp.minimum(by_delay, by_servo)


def _servo_wins(loop: JointLoop) -> jax.Array:
    """A frequency beyond which the phase of a sprung joint without delay is negative [rad/s]."""
    wn, k = loop.natural_frequency, jnp.abs(loop.joint_stiffness)
    joint = loop.joint_damping / (0.75 * loop.mass)
    lead = jnp.abs(lead_gain(loop))
    behind = jnp.maximum(-loop.kp, 0.0)
    behind = jnp.where(
        behind > 0, behind / jnp.where(lead > 0, lead, jnp.finfo(lead.dtype).tiny), 0
    )
    by_lag = wn * jnp.sqrt(1.0 + 4.0 * loop.damping_ratio * (joint + behind) / wn)
    both = jnp.sqrt(2.0 * joint) * jnp.sqrt(behind)
    return 1.01 * jnp.maximum(jnp.maximum(by_lag, both), 2.0 * jnp.sqrt(k / loop.mass))


def _solve_phase(
    loop: JointLoop, level: jax.Array, left: jax.Array, right: jax.Array, falling: jax.Array
) -> jax.Array:
    """phase(w) = level in brackets where the phase is monotone: bisection, then Newton."""

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = jnp.where(low > 0.0, jnp.sqrt(low * high), 0.5 * high)
        before = (_phase_at_once(loop, middle) > level) == falling
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    low, high = jax.lax.fori_loop(0, _PHASE_BISECTIONS, halve, (left, right))

    def newton(_: int, w: jax.Array) -> jax.Array:
        slope = phase_slope(loop, w)
        step = (_phase_at_once(loop, w) - level) * w / jnp.where(slope == 0.0, -1.0, slope)
        return jnp.clip(w - step, low, high)

    return jax.lax.fori_loop(0, _PHASE_NEWTON_STEPS, newton, 0.5 * (low + high))


def marginal_phasor(loop: JointLoop, w: jax.Array) -> tuple[jax.Array, jax.Array]:
    """P(w) = D(jw) exp(j w td) as a pair: marginal kp = m w^2 P_0, kd = m w P_1.

    Of P its real and imaginary part; a filter of the velocity makes them Re P - w tau Im P and
    (1 + (w tau)^2) Im P.

    Args:
        w: frequency [rad/s].
    """
    real, imaginary = servo_denominator(loop, w)
    cosine, sine = jnp.cos(w * loop.delay), jnp.sin(w * loop.delay)
    real, imaginary = real * cosine - imaginary * sine, real * sine + imaginary * cosine
    if loop.velocity_filter is None:
        return real, imaginary
    turn = w / loop.velocity_filter
    return real - turn * imaginary, (1.0 + turn * turn) * imaginary


def slowdown_residual(loop: JointLoop, w: jax.Array) -> jax.Array:
    """P_0 - m kp / kd^2 P_1^2 [-]: zero where (kp k^2, kd k) meets the marginal curve.

    Args:
        w: frequency [rad/s].
    """
    real, imaginary = marginal_phasor(loop, w)
    damping = jnp.where(loop.kd != 0, loop.kd, jnp.finfo(loop.kd.dtype).tiny)
    return real - loop.mass * loop.kp * (imaginary / damping) ** 2


def slowdown_frequency(loop: JointLoop) -> jax.Array:
    """Where (kp k^2, kd k), the loop slowed down, meets the first lobe [rad/s], shape (1, ...).

    For loops that no common factor stabilises, kd/kp <= td + 2 zeta/wn: slowing down always does.
    """
    lag = loop.delay + 2.0 * loop.damping_ratio / loop.natural_frequency
    tiny = jnp.finfo(lag.dtype).tiny
    by_delay = 0.5 * math.pi / jnp.where(loop.delay > 0, loop.delay, 1.0)
    high = jnp.minimum(jnp.where(loop.delay > 0, by_delay, jnp.inf), loop.natural_frequency)
    high = jnp.where(jnp.isfinite(high), high, 1.0)
    guess = loop.kd / jnp.maximum(lag * jnp.sqrt(loop.mass * jnp.abs(loop.kp)), tiny)
    guess = jnp.minimum(guess, high)
    if loop.velocity_filter is not None:
        guess = jnp.minimum(guess, loop.velocity_filter)
    low = jnp.maximum(0.2 * guess, 1e6 * tiny)

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = jnp.sqrt(low * high)
        before = slowdown_residual(loop, middle) > 0
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (low, high))

    def newton(_: int, w: jax.Array) -> jax.Array:
        residual, slope = jax.jvp(lambda x: slowdown_residual(loop, x), (w,), (w,))
        step = w * residual / jnp.where(slope == 0.0, -1.0, slope)
        return jnp.clip(w - step, low, high)

    return jax.lax.fori_loop(0, _NEWTON_STEPS, newton, jnp.sqrt(low * high))
