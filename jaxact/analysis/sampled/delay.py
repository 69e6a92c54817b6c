"""The smallest added delay that destabilises a sampled loop, exact between control periods too.

A delay of whole periods turns the phase and nothing else. A part of one also changes |L|, as the
held command then reaches the servo within a period, and the gain crossovers move: what the phase
leaves at the loop's own crossovers is exact for whole periods only, and near the Nyquist frequency
off by as much as half. Here L of each of some parts m of a period gives its own crossovers theta
and the delay there, in periods,

    h = m + (arg(-L) mod 2 pi) / theta,

which is right where h - m is whole. From the nearest ones Newton finds L(theta, delay) = -1 in both
unknowns. At z = -1 a single root passes: L is real there, and the delay is the only unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp

from jaxact.analysis.sampled.any_delay import (
    AnyDelay,
    any_delay,
    at_parts,
    hold,
    in_two_parts,
    response_with,
)
from jaxact.analysis.sampled.period_map import SampledLoop, newer_command
from jaxact.analysis.sampled.pulse import PulseTransfer, pulse_transfer
from jaxact.analysis.sampled.search import (
    GAIN_SLOTS,
    Found,
    bracketing_grid,
    first_cells,
    response_at,
    with_slope,
)

_TURN = 2.0 * math.pi
# Parts of a period at which crossovers are looked for, and how far off in those a start may be.
_PARTS, _OFF = 16, 6.0
# Starts that are followed, of those that mean the shortest delays.
_STARTS, _AT_NYQUIST = 22, 2
_REFINEMENTS, _STEPS = 2, 8
# How dense the grid of crossovers is, as for delays of so many periods.
_DENSE = 18
# Of the loop's own crossovers, which are as good as right.
_NEAR, _FEW = 2, 4
# Crossovers up to here [rad] stay where they are but for a little; nor do others come into being
# where extremes of |L| are no closer to 1.
_FAR, _CLOSE = 0.5, 0.2


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DelayLimit:
    """Where a loop first loses its stability as its delay grows; constant.

    Attributes:
        theta: [rad].
        delay: the whole delay there [periods], inf if there is none.
        by_theta, by_delay: derivatives of ln(-L) there, by the delay in periods.
        overflow: bool, there were more crossovers than slots.
    """

    theta: jax.Array
    delay: jax.Array
    by_theta: jax.Array
    by_delay: jax.Array
    overflow: jax.Array


def delay_limits(loops: SampledLoop, transfers: PulseTransfer, found: Found) -> DelayLimit:
    """How long the delays of stable loops may become.

    Where all crossovers of all loops are far below the Nyquist frequency, what the phase leaves at
    their own ones is next to the delay, and others are not looked for.

    Args:
        loops, transfers, found: constant, of a batch, shape (n, ...) each.
    """
    parts = jnp.arange(_PARTS, dtype=loops.delay.dtype) / _PARTS
    phi, newer = jax.vmap(at_parts, in_axes=(0, None))(loops, parts)
    late = jax.vmap(any_delay)(transfers, phi, newer[:, 0])
    demanding = jnp.any(jax.vmap(_is_demanding)(loops, transfers, found))
    theta, start, overflow = jax.lax.cond(
        demanding, jax.vmap(_starts), jax.vmap(_near_starts), loops, late, newer, found
    )
    number, steps = (
        jnp.where(demanding, a, b) for a, b in ((_STARTS + _AT_NYQUIST, _NEAR), (_STEPS, _FEW))
    )
    own = loops.delay / loops.control_period
    none, one = jnp.zeros_like(own), jnp.ones_like(own)
    # Where nothing is found these are harmless: what is not used has a derivative, too.
    slopes = jax.lax.complex(one, none), jax.lax.complex(one, one)

    def tried(at: jax.Array, best: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        arrived = _solved(loops, late, theta[:, at], start[:, at], steps)
        later = jnp.where(arrived[1] > own, arrived[1], jnp.inf)
        sooner = later < best[1]
        return tuple(
            jnp.where(sooner, new, old)
            for new, old in zip((arrived[0], later, *arrived[2:]), best, strict=True)
        )

    first = none, jnp.full_like(own, jnp.inf), *slopes
    return DelayLimit(*jax.lax.fori_loop(0, number, tried, first), overflow)


def _is_demanding(loop: SampledLoop, transfer: PulseTransfer, found: Found) -> jax.Array:
    """Whether a part of a period may matter to which crossovers there are."""
    at = jnp.append(found.extremes, math.pi)
    size = jnp.abs(response_at(loop, transfer, at))
    # A part of a period changes |L| by a share that falls as the square of the frequency.
    close = jnp.any(jnp.abs(jnp.log(size)) < _CLOSE * at**2) | (size[-1] > 1.0)
    return close | jnp.any(found.gain_present & (found.gain > _FAR))


def _near_starts(
    loop: SampledLoop, late: AnyDelay, _: jax.Array, found: Found
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """As `_starts`, from the loop's own crossovers, those that leave the least first."""
    value = response_at(loop, late.transfer, found.gain)
    left = jnp.mod(jnp.arctan2(-value.imag, -value.real), _TURN) / found.gain
    left = jnp.where(found.gain_present, left, jnp.inf)
    order, more = jnp.argsort(left), _STARTS + _AT_NYQUIST - GAIN_SLOTS
    theta = jnp.where(found.gain_present, found.gain, jnp.nan)[order]
    start = loop.delay / loop.control_period + left[order]
    theta = jnp.pad(theta, (0, more), constant_values=jnp.nan)
    return theta, jnp.pad(start, (0, more), constant_values=jnp.inf), jnp.zeros((), bool)


