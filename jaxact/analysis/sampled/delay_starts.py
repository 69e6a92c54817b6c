"""Where the search for a sampled loop's delay margin begins: crossovers at parts of a period.

Beyond the loop's own delay h0 = d0 + r [periods], L of every part m of a period has its gain
crossovers theta, and with the phase that is left there, phi = arg(-L) of d0 = 0, one of these is
critical where

    W = (phi + 2 pi n) / theta

is whole: the delay then is W + r + m. From part to part theta and W move, and W may pass a whole
number, or several, in between: by itself a value near one says little where |L| is flat. So W is
followed along pieces of the curves |L| = 1, from every crossover to the nearest of the next part
and back, and the least whole number on every piece is a start. The end of the axis, pi, counts as a
crossover: there curves come and go. Neighbours are the ends of a bow where the part before or after
has fewer crossovers, and where W turns between two parts both ends of its piece are starts. A start
is not followed beyond its piece, at whose ends another one takes over.
"""

from __future__ import annotations

import math
from functools import partial

import jax
import jax.numpy as jnp

from jaxact.analysis.sampled.any_delay import AnyDelay, hold, in_two_parts, response_with
from jaxact.analysis.sampled.period_map import SampledLoop
from jaxact.analysis.sampled.search import (
    GAIN_SLOTS,
    Found,
    bracketing_grid,
    first_cells,
    with_slope,
)

_TURN = 2.0 * math.pi
# Parts of a period at which crossovers are looked for, and starts that are followed, of those that
# mean the shortest delays.
PARTS, STARTS, AT_NYQUIST = 32, 22, 2
_REFINEMENTS = 5
# How dense the grid of crossovers is, as for delays of so many periods.
_DENSE = 18
# How many turns are looked at, from the one before the first that may mean a longer delay.
_TURNS = 8
# How far from a whole number W is a start by itself [periods]: it may turn between two parts.
_NEAR = 1.5 / PARTS
# Crossovers up to here [rad] stay where they are but for a little, and with them what the phase
# leaves, if a part of a period moves that by no more than this [periods].
_FAR, _MOVED = 0.5, 0.1
# A share of theta over which the slope of |L| is taken.
_BESIDE = 1e-3


def is_demanding(
    loop: SampledLoop, late: AnyDelay, newer: jax.Array, found: Found
) -> tuple[jax.Array, jax.Array]:
    """Whether a part of a period may matter to which crossovers there are, or to their order; and
    arg(-L) of the loop's own ones, in [0, 2 pi), shape (GAIN_SLOTS,).
    """
    own = jnp.where(found.gain_present, found.gain, 1.0)
    end = jnp.full(1, math.pi, own.dtype)
    theta = jnp.concatenate([own, (1.0 - _BESIDE) * own, found.extremes, end])
    _, held, moved = in_two_parts(loop, late, theta)
    value = held[None] + jnp.sum(newer[:, :, None] * moved[None], axis=1)
    size = jnp.log(jnp.abs(value))
    spread = jnp.max(size, axis=0) - jnp.min(size, axis=0)
    here, beside, others = (
        slice(GAIN_SLOTS),
        slice(GAIN_SLOTS, 2 * GAIN_SLOTS),
        slice(2 * GAIN_SLOTS, None),
    )
    slope = jnp.abs(size[0, here] - size[0, beside]) / (_BESIDE * own)
    # By spread / slope theta moves, and with it (arg(-L) mod 2 pi) / theta.
    left = _phase_left(value[0, here] * hold(own, parts_beyond(loop)[0]))
    far = (own > _FAR) | ~(left * spread[here] < _MOVED * own**2 * slope)
    close = jnp.abs(size[0, others]) < 2.0 * spread[others]
    return jnp.any(close) | (size[0, -1] > 0.0) | jnp.any(found.gain_present & far), left


def _phase_left(value: jax.Array) -> jax.Array:
    """arg(-L) in [0, 2 pi)."""
    return jnp.mod(jnp.arctan2(-value.imag, -value.real), _TURN)


