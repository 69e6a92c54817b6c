"""The largest root of a loop with a long delay line, whatever the line's length.

A loop with one command, delayed by D whole control periods, has the characteristic equation

    1 + L(z) = 0,    L(z) = z^-(D+1) R(z),

with R a quotient of short polynomials (`jaxact.simulation.growth.delayed_loop`); a line of a
thousand periods only makes D larger. With log z = sigma + j theta, roots are found by Newton's
method from points of a circle |z| = exp(sigma), and the argument principle counts those outside it:

    roots outside = poles outside - (turns of 1 + L around 0, counterclockwise, along the circle)

where |L| < 1 the curve cannot turn around 0, and where |L| > 1 its turns are those of L, whose
phase is that of R minus (D + 1) theta. The largest root is one that Newton found, outside of which
no other is counted.

Sources: Astrom, Wittenmark, "Computer-Controlled Systems", 3rd ed., section 3.2, for the argument
principle of sampled loops; Michiels, Niculescu, "Stability and Stabilization of Time-Delay
Systems", SIAM 2007, section 2, for the chain of roots that a delay makes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.simulation.growth import characteristic as _characteristic
from jaxact.simulation.growth.delayed_loop import (
    DelayedLoop,
    Logarithm,
    Pair,
    apart,
    denominator,
    logarithm,
    newton_step,
    wrapped,
)
from jaxact.simulation.growth.delayed_loop import poles as open_poles

# A root counts as the largest if none is this much larger, relative to its logarithm.
_WITHIN = 2e-3
# Points of a circle on either side of z = 1, a pole, and z = -1: in equal ratios of their distance
# from there, and farther away [rad] in equal steps.
_RATIOS, _STEPS, _FINE = 24, 16, 0.15
# Angles added to a circle where |L| turns around close to 1.
_EXTREMA = 6
_STARTS = 10
_NEWTON_STEPS = 7
_MOST_CIRCLES = 60
# Farther out than any loop that is computed [-].
_FARTHEST = 300.0
# Longest line, in control periods, whose polynomial is written out.
_SHORT = 48
_SQUARINGS = 20
# Of the coefficients of a polynomial, until its roots are there.
_ROUNDINGS = 100.0


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Sampled:
    """L on a circle, each of shape (points,).

    Attributes:
        angle: theta [rad], rising from 0 to pi.
        size, phase: log |L| and its continuous phase [rad].
        size_slope, phase_slope: their derivatives by theta.
        step: Newton's step from here for log(-L) = 0, real and imaginary part.
    """

    angle: jax.Array
    size: jax.Array
    phase: jax.Array
    size_slope: jax.Array
    phase_slope: jax.Array
    step: Pair


def _angles(loop: DelayedLoop, poles: jax.Array, sigma: jax.Array) -> jax.Array:
    """Angles from 0 to pi in rising order, close together wherever L can change quickly."""
    ringing = jnp.where((poles.imag > 0.0) & (poles.imag < math.pi), poles.real, -jnp.inf)
    place = jnp.argmax(ringing)
    rings = ringing[place] > -jnp.inf
    middle = jnp.where(rings, poles.imag[place], 0.5 * math.pi)
    marks = jnp.stack([jnp.zeros_like(middle), middle, jnp.full_like(middle, math.pi)])
    # The distance to the nearest pole or zero, and how far it is to the next mark.
    slope = logarithm(loop, jnp.full_like(marks, sigma), marks).slope
    delayed = slope[0] + loop.delay + 1.0
    scale = 1.0 / jnp.hypot(delayed, slope[1])
    scale = jnp.minimum(scale, jnp.min(jnp.diff(marks)))
    beside = jnp.where(rings, jnp.abs(poles.real[place] - sigma), jnp.inf)
    near_one, near_minus_one = jnp.minimum(scale[0], jnp.abs(sigma)), scale[2]
    beside = jnp.minimum(scale[1], beside)

    def spread(nearest: jax.Array, width: jax.Array) -> jax.Array:
        """Distances from 0 to a width: first in equal ratios, then in equal steps."""
        fine = jnp.minimum(width, _FINE)
        start = jnp.minimum(jnp.clip(0.1 * nearest, 1e-12, 0.1), 0.5 * fine)
        ratios = jnp.arange(_RATIOS) / _RATIOS
        close = start * jnp.exp(jnp.log(fine / start) * ratios)
        return jnp.concatenate([close, fine + (width - fine) * jnp.arange(_STEPS) / _STEPS])

    below, above = 0.5 * middle, 0.5 * (math.pi - middle)
    zero = jnp.zeros((1,), sigma.dtype)
    parts = [zero, spread(near_one, below), (middle - spread(beside, below))[::-1]]
    parts += [middle + spread(beside, above), (math.pi - spread(near_minus_one, above))[::-1]]
    return jnp.concatenate([*parts, zero + math.pi])


def _cubic(t: jax.Array, ends: Pair, slopes: Pair) -> jax.Array:
    """Value at t between 0 and 1 of the cubic with these values and slopes at 0 and 1."""
    (y0, y1), (m0, m1) = ends, slopes
    rise = t * t * (3.0 - 2.0 * t)
    return y0 + rise * (y1 - y0) + t * (1.0 - t) * ((1.0 - t) * m0 - t * m1)


def _flat_between(angle: jax.Array, at: Logarithm) -> jax.Array:
    """Angles between the given ones where |L| has an extremum close to 1.

    There |L| can pass 1 twice between two angles, and the curve go around 0 unseen.
    """
    width = jnp.diff(angle)
    slope = -at.slope[1]
    m0, m1 = slope[:-1] * width, slope[1:] * width
    # The cubic's slope is m0 + 2 p t + q t^2, with p and q from its ends.
    rise = jnp.diff(at.size)
    p, q = 3.0 * rise - 2.0 * m0 - m1, 3.0 * (m0 + m1 - 2.0 * rise)
    root = jnp.sqrt(jnp.maximum(p * p - m0 * q, 0.0))
    t = m0 / jnp.where(m0 > 0.0, root - p, -root - p)
    turns = (m0 * m1 < 0.0) & (t > 0.0) & (t < 1.0)
    value = _cubic(t, (at.size[:-1], at.size[1:]), (m0, m1))
    _, places = jax.lax.top_k(jnp.where(turns, -jnp.abs(value), -jnp.inf), _EXTREMA)
    return angle[places] + width[places] * jnp.where(turns, t, 0.5)[places]


def _sampled(loop: DelayedLoop, poles: jax.Array, sigma: jax.Array) -> _Sampled:
    angle = apart(_angles(loop, poles, sigma))
    at = logarithm(loop, sigma, angle)
    more = apart(_flat_between(angle, at))
    angle, at = jax.tree.map(
        lambda *parts: jnp.concatenate(parts), (angle, at), (more, logarithm(loop, sigma, more))
    )
    order = jnp.argsort(angle)
    angle, at = apart(jax.tree.map(lambda values: values[order], (angle, at)))
    turned = jnp.cumsum(wrapped(jnp.diff(at.short)))
    phase = at.short[0] + jnp.concatenate([jnp.zeros_like(turned[:1]), turned]) - at.late
    return apart(_Sampled(angle, at.size, phase, -at.slope[1], at.slope[0], newton_step(at)))


def _phase_at_unit_size(at: _Sampled) -> jax.Array:
    """Phase where |L| = 1 in each interval whose ends are on either side of it.

    From the cubic through both ends with both slopes.
    """
    width = jnp.diff(at.angle)
    sizes = at.size[:-1], at.size[1:]
    slopes = at.size_slope[:-1] * width, at.size_slope[1:] * width

    def halve(_, ends):
        low, high = ends
        middle = 0.5 * (low + high)
        before = jnp.sign(_cubic(middle, sizes, slopes)) == jnp.sign(sizes[0])
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    ends = jnp.zeros_like(width), jnp.ones_like(width)
    t, _ = jax.lax.fori_loop(0, 20, halve, ends)
    phases = at.phase[:-1], at.phase[1:]
    return _cubic(t, phases, (at.phase_slope[:-1] * width, at.phase_slope[1:] * width))


def _outside(at: _Sampled, poles: jax.Array, sigma: jax.Array) -> jax.Array:
    """Number of closed-loop roots outside the circle, by the argument principle."""
    above = at.size > 0.0
    small = jnp.exp(-jnp.abs(at.size))
    turned = jnp.where(above, -at.phase, at.phase)
    small, turned = apart((small, turned))
    rest = jnp.arctan2(small * jnp.sin(turned), 1.0 + small * jnp.cos(turned))
    # The angle of 1 + L, continuous while |L| stays above 1, or below it.
    own, level = apart((jnp.where(above, at.phase + rest, rest), _phase_at_unit_size(at)))
    level = 2.0 * math.pi * jnp.round(level / (2.0 * math.pi))
    change = jnp.diff(own)
    change = jnp.where(above[:-1] & ~above[1:], change + level, change)
    change = jnp.where(~above[:-1] & above[1:], change - level, change)
    return jnp.sum(poles.real > sigma) - jnp.round(jnp.sum(change) / math.pi)


def _best_root(loop: DelayedLoop, at: _Sampled, sigma: jax.Array) -> jax.Array:
    """Largest log |z| of the roots that Newton finds from a circle; -inf where it finds none."""
    far = jnp.hypot(*at.step)
    far = jnp.where(jnp.isfinite(far), far, jnp.inf)
    left, right = jnp.insert(far[:-1], 0, jnp.inf), jnp.append(far[1:], jnp.inf)
    # Elsewhere the step is not a prediction: it leads past what bends L.
    gap = jnp.diff(at.angle)
    local = jnp.maximum(jnp.append(gap, gap[-1]), jnp.insert(gap, 0, gap[0]))
    nearest = (far <= left) & (far <= right) & (far < 3.0 * (local + jnp.abs(sigma)))
    score, places = jax.lax.top_k(jnp.where(nearest, sigma + at.step[0], -jnp.inf), _STARTS)

    def newton(_, place):
        step = newton_step(logarithm(loop, *place))
        limit = jnp.minimum(1.0, 0.5 / jnp.hypot(*step))
        return place[0] + limit * step[0], place[1] + limit * step[1]

    angle = at.angle[places]
    place = jax.lax.fori_loop(0, _NEWTON_STEPS, newton, (jnp.full_like(angle, sigma), angle))
    size = place[0]
    step = jnp.hypot(*newton_step(logarithm(loop, *place)))
    sound = jnp.isfinite(size) & (step <= 1e-4 * jnp.abs(size) + 0.1 * _resolution(size))
    return jnp.max(jnp.where(sound & (score > -jnp.inf), size, -jnp.inf))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class _Search:
    """Bounds of the largest log |z|.

    Attributes:
        found: largest root found by Newton.
        above: largest circle with roots outside it.
        below: smallest circle without.
        sigma: next circle.
        circles: looked at so far.
    """

    found: jax.Array
    above: jax.Array
    below: jax.Array
    sigma: jax.Array
    circles: jax.Array


def _resolution(like: jax.Array) -> float:
    """Smallest |log z| over a control period whose sign is told: 1e-9 in float64."""
    return float(jnp.finfo(like.dtype).eps) ** 0.575


def _margin(sigma: jax.Array) -> jax.Array:
    return _WITHIN * jnp.abs(sigma) + _resolution(sigma)


def _largest(search: _Search) -> tuple[jax.Array, jax.Array]:
    """The largest log |z|, and whether its bounds agree."""
    largest = jnp.maximum(search.found, search.above)
    return largest, jnp.isfinite(largest) & (search.below - largest <= 1.5 * _margin(largest))


def _unfinished(search: _Search) -> jax.Array:
    _, agree = _largest(search)
    return ~agree & (search.circles < _MOST_CIRCLES) & (jnp.abs(search.sigma) < _FARTHEST)


def _look(loop: DelayedLoop, poles: jax.Array, search: _Search) -> _Search:
    """Look at one more circle, and choose the next one."""
    sigma = search.sigma
    at = _sampled(loop, poles, sigma)
    count = _outside(at, poles, sigma)
    found = jnp.maximum(search.found, _best_root(loop, at, sigma))
    above = jnp.where(count > 0.0, jnp.maximum(search.above, sigma), search.above)
    below = jnp.where(count <= 0.0, jnp.minimum(search.below, sigma), search.below)
    beyond = found + _margin(found)
    stride = jnp.maximum(0.05, jnp.abs(sigma))
    middle = 0.5 * (above + below)
    middle = jnp.where(jnp.isinf(above), below - stride, middle)
    middle = jnp.where(jnp.isinf(below), above + stride, middle)
    useful = (found > above) & (beyond < below)
    return _Search(found, above, below, jnp.where(useful, beyond, middle), search.circles + 1)


def log_radius(loop: DelayedLoop, longest: int, tolerance: jax.Array) -> jax.Array:
    """Logarithm of the largest |z| of a loop's roots, shape ().

    Of a short line by Graeffe's iteration on the whole polynomial
    (`jaxact.simulation.growth.characteristic`), where its coefficients in z tell the roots apart,
    else by circles. Right within 0.4 % or the tolerance; 0 where it is so small that rounding hides
    its sign; NaN where it could not be found. It has no derivative.

    Args:
        loop: in float64; in float32, more is hidden.
        longest: static; largest D that occurs.
        tolerance: error that does not matter.
    """
    quick = jnp.full_like(loop.delay, jnp.nan)
    if longest <= _SHORT:
        quick = _by_polynomial(loop, longest, tolerance)
    search = _one_by_one if jax.default_backend() == "cpu" else _where_unknown
    return search(loop, quick)


def _by_polynomial(loop: DelayedLoop, longest: int, tolerance: jax.Array) -> jax.Array:
    """As `log_radius`, NaN where rounding of the polynomial's coefficients shows."""
    shares = (jnp.arange(longest + 1) == loop.delay).astype(loop.delay.dtype)
    late = jnp.convolve(shares, loop.numerator)
    opened = denominator(loop.factors)[1:]
    opened = jnp.pad(opened, (0, max(late.size - opened.size, 0)))
    late = jnp.pad(late, (0, opened.size - late.size))
    radius = _characteristic.log_largest_root([*(opened + late)], _SQUARINGS)
    doubt = polynomial_doubt(jnp.prod(jnp.minimum(jnp.abs(loop.factors[1:, 1]), 1.0)))
    return jnp.where((doubt <= tolerance) & (jnp.abs(radius) > doubt), radius, jnp.nan)