@jax.custom_jvp
def added_delay(loop: SampledLoop, limit: DelayLimit) -> jax.Array:
    """The delay that is left [s], with the derivative of the implicit function.

    Args:
        loop: live, fields scalar.
        limit: of it.
    """
    return jnp.where(
        jnp.isfinite(limit.delay), limit.delay * loop.control_period - loop.delay, jnp.inf
    )


@added_delay.defjvp
def _added_delay_jvp(
    primals: tuple[SampledLoop, DelayLimit], tangents: tuple[SampledLoop, DelayLimit]
) -> tuple[jax.Array, jax.Array]:
    loop, limit = primals
    found = jnp.isfinite(limit.delay)
    theta = jnp.where(found, limit.theta, 1.0)
    whole = jax.lax.stop_gradient(jnp.where(found, limit.delay, 1.0) * loop.control_period)

    def moved(loop: SampledLoop) -> jax.Array:
        late = replace(loop, delay=whole)
        residual = jnp.log(-response_at(late, pulse_transfer(late), theta))
        between = (residual / limit.by_theta).imag / (limit.by_delay / limit.by_theta).imag
        step = jnp.where(theta < math.pi, between, residual.real / limit.by_delay.real)
        return whole - step * jax.lax.stop_gradient(loop.control_period) - loop.delay

    _, tangent = jax.jvp(moved, (loop,), (tangents[0],))
    return added_delay(loop, limit), jnp.where(found, tangent, 0.0)


