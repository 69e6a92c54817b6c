"""Crossovers and peaks of the sampled loop, up to the Nyquist frequency.

The bracketing grid is dense in the logarithm of frequency and in the phase of the delay, and is
completed by the extremes of |L|, so that a narrow resonance between two grid points cannot hide a
pair of crossovers. What brackets find is refined by Newton. Frequencies are theta = w T.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp

from jaxact.analysis.sampled.period_map import SampledLoop
from jaxact.analysis.sampled.pulse import PulseTransfer, plant_response, pulse_transfer
from jaxact.compilation.once import once, together

GAIN_SLOTS = 8
PHASE_SLOTS = 12

_LOG_POINTS = 120
_POINTS_PER_STEP = 10
_EXTREMES = 8
_BISECTIONS = 14
_NEWTON_STEPS = 5
_PEAK_STEPS = 10
_TINY = 1e-30
# How far from the negative real axis a refined crossing of it may be [rad].
_ON_AXIS = 1e-2

Response = Callable[[jax.Array], jax.Array]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Found:
    """What the search found in one loop, all theta [rad] and constant.

    Attributes:
        gain, gain_present: gain crossovers and which slots are filled, shape (GAIN_SLOTS,).
        phase, phase_present: crossings of the negative real axis, nearest to |L| = 1 first, shape
            (PHASE_SLOTS,).
        peaks: of |S|, |T|, |S - 1/2|, shape (3,).
        overflow: bool, there were more than the slots hold.
        extremes: of |L|, shape (8,).
    """

    gain: jax.Array
    gain_present: jax.Array
    phase: jax.Array
    phase_present: jax.Array
    peaks: jax.Array
    overflow: jax.Array
    extremes: jax.Array


def sampled_response(loop: SampledLoop, w: jax.Array) -> jax.Array:
    """L(exp(j w T)) [-] of one loop, complex.

    Args:
        loop: fields scalar.
        w: frequency [rad/s], any shape, 0 < w <= pi/T.
    """
    return response_at(loop, pulse_transfer(loop), w * loop.control_period)


def response_at(loop: SampledLoop, transfer: PulseTransfer, theta: jax.Array) -> jax.Array:
    """L(exp(j theta)) [-] of one loop with its pulse-transfer function; theta: [rad]."""
    half = 0.5 * theta
    u = jax.lax.complex(jnp.cos(theta), -jnp.sin(theta))
    s = 2.0 * jnp.sin(half) * jax.lax.complex(jnp.sin(half), jnp.cos(half))
    lag = theta * (transfer.steps + 1.0)
    hold = jax.lax.complex(jnp.cos(lag), -jnp.sin(lag))
    position, rate = plant_response(transfer, u, s, hold)
    return loop.kp * position + loop.kd * rate


def with_slope(function: Response, theta: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Value and derivative by theta of an elementwise function."""
    value, first = together(*jax.jvp(function, (theta,), (jnp.ones_like(theta),)))
    return value, first


