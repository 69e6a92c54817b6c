"""Peaks of the sensitivities over frequency, refined to rounding.

With N = (kp + j kd w) exp(-j w td) and M = -m w^2 D(jw), so that L = N / M:

    S = M / (M + N),    T = N / (M + N),    S - 1/2 = (M - N) / (2 (M + N)).

A filter of the velocity gives M the factor 1 + j w tau, and N the gain kd + kp tau for kd. A joint
with damping c and stiffness k has M = (k - m w^2 + j c w) D(jw).

A sharp peak means that L passes -1 closely; then the unit circle or the negative real axis is
crossed within the width of the peak. Candidates clustered around every such crossing, and around
the corners of L, therefore miss none.
"""

import jax
import jax.numpy as jnp

from jaxact.analysis.joint.frequency import (
    JointLoop,
    filter_lag,
    lead_gain,
    plant_parts,
    servo_denominator,
)

_REFINEMENTS = 8
_CANDIDATES = 2
SENSITIVITY, COMPLEMENTARY, DISK = range(3)


def peak_grid(nodes: jax.Array) -> jax.Array:
    """Frequencies [rad/s] in ascending order, clustered (in the logarithm) at the nodes.

    Geometric means of geometric means: square roots are cheaper than exp and log.

    Args:
        nodes: [rad/s], ascending, shape (k, ...).
    """
    left, right = nodes[:-1], nodes[1:]
    middle = jnp.sqrt(left * right)
    lower, upper = jnp.sqrt(left * middle), jnp.sqrt(middle * right)
    first, last = jnp.sqrt(left * lower), jnp.sqrt(upper * right)
    close = 0.04
    near_left, near_right = left + close * (first - left), right + close * (last - right)
    parts = (left, near_left, first, lower, middle, upper, last, near_right)
    inner = jnp.stack(parts, axis=1).reshape((-1, *nodes.shape[1:]))
    return jnp.concatenate([inner, nodes[-1:]])


def squared_parts(loop: JointLoop, w: jax.Array) -> tuple[jax.Array, ...]:
    """|M|^2, |N|^2, |M - N|^2 and |M + N|^2 at w [rad/s]."""
    real, imaginary = servo_denominator(loop, w)
    if loop.velocity_filter is not None:
        turn = w / loop.velocity_filter
        real, imaginary = real - turn * imaginary, imaginary + turn * real
    inertia = -loop.mass * w * w
    if loop.sprung:
        against, damped = plant_parts(loop, w)
        inertia = -against
        m_re, m_im = inertia * real - damped * imaginary, inertia * imaginary + damped * real
    else:
        m_re, m_im = inertia * real, inertia * imaginary
    cosine, sine = jnp.cos(w * loop.delay), jnp.sin(w * loop.delay)
    rate = lead_gain(loop) * w
    n_re, n_im = loop.kp * cosine + rate * sine, rate * cosine - loop.kp * sine
    plus = (m_re + n_re) ** 2 + (m_im + n_im) ** 2
    minus = (m_re - n_re) ** 2 + (m_im - n_im) ** 2
    return m_re**2 + m_im**2, loop.kp**2 + rate**2, minus, plus


def peak_values(loop: JointLoop, w: jax.Array) -> jax.Array:
    """|S|, |T| and |S - 1/2| [-] at the frequencies of each, shape (3, ...).

    Args:
        w: [rad/s], shape (3, ...) in that order.
    """
    inertia, control, minus, plus = squared_parts(loop, w)
    top = jnp.stack([inertia[SENSITIVITY], control[COMPLEMENTARY], 0.25 * minus[DISK]])
    return jnp.sqrt(top / plus)


def locate_peaks(loop: JointLoop, nodes: jax.Array) -> jax.Array:
    """Frequencies [rad/s] of the largest |S|, |T| and |S - 1/2|, shape (3, ...).

    Args:
        nodes: corners and crossings of L [rad/s], ascending, shape (k, batch).
    """
    w = peak_grid(nodes)
    inertia, control, minus, plus = squared_parts(loop, w)
    squares = jnp.stack([inertia / plus, control / plus, minus / plus], axis=1)
    low, start, high = _best_local_maxima(w, squares)
    deep = jax.tree.map(lambda a: a[None], loop)
    refined = _refine(deep, low, start, high)
    inertia, control, minus, plus = squared_parts(deep, refined)
    value = jnp.stack([inertia[:, 0], control[:, 1], minus[:, 2]], axis=1) / plus
    best = value == jnp.max(value, axis=0, keepdims=True)
    return jnp.max(jnp.where(best, refined, 0.0), axis=0)


