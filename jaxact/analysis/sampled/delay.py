"""The smallest added delay that destabilises a sampled loop, exact between control periods too.

A delay of whole periods turns the phase and nothing else. A part of one also changes |L|, as the
held command then reaches the servo within a period, and the gain crossovers move: what the phase
leaves at the loop's own crossovers is exact for whole periods only, and near the Nyquist frequency
off by as much as half. From starts that take this into account (`delay_starts`) Newton finds
L(theta, delay) = -1 in both unknowns. At z = -1 a single root passes: L is real there, and the
delay is the only unknown. The least delay that is found is the limit, and there the root has to
leave the unit circle: one that comes back has left before, so that the limit is not known. Nor is
it where none is found of a loop with a gain crossover: some delay destabilises that.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from jaxact.analysis.sampled.any_delay import AnyDelay, any_delay, at_parts, hold, in_two_parts
from jaxact.analysis.sampled.delay_starts import (
    AT_NYQUIST,
    STARTS,
    is_demanding,
    near_starts,
    nonzero,
    parts_beyond,
    starts,
)
from jaxact.analysis.sampled.period_map import SampledLoop, newer_command
from jaxact.analysis.sampled.pulse import PulseTransfer, pulse_transfer
from jaxact.analysis.sampled.search import Found, response_at

_STEPS = 8
# Of the loop's own crossovers, which are as good as right.
_NEAR, _FEW = 2, 4


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class DelayLimit:
    """Where a loop first loses its stability as its delay grows; constant.

    Attributes:
        theta: [rad].
        delay: the whole delay there [periods]; inf if there is none, NaN if it is not known.
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
    parts = jnp.pad(jax.vmap(parts_beyond)(loops)[2], ((0, 0), (1, 0)))
    phi, newer = jax.vmap(at_parts)(loops, parts)
    late = jax.vmap(any_delay)(transfers, phi, newer[:, 0])
    newer = newer[:, 1:]
    demands, left = jax.vmap(is_demanding)(loops, late, newer, found)
    demanding = jnp.any(demands)
    theta, start, bounds, overflow = jax.lax.cond(
        demanding, jax.vmap(starts), jax.vmap(near_starts), loops, late, newer, found, left
    )
    number, steps = (
        jnp.where(demanding, a, b) for a, b in ((STARTS + AT_NYQUIST, _NEAR), (_STEPS, _FEW))
    )
    own = loops.delay / loops.control_period
    none, one = jnp.zeros_like(own), jnp.ones_like(own)
    # Where nothing is found these are harmless: what is not used has a derivative, too.
    slopes = jax.lax.complex(one, none), jax.lax.complex(one, one)

    def tried(at: jax.Array, best: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        arrived = _solved(loops, late, theta[:, at], start[:, at], bounds[:, :, at], steps)
        later = jnp.where(arrived[1] > own, arrived[1], jnp.inf)
        sooner = later < best[1]
        return tuple(
            jnp.where(sooner, new, old)
            for new, old in zip((arrived[0], later, *arrived[2:]), best, strict=True)
        )

    first = none, jnp.full_like(own, jnp.inf), *slopes
    limit = DelayLimit(*jax.lax.fori_loop(0, number, tried, first), overflow)
    # |z| = exp(-Im theta), and theta moves by -by_delay / by_theta.
    returns = jnp.isfinite(limit.delay) & ((limit.by_delay / limit.by_theta).imag < 0.0)
    # Where |L| exceeds 1 somewhere some delay turns it to -1.
    missed = jnp.isposinf(limit.delay) & jnp.any(found.gain_present, axis=1)
    return replace(limit, delay=jnp.where(returns | missed, jnp.nan, limit.delay))


@jax.custom_jvp
def added_delay(loop: SampledLoop, limit: DelayLimit) -> jax.Array:
    """The delay that is left [s], NaN if not known; with the derivative of the implicit function.

    Args:
        loop: live, fields scalar.
        limit: of it.
    """
    left = limit.delay * loop.control_period - loop.delay
    return jnp.where(jnp.isposinf(limit.delay), jnp.inf, left)


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


def _solved(
    loops: SampledLoop,
    late: AnyDelay,
    theta: jax.Array,
    delay: jax.Array,
    bounds: jax.Array,
    steps: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Newton in both unknowns from a start of every loop, in the delay alone where theta is pi.

    The delay stays between its bounds, shape (n, 2), and on the inner side of a kink that they are.

    Returns:
        theta, the delay [periods], inf where it does not arrive, and the derivatives of ln(-L),
        shape (n,) each.
    """
    end = jnp.asarray(math.pi, theta.dtype)
    tiny = 4.0 * jnp.finfo(theta.dtype).eps
    low, high = jnp.maximum(bounds[:, 0], 0.0), bounds[:, 1] * (1.0 - tiny)
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
        area = nonzero(by_theta.real * by_delay.imag - by_theta.imag * by_delay.real)
        turn = (value.imag * by_delay.real - value.real * by_delay.imag) / area
        wait = (value.real * by_theta.imag - value.imag * by_theta.real) / area
        turn = jnp.where(fixed, 0.0, jnp.clip(turn, -0.1 * theta, 0.1 * theta))
        wait = jnp.where(fixed, -value.real / nonzero(by_delay.real), wait)
        later = jnp.clip(delay + wait, low, high)
        left = jnp.where(fixed, jnp.abs(value.real), jnp.abs(value))
        return left, theta, delay, by_theta, by_delay, jnp.minimum(theta + turn, end), later

    begin = jnp.where(wanted, theta, 1.0), jnp.where(wanted, delay, 1.0)
    slope = jax.lax.complex(*begin)
    state = (jnp.full_like(begin[0], jnp.inf), *begin, slope, slope, *begin)
    left, theta, delay, by_theta, by_delay = jax.lax.fori_loop(0, steps, step, state)[:5]
    arrived = wanted & (left < jnp.sqrt(jnp.finfo(theta.dtype).eps)) & (fixed | (theta < end))
    return theta, jnp.where(arrived, delay, jnp.inf), by_theta, by_delay