def with_slopes(function: Response, theta: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Value, first and second derivative by theta of an elementwise function."""
    one = jnp.ones_like(theta)

    def slope(theta: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(function, (theta,), (one,))

    (value, first), (_, second) = jax.jvp(slope, (theta,), (one,))
    value, first, second = together(value, first, second)
    return value, first, second


def crossing_residual(
    value: jax.Array, slope: jax.Array, of_gain: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """ln |L| where `of_gain`, else arg(-L), and its derivative by theta."""
    relative = slope / value
    residual = jnp.where(of_gain, jnp.log(jnp.abs(value)), jnp.arctan2(-value.imag, -value.real))
    return residual, jnp.where(of_gain, relative.real, relative.imag)


def peak_slopes(
    value: jax.Array, first: jax.Array, second: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """First and second derivative by theta of ln |S|, ln |T|, ln |S - 1/2|, shape (3, k).

    Args:
        value, first, second: L and its derivatives, shape (3, k).
    """

    def log_slopes(f: jax.Array, sign: float) -> tuple[jax.Array, jax.Array]:
        relative = sign * first / f
        return relative.real, (sign * second / f - relative**2).real

    below = log_slopes(1.0 + value, 1.0)
    of_value, of_minus = log_slopes(value, 1.0), log_slopes(1.0 - value, -1.0)
    rows = jnp.arange(3)[:, None]
    slope, curvature = (
        jnp.where(rows == 0, 0.0, jnp.where(rows == 1, a, b)) - c
        for a, b, c in zip(of_value, of_minus, below, strict=True)
    )
    return slope, curvature


def peak_heights(value: jax.Array) -> jax.Array:
    """|S|, |T|, |S - 1/2| [-] of the rows of L, shape (3, k)."""
    top = jnp.stack(
        [jnp.ones_like(value[0].real), jnp.abs(value[1]), 0.5 * jnp.abs(1.0 - value[2])]
    )
    return top / jnp.abs(1.0 + value)


def search(loop: SampledLoop, transfer: PulseTransfer, max_delay_steps: int) -> Found:
    """Refined crossovers and peaks of one loop; fields scalar and constant.

    Args:
        transfer: the loop's `pulse_transfer`.
    """
    response = partial(response_at, loop, transfer)
    grid = bracketing_grid(loop, max_delay_steps)
    extremes = _gain_extremes(response, grid)
    grid = jnp.sort(jnp.concatenate([grid, extremes]))
    value = once(response(grid))
    gain = jnp.log(jnp.abs(value))
    changes = (gain[:-1] > 0) != (gain[1:] > 0)
    gain_cells, gain_present = first_cells(changes, GAIN_SLOTS)

    # The negative real axis is crossed where Im changes sign with Re < 0 in between.
    crosses = (value.imag[:-1] > 0) != (value.imag[1:] > 0)
    weight = jnp.abs(value.imag)
    crosses &= value.real[:-1] * weight[1:] + value.real[1:] * weight[:-1] < 0
    nearness = -jnp.minimum(jnp.abs(gain[:-1]), jnp.abs(gain[1:]))
    top, phase_cells = jax.lax.top_k(jnp.where(crosses, nearness, -jnp.inf), PHASE_SLOTS)

    cells = jnp.concatenate([gain_cells, phase_cells])
    of_gain = jnp.arange(GAIN_SLOTS + PHASE_SLOTS) < GAIN_SLOTS
    theta = _solve_crossings(response, of_gain, grid[cells], grid[cells + 1], value[cells])
    # At pi, which is looked at by itself, L is real but for rounding.
    rounding = 64.0 * jnp.finfo(theta.dtype).eps * (2.0 + transfer.steps)
    apart = theta[GAIN_SLOTS:] < math.pi - rounding
    if loop.sprung:
        # At an undamped joint's own frequency L changes its sign by way of infinity.
        there = response(theta[GAIN_SLOTS:])
        apart &= jnp.abs(jnp.arctan2(-there.imag, -there.real)) < _ON_AXIS
    return Found(
        gain=theta[:GAIN_SLOTS],
        gain_present=gain_present,
        phase=theta[GAIN_SLOTS:],
        phase_present=jnp.isfinite(top) & apart,
        peaks=_locate_peaks(response, grid, value, theta),
        overflow=(jnp.sum(changes) > GAIN_SLOTS) | (jnp.sum(crosses) > PHASE_SLOTS),
        extremes=extremes,
    )


def bracketing_grid(loop: SampledLoop, max_delay_steps: int) -> jax.Array:
    """theta in (0, pi], ascending: logarithmic from below every corner, and linear."""
    rigid = jnp.sqrt(jnp.abs(loop.kp) / loop.mass)
    corner = jnp.where(loop.kd != 0, jnp.abs(loop.kp / jnp.where(loop.kd != 0, loop.kd, 1)), rigid)
    low = 0.05 * loop.control_period * jnp.minimum(rigid, corner)
    if loop.joint is not None:
        c, k = (jnp.abs(a) for a in loop.joint)
        slow = jnp.where(k > 0, jnp.sqrt(k / loop.mass), jnp.abs(loop.kp) / jnp.maximum(c, _TINY))
        low = 1e-2 * jnp.minimum(low, 0.05 * loop.control_period * slow)
    low = jnp.clip(low, 1e-12, 0.01)
    logarithmic = jnp.exp(jnp.linspace(jnp.log(low), math.log(math.pi), _LOG_POINTS)[:-1])
    number = _POINTS_PER_STEP * (max_delay_steps + 6)
    linear = jnp.linspace(0.0, math.pi, number + 1, dtype=logarithmic.dtype)[1:]
    return jnp.sort(jnp.concatenate([logarithmic, linear]))


def _gain_extremes(response: Response, grid: jax.Array) -> jax.Array:
    """Extremes of |L|, between which it is monotone, and points of the grid's first cells where
    there are fewer; shape (_EXTREMES,).
    """

    def slope(theta: jax.Array) -> jax.Array:
        value, first = with_slope(response, theta)
        return (first / value).real

    slopes = slope(grid)
    cells, present = first_cells((slopes[:-1] > 0) != (slopes[1:] > 0), _EXTREMES)
    rising = slopes[cells] > 0

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = 0.5 * (low + high)
        before = (slope(middle) > 0) == rising
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    low, high = jax.lax.fori_loop(0, 2 * _BISECTIONS, halve, (grid[cells], grid[cells + 1]))
    unused = 0.5 * (grid[:_EXTREMES] + grid[1 : _EXTREMES + 1])
    return jnp.where(present, 0.5 * (low + high), unused)


def first_cells(mask: jax.Array, slots: int) -> tuple[jax.Array, jax.Array]:
    """Indices of the first true entries and which of the slots are filled."""
    order = jnp.where(mask, -jnp.arange(mask.shape[0]), -mask.shape[0])
    key, index = jax.lax.top_k(order, slots)
    return index, key > -mask.shape[0]


def _solve_crossings(
    response: Response, of_gain: jax.Array, low: jax.Array, high: jax.Array, at_low: jax.Array
) -> jax.Array:
    """The crossover in each cell, L at the beginning of which is known: bisection, then Newton
    inside the bracket.
    """

    def side(value: jax.Array) -> jax.Array:
        return jnp.where(of_gain, jnp.abs(value) > 1.0, value.imag > 0)

    start = side(at_low)

    def halve(_: int, bracket: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        low, high = bracket
        middle = 0.5 * (low + high)
        before = side(once(response(middle))) == start
        return jnp.where(before, middle, low), jnp.where(before, high, middle)

    low, high = jax.lax.fori_loop(0, _BISECTIONS, halve, (low, high))

    def newton(_: int, theta: jax.Array) -> jax.Array:
        residual, slope = crossing_residual(*with_slope(response, theta), of_gain)
        return jnp.clip(theta - residual / jnp.where(slope == 0, jnp.inf, slope), low, high)

    return jax.lax.fori_loop(0, _NEWTON_STEPS, newton, 0.5 * (low + high))


def _locate_peaks(
    response: Response, grid: jax.Array, value: jax.Array, crossings: jax.Array
) -> jax.Array:
    """theta of the largest |S|, |T|, |S - 1/2|, shape (3,).

    From the best grid points and from every crossover (a sharp peak lies within its own width of
    one), by Newton on F^-2, a parabola at a sharp peak, inside the neighbouring cells.
    """
    heights = peak_heights(jnp.broadcast_to(value, (3, value.shape[0])))
    padded = jnp.pad(heights, ((0, 0), (1, 1)))
    local = (heights >= padded[:, :-2]) & (heights >= padded[:, 2:])
    _, best = jax.lax.top_k(jnp.where(local, heights, -1.0), 3)
    last = grid.shape[0] - 1
    cell = jnp.clip(jnp.searchsorted(grid, crossings), 1, last)

    def at(best_index: jax.Array, cell_index: jax.Array) -> jax.Array:
        cells = grid[jnp.clip(cell_index, 0, last)]
        cells = jnp.broadcast_to(cells, (3, cells.shape[0]))
        return jnp.concatenate([grid[jnp.clip(best_index, 0, last)], cells], axis=1)

    low, high = at(best - 1, cell - 2), at(best + 1, cell + 1)
    theta = at(best, cell).at[:, 3:].set(jnp.broadcast_to(crossings, (3, crossings.shape[0])))

    def step(
        _: int, state: tuple[jax.Array, jax.Array, jax.Array]
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        low, theta, high = state
        slope, curvature = peak_slopes(*with_slopes(response, theta))
        low, high = jnp.where(slope > 0, theta, low), jnp.where(slope > 0, high, theta)
        bowl = 2.0 * slope * slope - curvature
        newton = theta + slope / jnp.where(bowl > 0, bowl, jnp.inf)
        inside = (bowl > 0) & (newton >= low) & (newton <= high)
        return low, jnp.where(inside, newton, 0.5 * (low + high)), high

    refined = jax.lax.fori_loop(0, _PEAK_STEPS, step, (low, theta, high))[1]
    # The end of the axis is a stationary point that no bracket surrounds.
    refined = jnp.concatenate([refined, jnp.full((3, 1), math.pi, dtype=grid.dtype)], axis=1)
    highest = jnp.argmax(peak_heights(response(refined)), axis=1)
    return jnp.take_along_axis(refined, highest[:, None], axis=1)[:, 0]
