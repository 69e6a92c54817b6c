"""Where |L| and the phase of a joint's loop turn: roots of cubics in w^2.

A filter of the velocity makes them quartics, damping and stiffness of the joint raise the degree by
two more.

The fields of a loop have shape (1, ...): candidates on axis 0, the batch behind it.
"""

import jax
import jax.numpy as jnp

from jaxact.analysis.joint.frequency import JointLoop, filter_lag, lead_gain
from jaxact.analysis.joint.positive_roots import (
    apart,
    positive_cubic_roots,
    positive_roots,
    sort_rows,
)

Polynomial = list[jax.Array]


def gain_extremes(loop: JointLoop) -> jax.Array:
    """The frequencies [rad/s] where |L| has its local minimum and maximum, shape (2, ...).

    With a filter of the velocity, or of a sprung joint, shape (4, ...), with both (5, ...): the
    cubic below becomes a polynomial of that degree.
    Only a lightly damped servo has them; otherwise they are harmless other frequencies.

    With t = (w/wn)^2, a = (kp/wn)^2, b = kd^2, e = 4 zeta^2 - 2:
    2 a + (3 a e + b) t + (4 a + 2 b e) t^2 + 3 b t^3 = 0.
    """
    if loop.sprung:
        return _sprung_gain_extremes(loop)
    if loop.velocity_filter is not None:
        return _filtered_gain_extremes(loop)
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


def _filtered_gain_extremes(loop: JointLoop) -> jax.Array:
    """As `gain_extremes`, shape (4, ...), of |L|^2 = N / (t^2 R F) up to a factor.

    N = a + b t with b = (kd + kp tau)^2, R = 1 + e t + t^2, F = 1 + (wn tau)^2 t:
    N (2 R F + t R' F + t R F') - b t R F = 0.
    """
    wn = jnp.where(jnp.isinf(loop.natural_frequency), 1.0, loop.natural_frequency)
    one = jnp.ones_like(wn)
    a, b = (loop.kp / wn) ** 2, lead_gain(loop) ** 2
    e, f = 4.0 * loop.damping_ratio**2 - 2.0, (wn * filter_lag(loop)) ** 2
    servo, lowpass = [one, e * one, one], [one, f * one]
    both = _product(servo, lowpass)
    falling = [(2.0 + k) * both[k] for k in range(4)]  # 2 R F + t (R F)'
    quartic = _product([a, b], falling)
    quartic = [quartic[0], *(quartic[k] - b * both[k - 1] for k in range(1, 5))]
    t, present = positive_roots(quartic, one)
    return wn * jnp.sqrt(sort_rows(jnp.where(present, t, apart((0.137, 0.61, 1.28, 3.3), t))))


def phase_extremes(loop: JointLoop) -> jax.Array:
    """The frequencies [rad/s] where the phase turns, shape (3, ...), or (4, ...) with a filter.

    Of a sprung joint, shape (5, ...), or (6, ...) with a filter.

    Slots of missing ones hold other frequencies, which do no harm.
    With r = kd/kp, v = 1/wn, y = w^2, R = |D|^2 = 1 + e v^2 y + v^4 y^2, e = 4 zeta^2 - 2:
    r R - (1 + r^2 y) 2 zeta v (1 + v^2 y) - td (1 + r^2 y) R = 0.
    """
    if loop.sprung:
        return _sprung_phase_extremes(loop)
    if loop.velocity_filter is not None:
        return _filtered_phase_extremes(loop)
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
    return jnp.sqrt(jnp.where(present, y, scale * apart((0.31, 0.83, 2.7), y)))


def _filtered_phase_extremes(loop: JointLoop) -> jax.Array:
    """As `phase_extremes`, shape (4, ...), with r = kd/kp + tau and F = 1 + tau^2 y.

    r R F - (1 + r^2 y) (2 zeta v (1 + v^2 y) F + tau R + td R F) = 0.
    """
    kp, td, tau = loop.kp, loop.delay, filter_lag(loop)
    lead = jnp.abs(lead_gain(loop))
    size = jnp.where(kp > 0, kp, jnp.maximum(lead, jnp.finfo(lead.dtype).tiny))
    a, r = jnp.where(kp > 0, 1.0, 0.0), lead_gain(loop) / size
    v = 1.0 / loop.natural_frequency
    g, one = 2.0 * loop.damping_ratio * v, jnp.ones_like(v * r)
    servo = [one, (4.0 * loop.damping_ratio**2 - 2.0) * v * v, v**4 * one]
    lowpass = [one, tau * tau * one]
    both = _product(servo, lowpass)
    lags = [td * both[k] for k in range(4)]
    for k in range(3):
        lags[k] = lags[k] + tau * servo[k]
    for k, of_servo in enumerate(_product([g * one, g * v * v], lowpass)):
        lags[k] = lags[k] + of_servo
    lagging = _product([a, r * r], lags)
    quartic = [a * r * both[k] - lagging[k] for k in range(4)] + [-lagging[4]]
    lag = g + td + 0.1 * v + tau
    balance = jnp.where(lag > 0, (jnp.abs(r) + lag) * lag, r * r)
    scale = one / jnp.where(balance > 0, balance, 1.0)
    y, present = positive_roots(quartic, scale)
    return jnp.sqrt(jnp.where(present, y, scale * apart((0.31, 0.83, 1.7, 2.7), y)))


