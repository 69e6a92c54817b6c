"""Where the loop gain is 1 and where the phase is critical: all of them, refined.

Nothing is searched on a grid. The stationary points of |L| and of the phase are roots of cubics
in w^2; between them both are monotone, so an interval holds at most one gain crossover, and which
critical phases it holds is known from the phase at its ends.

All arrays carry candidates on axis 0 and the batch behind it, so the fields of a loop have
shape (1, ...).
"""

import math

import jax
import jax.numpy as jnp

from jaxact.frequency import (
    JointLoop,
    log_gain,
    log_gain_slope,
    phase_slope,
    servo_denominator,
)

TURN = 2.0 * math.pi
_CUBIC_STEPS = 44
_BISECTIONS = 18
_NEWTON_STEPS = 4
_PHASE_BISECTIONS = 12
_PHASE_NEWTON_STEPS = 5


def positive_cubic_roots(
    coefficients: list[jax.Array], scale: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The roots y > 0 of c0 + c1 y + c2 y^2 + c3 y^3, and which there are, shape (3, ...).

    coefficients: c0 ... c3, real, each of shape (1, ...)
    scale: a typical size of the roots, shape (1, ...), > 0

    With y = scale * s / (1 - s) it becomes a cubic on 0 < s < 1, whatever its degree; the roots of
    its derivative split that into three parts, each bisected.
    """
    c = [a * scale**i for i, a in enumerate(coefficients)]
    largest = jnp.maximum(
        jnp.maximum(jnp.abs(c[0]), jnp.abs(c[1])), jnp.maximum(jnp.abs(c[2]), jnp.abs(c[3]))
    )
    c = [a / jnp.where(largest > 0, largest, 1.0) for a in c]
    # Powers of s of sum_i c_i s^i (1 - s)^(3 - i).
    p0 = c[0]
    p1 = c[1] - 3.0 * c[0]
    p2 = c[2] - 2.0 * c[1] + 3.0 * c[0]
    p3 = c[3] - c[2] + c[1] - c[0]

    def cubic(s: jax.Array) -> jax.Array:
        return p0 + s * (p1 + s * (p2 + s * p3))

    first, second = _quadratic_roots(p1, 2.0 * p2, 3.0 * p3)
    left = jnp.concatenate([jnp.zeros_like(first), first, second])
    right = jnp.concatenate([first, second, jnp.ones_like(first)])
    rising = cubic(left) < 0.0
    present = rising != (cubic(right) < 0.0)

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = 0.5 * (low + high)
        before = (cubic(middle) < 0.0) == rising
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    low, high = jax.lax.fori_loop(0, _CUBIC_STEPS, halve, (left, right))
    s = 0.5 * (low + high)
    # Where the degree is lower, s = 1 is a root that only rounding places inside.
    rounding = 64.0 * jnp.finfo(s.dtype).eps
    present = present & (s < 1.0 - rounding)
    roots = scale * s / jnp.maximum(1.0 - s, rounding)
    return jnp.where(present, roots, scale), present


def _quadratic_roots(a: jax.Array, b: jax.Array, c: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Ordered real parts of the roots of a + b s + c s^2, clipped to [0, 1]."""
    discriminant = jnp.sqrt(jnp.maximum(b * b - 4.0 * a * c, 0.0))
    q = -0.5 * (b + jnp.where(b < 0, -discriminant, discriminant))
    one = a / jnp.where(q == 0, 1.0, q)
    two = q / jnp.where(c == 0, 1.0, c)
    one = jnp.where(q == 0, 0.0, one)
    two = jnp.where(c == 0, 1.0, two)
    one, two = jnp.clip(one, 0.0, 1.0), jnp.clip(two, 0.0, 1.0)
    return jnp.minimum(one, two), jnp.maximum(one, two)


def gain_extremes(loop: JointLoop) -> jax.Array:
    """The frequencies [rad/s] where |L| has its local minimum and maximum, shape (2, ...).

    Only a lightly damped servo has them; otherwise they are harmless other frequencies.

    With t = (w/wn)^2, a = (kp/wn)^2, b = kd^2, e = 4 zeta^2 - 2:
    2 a + (3 a e + b) t + (4 a + 2 b e) t^2 + 3 b t^3 = 0.
    """
    ideal = jnp.isinf(loop.natural_frequency)
    wn = jnp.where(ideal, 1.0, loop.natural_frequency)
    a, b = (loop.kp / wn) ** 2, loop.kd**2
    e = 4.0 * loop.damping_ratio**2 - 2.0
    cubic = [2.0 * a, 3.0 * a * e + b, 4.0 * a + 2.0 * b * e, 3.0 * b]
    t, present = positive_cubic_roots(cubic, jnp.ones_like(e))
    # c0 > 0 and c3 >= 0: none or two of the three are there.
    some = jnp.any(present, axis=0, keepdims=True)
    low = jnp.min(jnp.where(present, t, jnp.inf), axis=0, keepdims=True)
    high = jnp.max(jnp.where(present, t, 0.0), axis=0, keepdims=True)
    low, high = jnp.where(some, low, 0.37), jnp.where(some, high, 1.13)
    return wn * jnp.sqrt(jnp.concatenate([low, high]))


def gain_crossovers(loop: JointLoop, extremes: jax.Array) -> tuple[jax.Array, jax.Array]:
    """All frequencies [rad/s] with |L(jw)| = 1 in ascending order, and which exist, (3, ...).

    extremes: of `gain_extremes`, shape (2, ...)

    There are one or three: |L| falls from infinity to zero, with at most one rise between
    the extremes. Slots of missing ones hold other frequencies.
    """
    kp, kd, mass = jnp.abs(loop.kp), jnp.abs(loop.kd), loop.mass
    half = 0.5 * (kd / mass) ** 2
    rigid = jnp.sqrt(half + jnp.sqrt(half**2 + (kp / mass) ** 2))
    zeta2 = loop.damping_ratio**2
    deepest = jnp.where(zeta2 < 0.5, 4.0 * zeta2 * (1.0 - zeta2), 1.0)
    floor = jnp.minimum(rigid, loop.natural_frequency) / (1.0 + 2.0 * loop.damping_ratio)
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

    low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (left, right))

    def newton(_: int, w: jax.Array) -> jax.Array:
        slope = log_gain_slope(loop, w)
        step = log_gain(loop, w) / jnp.where(slope == 0.0, -1.0, slope)
        return jnp.clip(w * jnp.exp(jnp.clip(-step, -1.0, 1.0)), low, high)

    w = jax.lax.fori_loop(0, _NEWTON_STEPS, newton, jnp.sqrt(low * high))
    only = jnp.max(jnp.where(present, w, 0.0), axis=0, keepdims=True)
    return jnp.where(present, w, only * _apart((0.55, 1.45, 3.1), w)), present