def polynomial_doubt(others: Any) -> Any:
    """Error of log |z| that rounding of a polynomial's coefficients in z makes, at worst.

    Two roots at z = 1, as small gains have them, part by the root of what the others magnify.

    Args:
        others: value at z = 1 of the polynomial of all other open-loop poles, in float64 or 32.
    """
    return (_ROUNDINGS * jnp.finfo(others.dtype).eps / others) ** 0.5


def _by_circles(loop: DelayedLoop) -> jax.Array:
    """As `log_radius`, of any loop."""
    poles = open_poles(loop)
    resolution = _resolution(loop.delay)
    never = jnp.full_like(loop.delay, jnp.inf)
    start = jnp.full_like(never, resolution)
    search = _Search(-never, -never, never, start, jnp.zeros((), jnp.int32))
    search = jax.lax.while_loop(_unfinished, lambda now: _look(loop, poles, now), search)
    largest, agree = _largest(search)
    largest = jnp.where(jnp.abs(largest) <= 2.0 * resolution, 0.0, largest)
    return jnp.where(agree, largest, jnp.nan)


def _where_unknown(loop: DelayedLoop, known: jax.Array) -> jax.Array:
    """What is known already, or else what circles find."""
    return jax.lax.cond(jnp.isnan(known), lambda: _by_circles(loop), lambda: known)


# The points of a circle fill the vector units of a CPU, and no loop waits for others' circles.
_one_by_one = jax.custom_batching.sequential_vmap(_where_unknown)