def _starts(
    loop: SampledLoop, late: AnyDelay, newer: jax.Array, found: Found
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Where Newton begins, from the crossovers at parts of a period.

    Args:
        loop, late, found: of one loop.
        newer: Gamma_new after each of the parts, shape (parts, 4).

    Returns:
        theta [rad], NaN where there are fewer, and pi of a root at -1; the delay [periods], shape
        (starts,) each; and whether a part had more crossovers than slots.
    """
    own = loop.delay / loop.control_period
    # Extremes, such as resonances, hardly move; others come into being near the Nyquist frequency.
    grid = jnp.sort(jnp.concatenate([bracketing_grid(loop, _DENSE), found.extremes]))
    parts = jnp.arange(_PARTS, dtype=own.dtype) / _PARTS
    u, held, moved = in_two_parts(loop, late, grid)

    def of_part(newer: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
        value = u * (held + jnp.sum(moved * newer[:, None], axis=0))
        square = value.real**2 + value.imag**2
        changes = (square[:-1] > 1.0) != (square[1:] > 1.0)
        cells, present = first_cells(changes, GAIN_SLOTS)
        low, high = grid[cells], grid[cells + 1]
        begin, end = jnp.log(square[cells]), jnp.log(square[cells + 1])
        response = partial(response_with, loop, late, newer, 0.0)

        def newton(_: int, theta: jax.Array) -> jax.Array:
            value, slope = with_slope(response, theta)
            step = jnp.log(jnp.abs(value)) / _nonzero((slope / value).real)
            return jnp.clip(theta - step, low, high)

        theta = low + (high - low) * begin / _nonzero(begin - end)
        theta = jax.lax.fori_loop(0, _REFINEMENTS, newton, theta)
        there = response(theta)
        angle = jnp.arctan2(-there.imag, -there.real)
        overflow = jnp.sum(changes) > GAIN_SLOTS
        return jnp.where(present, theta, jnp.nan), angle, value[-1].real, overflow

    theta, angle, end, overflow = jax.vmap(of_part)(newer)
    turns = _TURN / theta
    # The first turn that may still mean a longer delay than the loop has, and the one after it.
    first = angle / theta
    first = first + turns * jnp.ceil((own - 1.0 - parts[:, None] - first) / turns)
    whole = jnp.stack([first, first + turns])
    near = jnp.abs(whole - jnp.round(whole)) * _PARTS <= _OFF
    start = jnp.round(whole) + parts[None, :, None]
    near &= (start >= own - _OFF / _PARTS) & (start >= 0.0)
    best, chosen = jax.lax.top_k(-jnp.where(near, start, jnp.inf).reshape(-1), _STARTS)
    theta = jnp.broadcast_to(theta, whole.shape).reshape(-1)[chosen]
    at_end = _at_nyquist(own, parts, end)
    start = jnp.concatenate([-best, at_end])
    theta = jnp.concatenate([theta, jnp.full_like(at_end, math.pi)])
    return jnp.where(jnp.isfinite(start), theta, jnp.nan), start, jnp.any(overflow)


def _at_nyquist(own: jax.Array, parts: jax.Array, height: jax.Array) -> jax.Array:
    """Delays [periods] near which a root is at -1, shape (2,); inf where there are none.

    Args:
        own: delay of the loop [periods].
        parts, height: parts of a period, and L there for these delays; minus itself a period later.
    """
    height = jnp.append(height, -height[:1])
    least = jnp.floor(own)
    starts = []
    for parity in (0.0, 1.0):
        before, after = (1.0 + (1.0 - 2.0 * parity) * part for part in (height[:-1], height[1:]))
        passes = (before > 0) != (after > 0)
        within = parts + before / _nonzero(before - after) / _PARTS
        for more in (0.0, 2.0):
            late = least + jnp.mod(least + parity, 2.0) + more + within
            starts.append(jnp.where(passes & (late > own - 1.0 / _PARTS), late, jnp.inf))
    return -jax.lax.top_k(-jnp.concatenate(starts), _AT_NYQUIST)[0]


def _solved(
    loops: SampledLoop, late: AnyDelay, theta: jax.Array, delay: jax.Array, steps: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Newton in both unknowns from a start of every loop, in the delay alone where theta is pi.

    Returns:
        theta, the delay [periods], inf where it does not arrive, and the derivatives of ln(-L),
        shape (n,) each.
    """
    end = jnp.asarray(math.pi, theta.dtype)
    wanted, fixed = jnp.isfinite(theta), theta == end

    @jax.vmap
    def residual(
        loop: SampledLoop, late: AnyDelay, theta: jax.Array, delay: jax.Array
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        steps, period = jnp.floor(delay), loop.control_period
        _, newer, slope = newer_command(loop, (delay - steps) * period)

        def parts(theta: jax.Array) -> tuple[jax.Array, jax.Array]:
            _, held, moved = in_two_parts(loop, late, theta)
            late_by = hold(theta, steps)
            value = late_by * (held + jnp.sum(moved * newer[:, None], axis=0))
            return value, late_by * jnp.sum(moved * slope[:, None], axis=0) * period

        at = theta[None]
        value, by_theta, by_delay = jax.jvp(parts, (at,), (jnp.ones_like(at),), has_aux=True)
        return jnp.log(-value)[0], (by_theta / value)[0], (by_delay / value)[0]

    def step(_: jax.Array, at: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        theta, delay = at[-2:]
        value, by_theta, by_delay = residual(loops, late, theta, delay)
        area = _nonzero(by_theta.real * by_delay.imag - by_theta.imag * by_delay.real)
        turn = (value.imag * by_delay.real - value.real * by_delay.imag) / area
        wait = (value.real * by_theta.imag - value.imag * by_theta.real) / area
        turn = jnp.where(fixed, 0.0, jnp.clip(turn, -0.1 * theta, 0.1 * theta))
        wait = jnp.where(fixed, -value.real / _nonzero(by_delay.real), wait)
        later = jnp.maximum(delay + jnp.clip(wait, -0.2, 0.2), 0.0)
        left = jnp.where(fixed, jnp.abs(value.real), jnp.abs(value))
        return left, theta, delay, by_theta, by_delay, jnp.minimum(theta + turn, end), later

    begin = jnp.where(wanted, theta, 1.0), jnp.where(wanted, delay, 1.0)
    slope = jax.lax.complex(*begin)
    state = (jnp.full_like(begin[0], jnp.inf), *begin, slope, slope, *begin)
    left, theta, delay, by_theta, by_delay = jax.lax.fori_loop(0, steps, step, state)[:5]
    arrived = wanted & (left < jnp.sqrt(jnp.finfo(theta.dtype).eps)) & (fixed | (theta < end))
    return theta, jnp.where(arrived, delay, jnp.inf), by_theta, by_delay


def _nonzero(value: jax.Array) -> jax.Array:
    return jnp.where(value == 0, 1.0, value)