def near_starts(
    loop: SampledLoop, _: AnyDelay, __: jax.Array, found: Found, left: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """As `starts`, from the loop's own crossovers, those that leave the least first."""
    left = jnp.where(found.gain_present, left / found.gain, jnp.inf)
    order, more = jnp.argsort(left), STARTS + AT_NYQUIST - GAIN_SLOTS
    theta = jnp.where(found.gain_present, found.gain, jnp.nan)[order]
    start = loop.delay / loop.control_period + left[order]
    theta = jnp.pad(theta, (0, more), constant_values=jnp.nan)
    start = jnp.pad(start, (0, more), constant_values=jnp.inf)
    return (
        theta,
        start,
        start[None] + jnp.asarray([[-0.5], [0.5]], start.dtype),
        jnp.zeros((), bool),
    )


def parts_beyond(loop: SampledLoop) -> tuple[jax.Array, jax.Array, jax.Array]:
    """d0; and of the delays at which crossovers are looked for, beyond d0 [periods]: all of it, and
    the part of a period in it; shape (PARTS + 1,). Whole periods, where L has a kink, are among
    them.
    """
    own = loop.delay / loop.control_period
    least = jnp.floor(own)
    beyond = own - least + jnp.arange(PARTS, dtype=own.dtype) / PARTS
    beyond = jnp.sort(jnp.append(beyond, 1.0))
    return least, beyond, beyond - jnp.floor(beyond)


def starts(
    loop: SampledLoop, late: AnyDelay, newer: jax.Array, found: Found, _: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Where Newton begins, from the crossovers at parts of a period.

    Args:
        loop, late, found: of one loop; the last argument is for `near_starts`.
        newer: Gamma_new at each of `parts_beyond`, shape (PARTS + 1, 4).

    Returns:
        theta [rad], NaN where there are fewer, and pi of a root at -1, and the delay [periods],
        shape (STARTS + AT_NYQUIST,) each; the least and the most that the delay may become, shape
        (2, STARTS + AT_NYQUIST); and whether a part had more crossovers than slots.
    """
    least, beyond, part = parts_beyond(loop)
    # Extremes, such as resonances, hardly move; others come into being near the Nyquist frequency.
    grid = jnp.sort(jnp.concatenate([bracketing_grid(loop, _DENSE), found.extremes]))
    u, held, moved = in_two_parts(loop, late, grid)

    def of_part(newer: jax.Array, steps: jax.Array) -> tuple[jax.Array, ...]:
        value = u * (held + jnp.sum(moved * newer[:, None], axis=0))
        square = value.real**2 + value.imag**2
        changes = (square[:-1] > 1.0) != (square[1:] > 1.0)
        cells, present = first_cells(changes, GAIN_SLOTS)
        low, high = grid[cells], grid[cells + 1]
        # 1/|L|, which grows evenly beside a resonance, however narrow that is.
        begin, end = jax.lax.rsqrt(square[cells]), jax.lax.rsqrt(square[cells + 1])
        response = partial(response_with, loop, late, newer, steps)

        def newton(_: int, theta: jax.Array) -> jax.Array:
            value, slope = with_slope(response, theta)
            step = jnp.log(jnp.abs(value)) / nonzero((slope / value).real)
            return jnp.clip(theta - step, low, high)

        theta = low + (high - low) * (1.0 - begin) / nonzero(end - begin)
        theta = jax.lax.fori_loop(0, _REFINEMENTS, newton, theta)
        theta = jnp.append(jnp.where(present, theta, jnp.nan), math.pi)
        there = response(theta)
        left = jnp.arctan2(-there.imag, -there.real)
        rising = jnp.append(jnp.sign(begin - end), 0.0)
        return theta, left, rising, there[-1].real, jnp.sum(changes) > GAIN_SLOTS

    theta, left, rising, height, overflow = jax.vmap(of_part)(newer, jnp.floor(beyond))
    on_pieces = _on_pieces(least, beyond, theta, left, rising)
    chosen = jax.lax.top_k(-on_pieces[1], STARTS)[1]
    at_end = _at_nyquist(least, beyond, height)
    theta, start, low, high = jnp.concatenate([on_pieces[:, chosen], at_end], axis=1)
    theta = jnp.where(jnp.isfinite(start), theta, jnp.nan)
    return theta, start, jnp.stack([low, high]), jnp.any(overflow)


def _on_pieces(
    least: jax.Array, beyond: jax.Array, theta: jax.Array, left: jax.Array, rising: jax.Array
) -> jax.Array:
    """theta [rad] and the delay [periods] of the least whole W on every piece, inf if none, and
    the delays between which it is; shape (4, pieces).

    Args:
        least, beyond: of `parts_beyond`.
        theta, left, rising: crossovers, NaN if fewer, the phase left there and the sign of the
            slope of |L|, 0 of one that goes with both, shape (PARTS + 1, slots) each.
    """
    at = jnp.broadcast_to(beyond[:, None], theta.shape)
    here = jnp.stack([theta, left, at, rising])
    # A whole period later everything is as it was but for the phase.
    last = jnp.stack([theta[0], left[0] - theta[0], at[0] + 1.0, rising[0]])
    there = jnp.concatenate([here[:, 1:], last[:, None]], axis=1)
    number = jnp.sum(~jnp.isnan(theta), axis=1)
    fewer = (number > jnp.roll(number, 1)) | (number > jnp.roll(number, -1))
    bow = jnp.where(fewer[None, :, None], jnp.roll(here, -1, axis=2), jnp.nan)
    low = jnp.stack([here, here, there, here], axis=1)[:, None]
    others = [here, _nearest(here, there), _nearest(there, here), bow]
    high = jnp.stack(others, axis=1)[:, None]
    slack = jnp.asarray([_NEAR, 0.0, 0.0, 0.0], theta.dtype)[None, :, None, None]

    first = jnp.ceil((least * low[0] - low[1]) / _TURN) - 1.0
    turns = first + jnp.arange(_TURNS, dtype=theta.dtype)[:, None, None, None]
    change = jnp.mod(high[1] - low[1] + math.pi, _TURN) - math.pi
    begin = (low[1] + _TURN * turns) / low[0]
    end = (low[1] + change + _TURN * turns) / high[0]
    whole = jnp.ceil(jnp.maximum(jnp.minimum(begin, end) - slack, least))
    whole = jnp.where(whole <= jnp.maximum(begin, end) + slack, whole, jnp.inf)
    along = jnp.clip((whole - begin) / nonzero(end - begin), 0.0, 1.0)
    start = jnp.where(jnp.isfinite(whole), whole + low[2] + along * (high[2] - low[2]), jnp.inf)
    found = low[0] + along * (high[0] - low[0])
    start = jnp.where(found < math.pi, start, jnp.inf)
    turn = jnp.argmin(start, axis=0)[None]
    found, start, whole = (
        jnp.take_along_axis(each, turn, axis=0)[0] for each in (found, start, whole)
    )
    # By itself, or as a bow, one part's crossover stands for what is within a part of it.
    wide = jnp.asarray([_NEAR, 0.0, 0.0, _NEAR], theta.dtype)[:, None, None]
    bounds = (
        whole + jnp.minimum(low[2, 0], high[2, 0]) - wide,
        whole + jnp.maximum(low[2, 0], high[2, 0]) + wide,
    )
    return jnp.stack([found, start, *bounds]).reshape(4, -1)


def _nearest(here: jax.Array, there: jax.Array) -> jax.Array:
    """Of the crossovers of one part those that are nearest to the ones of another, with |L| rising
    or falling as theirs; shape (4, PARTS + 1, slots).
    """
    gap = jnp.abs(here[0, :, :, None] - there[0, :, None, :])
    alike = here[3, :, :, None] * there[3, :, None, :] >= 0.0
    # What is not a number is nowhere near. (XLA takes |x| >= 0 for true even then.)
    chosen = jnp.argmin(jnp.where(alike & ~jnp.isnan(gap), gap, jnp.inf), axis=2)
    return jnp.take_along_axis(there, chosen[None], axis=2)


def _at_nyquist(least: jax.Array, beyond: jax.Array, height: jax.Array) -> jax.Array:
    """As `_on_pieces`, where a root is at -1; shape (4, AT_NYQUIST).

    Args:
        least, beyond: of `parts_beyond`.
        height: L there for these delays but for d0; minus itself a period later.
    """
    height = jnp.append(height, -height[:1])
    low, high = beyond, jnp.append(beyond[1:], beyond[0] + 1.0)
    found = []
    for parity in (0.0, 1.0):
        before, after = (1.0 + (1.0 - 2.0 * parity) * part for part in (height[:-1], height[1:]))
        passes = (before > 0) != (after > 0)
        within = low + (high - low) * before / nonzero(before - after)
        for more in (0.0, 2.0):
            late = least + jnp.mod(least + parity, 2.0) + more
            start = jnp.where(passes, late + within, jnp.inf)
            found.append(jnp.stack([jnp.full_like(start, math.pi), start, late + low, late + high]))
    every = jnp.concatenate(found, axis=1)
    return every[:, jax.lax.top_k(-every[1], AT_NYQUIST)[1]]


def nonzero(value: jax.Array) -> jax.Array:
    """The value, 1 where it is 0."""
    return jnp.where(value == 0, 1.0, value)