def _gain_above_one(loop: JointLoop, w: jax.Array) -> jax.Array:
    """|L(jw)| > 1 without a logarithm."""
    x2 = (w / loop.natural_frequency) ** 2
    servo = (1.0 - x2) ** 2 + 4.0 * loop.damping_ratio**2 * x2
    return loop.kp**2 + (loop.kd * w) ** 2 > (loop.mass * w * w) ** 2 * servo


def phase_extremes(loop: JointLoop) -> jax.Array:
    """The frequencies [rad/s] where the phase turns, shape (3, ...); missing ones are harmless.

    With r = kd/kp, v = 1/wn, y = w^2, R = |D|^2 = 1 + e v^2 y + v^4 y^2, e = 4 zeta^2 - 2:
    r R - (1 + r^2 y) 2 zeta v (1 + v^2 y) - td (1 + r^2 y) R = 0.
    """
    kp, kd, td = loop.kp, loop.kd, loop.delay
    size = jnp.where(kp > 0, kp, jnp.maximum(kd, jnp.finfo(kd.dtype).tiny))
    a, r = jnp.where(kp > 0, 1.0, 0.0), kd / size
    v = 1.0 / loop.natural_frequency
    v2, e = v * v, 4.0 * loop.damping_ratio**2 - 2.0
    g = 2.0 * loop.damping_ratio * v
    cubic = [
        a * (r - a * (g + td)),
        a * r * e * v2 - g * (a * a * v2 + r * r) - td * (a * a * e * v2 + r * r),
        a * r * v2 * v2 - g * v2 * r * r - td * (a * a * v2 * v2 + e * v2 * r * r),
        -td * r * r * v2 * v2,
    ]
    lag = g + td + 0.1 * v
    balance = jnp.where(lag > 0, (r + lag) * lag, r * r)
    scale = 1.0 / jnp.where(balance > 0, balance, 1.0)
    y, present = positive_cubic_roots(cubic, scale)
    return jnp.sqrt(jnp.where(present, y, scale * _apart((0.31, 0.83, 2.7), y)))


def _apart(factors: tuple[float, ...], like: jax.Array) -> jax.Array:
    """Distinct factors along axis 0, for slots that hold nothing: points must not coincide."""
    column = jnp.asarray(factors, dtype=like.dtype)
    return column.reshape((-1,) + (1,) * (like.ndim - 1))


