"""A rollout of loops that are computed together, each over a number of control periods of its own.

Loops of different control rates make different numbers of ticks in the same time. All go on until
the longest of a batch is over; what a loop did is what it had done at its own end.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.drive.controller import Setpoint
from jaxact.loops.loop import LoopState
from jaxact.simulation import envelope as _envelope
from jaxact.simulation import metrics as _metrics
from jaxact.simulation import stopping
from jaxact.simulation.envelope import Envelope
from jaxact.simulation.metrics import SEGMENTS, Period, Running

Tick = Callable[[LoopState, tuple[jax.Array, Setpoint | None]], tuple[LoopState, Period]]
"""From the state, a tick's number and its setpoint, None being the constant one, to the state after
it and the period."""
Ranges = tuple[jax.Array, jax.Array]


def run(
    tick: Tick, state: LoopState, start: jax.Array, ticks: jax.Array, unroll: int
) -> tuple[LoopState, Running, Envelope]:
    """Simulate a loop until its own end.

    Args:
        tick: of the loop.
        state: at the beginning.
        start: positions then, shape (joints,).
        ticks: of this loop, a multiple of `jaxact.simulation.metrics.SEGMENTS`, shape ().
        unroll: static; ticks in one iteration of the compiled loop.

    Returns:
        As `jaxact.simulation.rollout.run`; of the state, the plant's is that of the end.
    """
    length = ticks // SEGMENTS

    def one(carry: Any, number: jax.Array) -> Any:
        (state, plant), running, (envelope, ranges) = carry
        state, period = tick(state, (number, None))
        going = number < ticks
        after = _metrics.update(running, envelope, [period])
        running, envelope = _where(going, after, (running, envelope))
        plant = _where(going, state.plant, plant)
        ended = (number + 1) % length == 0
        place = (number + 1) // length - 1
        ranges = _kept(ranges, envelope, ended & going, place)
        # The last one stays as it is.
        onward = ended & (place < SEGMENTS - 1)
        envelope = _where(onward, _envelope.following(envelope), envelope)
        return (state, plant), running, (envelope, ranges)

    def several(carry: Any, first: jax.Array) -> tuple[Any, None]:
        for place in range(unroll):
            carry = one(carry, first + place)
        return carry, None

    running, envelope = _metrics.init(start), _envelope.init(start)
    none = jnp.full((SEGMENTS - 1, *start.shape), jnp.inf, start.dtype)
    carry = (state, state.plant), running, (envelope, (none, -none))
    (state, plant), running, (last, ranges) = stopping.until_over(several, carry, ticks, unroll)
    return replace(state, plant=plant), running, _stacked(last, ranges)


def _where(when: jax.Array, new: Any, old: Any) -> Any:
    return jax.tree.map(lambda new, old: jnp.where(when, new, old), new, old)


def _kept(ranges: Ranges, envelope: Envelope, when: jax.Array, place: jax.Array) -> Ranges:
    """The extremes of all segments but the last, with those of the one that ends `when`."""
    shape = (SEGMENTS - 1, *(1,) * envelope.lowest.ndim)
    here = (jnp.arange(SEGMENTS - 1).reshape(shape) == place) & when
    lowest, highest = ranges
    return (
        jnp.where(here, envelope.lowest[None], lowest),
        jnp.where(here, envelope.highest[None], highest),
    )


def _stacked(last: Envelope, ranges: Ranges) -> Envelope:
    """Envelopes of all segments; only of the last one more than the extremes is known."""
    lowest, highest = ranges
    every = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (SEGMENTS, *leaf.shape)), last)
    return replace(
        every,
        lowest=jnp.concatenate([lowest, last.lowest[None]]),
        highest=jnp.concatenate([highest, last.highest[None]]),
    )