def _best_local_maxima(w: jax.Array, values: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """The grid points of the largest local maxima with their neighbours, (candidates, 3, batch).

    Only maxima over the grid axis, no gathers: they stay vectorised over the batch.

    Args:
        w: shape (k, batch).
        values: shape (k, 3, batch).
    """
    edge = jnp.zeros_like(values[:1])
    before = jnp.concatenate([edge, values[:-1]])
    after = jnp.concatenate([values[1:], edge])
    peaks = jnp.where(values >= jnp.maximum(before, after), values, -1.0)
    spread = w[:, None]
    left = jnp.concatenate([spread[:1], spread[:-1]])
    right = jnp.concatenate([spread[1:], spread[-1:]])
    rows = []
    for _ in range(_CANDIDATES):
        best = jnp.max(peaks, axis=0, keepdims=True)
        chosen = peaks == best
        rows.append([jnp.max(jnp.where(chosen, a, 0.0), axis=0) for a in (left, spread, right)])
        peaks = jnp.where(chosen, -1.0, peaks)
    low, start, high = (jnp.stack(column) for column in zip(*rows, strict=True))
    # Equal peaks would mix their neighbours.
    return jnp.minimum(low, start), start, high


def peak_slopes(loop: JointLoop, w: jax.Array) -> tuple[jax.Array, jax.Array]:
    """First and second derivative of ln |S|, ln |T|, ln |S - 1/2| by frequency [s], [s^2].

    From the real and imaginary parts of M, N and their derivatives: near a sharp peak M + N
    cancels, and |M + N|^2 must not be expanded.

    Args:
        w: [rad/s], shape (..., 3, batch), the quantity on the last axis but one.
    """
    v = 1.0 / loop.natural_frequency
    v2, g = v * v, 2.0 * loop.damping_ratio * v
    m, kp, kd, td, w2 = loop.mass, loop.kp, lead_gain(loop), loop.delay, w * w
    m_re = (-m * w2 * (1.0 - v2 * w2), -m * w * (2.0 - 4.0 * v2 * w2), -m * (2.0 - 12.0 * v2 * w2))
    m_im = (-m * g * w2 * w, -3.0 * m * g * w2, -6.0 * m * g * w)
    if loop.sprung:
        (a, b), (d, e) = _sprung_coefficients(loop, v2, g)
        m_re = (m_re[0] + a - b * w2, m_re[1] - 2.0 * b * w, m_re[2] - 2.0 * b)
        m_im = (m_im[0] + (d - e * w2) * w, m_im[1] + d - 3.0 * e * w2, m_im[2] - 6.0 * e * w)
    if loop.velocity_filter is not None:
        m_re, m_im = _times_filter(m_re, m_im, filter_lag(loop), w)
    cosine, sine = jnp.cos(w * td), jnp.sin(w * td)
    real, imaginary = kp * cosine + kd * w * sine, kd * w * cosine - kp * sine
    real_1, imaginary_1 = kd * sine + td * imaginary, kd * cosine - td * real
    n_re = (real, real_1, td * (kd * cosine + imaginary_1))
    n_im = (imaginary, imaginary_1, -td * (kd * sine + real_1))

    which = jnp.arange(3)[:, None].reshape((1,) * (w.ndim - 2) + (3, 1))

    def chosen(a: jax.Array, b: jax.Array) -> jax.Array:
        return jnp.where(which == SENSITIVITY, a, jnp.where(which == COMPLEMENTARY, b, a - b))

    top = _log_slopes(list(map(chosen, m_re, n_re)), list(map(chosen, m_im, n_im)))
    bottom = _log_slopes(
        [a + b for a, b in zip(m_re, n_re, strict=True)],
        [a + b for a, b in zip(m_im, n_im, strict=True)],
    )
    return top[0] - bottom[0], top[1] - bottom[1]


def _sprung_coefficients(
    loop: JointLoop, v2: jax.Array, g: jax.Array
) -> tuple[tuple[jax.Array, jax.Array], tuple[jax.Array, jax.Array]]:
    """What damping and stiffness add to M: a - b w^2 + j (d w - e w^3)."""
    c, k = jnp.asarray(loop.joint_damping), jnp.asarray(loop.joint_stiffness)
    return (k, k * v2 + c * g), (k * g + c, c * v2)


Derivatives = tuple[jax.Array, jax.Array, jax.Array]


def _times_filter(
    re: Derivatives, im: Derivatives, lag: jax.Array | float, w: jax.Array
) -> tuple[Derivatives, Derivatives]:
    """F (1 + j w lag) and its derivatives, from those of F in real and imaginary parts."""

    def times_w(f: Derivatives) -> Derivatives:
        return w * f[0], f[0] + w * f[1], 2.0 * f[1] + w * f[2]

    real = [a - lag * b for a, b in zip(re, times_w(im), strict=True)]
    imaginary = [a + lag * b for a, b in zip(im, times_w(re), strict=True)]
    return (real[0], real[1], real[2]), (imaginary[0], imaginary[1], imaginary[2])


def _log_slopes(re: list[jax.Array], im: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
    """First and second derivative of ln |F| from F, F', F'' in real and imaginary parts."""
    square = re[0] ** 2 + im[0] ** 2
    first = (re[0] * re[1] + im[0] * im[1]) / square
    second = (re[0] * re[2] + im[0] * im[2] + re[1] ** 2 + im[1] ** 2) / square
    return first, second - 2.0 * first**2


def _refine(loop: JointLoop, low: jax.Array, start: jax.Array, high: jax.Array) -> jax.Array:
    """Newton's minimum of F^-2 in a bracket that shrinks; bisection where it would leave.

    Near a sharp peak 1/F^2 is a parabola, so its Newton step w + h' / (2 h'^2 - h''), h = ln F,
    arrives at once where that of h itself would run away.
    """

    def step(
        _: int, state: tuple[jax.Array, jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        low, w, high = state
        slope, curvature = peak_slopes(loop, w)
        low, high = jnp.where(slope > 0, w, low), jnp.where(slope > 0, high, w)
        bowl = 2.0 * slope * slope - curvature
        newton = w + slope / jnp.where(bowl > 0, bowl, jnp.inf)
        inside = (bowl > 0) & (newton >= low) & (newton <= high)
        return low, jnp.where(inside, newton, 0.5 * (low + high)), high

    return jax.lax.fori_loop(0, _REFINEMENTS, step, (low, start, high))[1]