def typical_frequency(loop: JointLoop) -> jax.Array:
    """A frequency [rad/s] that the motion of a sprung joint has under these gains, > 0."""
    size = (jnp.abs(loop.kp) + jnp.abs(loop.joint_stiffness)) / loop.mass
    rate = (jnp.abs(loop.kd) + loop.joint_damping) / loop.mass
    return jnp.maximum(jnp.sqrt(size) + rate, jnp.sqrt(jnp.finfo(size.dtype).tiny))


def _sprung_parts(loop: JointLoop, unit: jax.Array) -> tuple[Polynomial, ...]:
    """N = |C|^2 F, R = |D|^2, F = 1 + (w tau)^2 and G = |P|^2 by powers of t = (w/unit)^2.

    N has the unit of kp^2, G that of (m unit^2)^2.
    """
    one = jnp.ones_like(unit)
    x2 = (unit / loop.natural_frequency) ** 2
    kappa = loop.joint_stiffness / (loop.mass * unit**2)
    gamma = loop.joint_damping / (loop.mass * unit)
    servo = [one, (4.0 * loop.damping_ratio**2 - 2.0) * x2, x2**2]
    lowpass = [one] if loop.velocity_filter is None else [one, (unit * filter_lag(loop)) ** 2]
    plant = [kappa**2, gamma**2 - 2.0 * kappa, one]
    return [loop.kp**2, (lead_gain(loop) * unit) ** 2], servo, lowpass, plant


def _sprung_gain_extremes(loop: JointLoop) -> jax.Array:
    """As `gain_extremes`, of |L|^2 = N / (G R F): N' G R F - N (G R F)' = 0."""
    unit = typical_frequency(loop)
    control, servo, lowpass, plant = _sprung_parts(loop, unit)
    below = _product(_product(servo, lowpass), plant)
    slope = [k * below[k] for k in range(1, len(below))]
    left, right = _product([control[1]], below), _product(control, slope)
    t, present = positive_roots([a - b for a, b in zip(left, right, strict=True)], unit / unit)
    missing = apart((0.137, 0.61, 1.28, 3.3, 5.9)[: t.shape[0]], t)
    return unit * jnp.sqrt(sort_rows(jnp.where(present, t, missing)))


def _sprung_phase_extremes(loop: JointLoop) -> jax.Array:
    """As `phase_extremes`, with all lags: over N R F G the slope of the phase is

    kp (kd + kp tau) R F G - N (g (1 + v^2 y) F G + tau R G + td R F G + c (k + m y) R F).
    """
    unit = typical_frequency(loop)
    control, servo, lowpass, plant = _sprung_parts(loop, unit)
    x, one = unit / loop.natural_frequency, jnp.ones_like(unit)
    gamma = loop.joint_damping / (loop.mass * unit)
    kappa = loop.joint_stiffness / (loop.mass * unit**2)
    lag = 2.0 * loop.damping_ratio * x
    whole = _product(_product(servo, lowpass), plant)
    lags = _sum(
        _product([lag, lag * x * x], _product(lowpass, plant)),
        _product([unit * loop.delay], whole),
        _product([gamma * kappa, gamma], _product(servo, lowpass)),
    )
    if loop.velocity_filter is not None:
        lags = _sum(lags, _product([unit * filter_lag(loop)], _product(servo, plant)))
    size = control[0] + control[1]
    size = jnp.where(size > 0, size, 1.0)
    leading = _product([loop.kp * lead_gain(loop) * unit / size], whole)
    lagging = _product([a / size for a in control], lags)
    t, present = positive_roots(_sum(leading, [-a for a in lagging]), one)
    missing = apart((0.31, 0.83, 1.7, 2.7, 4.4, 7.3)[: t.shape[0]], t)
    return unit * jnp.sqrt(jnp.where(present, t, missing))


def _sum(*terms: Polynomial) -> Polynomial:
    """Sum of polynomials, ascending."""
    longest = max(map(len, terms))
    columns = ([term[k] for term in terms if k < len(term)] for k in range(longest))
    return [sum(column[1:], start=column[0]) for column in columns]


def _product(first: Polynomial, second: Polynomial) -> Polynomial:
    """Coefficients of a product of two polynomials, ascending."""
    total = [jnp.zeros_like(first[0]) for _ in range(len(first) + len(second) - 1)]
    for i, one in enumerate(first):
        for j, other in enumerate(second):
            total[i + j] = total[i + j] + one * other
    return total