def insert_sorted(rows: jax.Array, value: jax.Array) -> jax.Array:
    """`value`, shape (1, ...), put in its place among rows ascending along axis 0, shape (k, ...).

    out_i = max(row_{i-1}, min(value, row_i)): elementwise, so vectorised over the batch.
    """
    edge = jnp.full_like(value, jnp.inf)
    below = jnp.concatenate([-edge, rows])
    above = jnp.concatenate([rows, edge])
    return jnp.maximum(below, jnp.minimum(value, above))


def sort_rows(values: jax.Array) -> jax.Array:
    """Sorted along axis 0, by insertion: made for a handful of rows and a large batch."""
    rows = values[:1]
    for i in range(1, values.shape[0]):
        rows = insert_sorted(rows, values[i : i + 1])
    return rows


def phase_crossovers(
    loop: JointLoop, points: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """The critical crossing with the largest |L| between each two neighbours of `points`.

    points: frequencies [rad/s] in ascending order between which |L| and the phase are monotone
        and |L| - 1 keeps its sign, shape (k, ...)

    Returns frequency [rad/s], level of the phase there (a multiple of 2 pi), direction of the
    phase (-1 falling, +1 rising) and whether there is one, each of shape (k + 1, ...). Seen from
    |L| = 1 it is the nearest one of its stretch if |L| < 1.
    """
    last = points[-1:]
    next_level = TURN * (jnp.ceil(_phase_at_once(loop, last) / TURN) - 1.0)
    end = _level_reached(loop, next_level)
    left = jnp.concatenate([jnp.zeros_like(last), points])
    right = jnp.concatenate(
        [points, jnp.where(jnp.isfinite(end), jnp.maximum(end, last), 2 * last)]
    )
    at_points = _phase_at_once(loop, points)
    start, stop = (
        jnp.concatenate([jnp.zeros_like(last), at_points]),
        jnp.concatenate([at_points, jnp.where(jnp.isfinite(end), next_level, at_points[-1:])]),
    )
    gains = log_gain(loop, points)
    loud_left = jnp.concatenate(
        [jnp.ones_like(last, dtype=bool), gains[:-1] > gains[1:], jnp.ones_like(last, dtype=bool)]
    )
    falling = start > stop
    # The level nearest to the louder end, strictly inside.
    louder = jnp.where(loud_left, start, stop)
    below = loud_left == falling
    turns = louder / TURN
    level = TURN * jnp.where(below, jnp.ceil(turns) - 1.0, jnp.floor(turns) + 1.0)
    present = (jnp.minimum(start, stop) <= level) & (level <= jnp.maximum(start, stop))
    present = present & (loop.kp > 0)
    w = _solve_phase(loop, level, left, right, falling)
    return w, level, jnp.where(falling, -1.0, 1.0), present


def _phase_at_once(loop: JointLoop, w: jax.Array) -> jax.Array:
    """`phase` by one arctangent: for kp > 0, kd >= 0 the two parts together stay within a turn."""
    real, imaginary = servo_denominator(loop, w)
    rate = loop.kd * w
    lead = jnp.arctan2(rate * real - loop.kp * imaginary, loop.kp * real + rate * imaginary)
    return lead - w * loop.delay


def _level_reached(loop: JointLoop, level: jax.Array) -> jax.Array:
    """A frequency [rad/s] beyond which the phase is below `level` for good; inf if never.

    phase <= pi/2 - w td, and beyond wn the phase is negative whatever the delay.
    """
    by_delay = (0.5 * math.pi - level) / jnp.where(loop.delay > 0, loop.delay, 1.0)
    by_delay = jnp.where(loop.delay > 0, by_delay, jnp.inf)
    by_servo = jnp.where(level >= 0, 1.01 * loop.natural_frequency, jnp.inf)
    return jnp.minimum(by_delay, by_servo)


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
    """Real and imaginary part of P(w) = D(jw) exp(j w td): marginal kp = m w^2 Re P, kd = m w Im P.

    w: frequency [rad/s]
    """
    real, imaginary = servo_denominator(loop, w)
    cosine, sine = jnp.cos(w * loop.delay), jnp.sin(w * loop.delay)
    return real * cosine - imaginary * sine, real * sine + imaginary * cosine


def slowdown_residual(loop: JointLoop, w: jax.Array) -> jax.Array:
    """Re P - m kp / kd^2 (Im P)^2 [-]: zero where (kp k^2, kd k) meets the marginal curve.

    w: frequency [rad/s]
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
    low = jnp.maximum(0.2 * jnp.minimum(guess, high), 1e6 * tiny)

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
