"""What a motion does within a segment of a rollout: its extremes, and how often it goes round.

A motion passes its middle where it goes upwards from below to above a band around it,

    middle -+ 0.05 (highest - lowest)   of the segment before,

so that the ripples that counts and noise put on a cycle are not counted with it. Between the first
and the last of n passages it has gone round n - 1 times.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp

from jaxact.loops.loop import Output

_HALF_BAND = 0.05


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Envelope:
    """Accumulators of one segment, each of shape (joints,).

    Attributes:
        lower, upper: the band [m or rad]; infinite in the first segment, where nothing passes it.
        lowest, highest: position [m or rad].
        turns: how often the velocity has become positive, ripples included.
        passages: how often the motion passed the band.
        first, last: tick of a passage; `last` is negative while the motion is below the band or
            has not risen above it since. 0 and 0.5 until there is one.
    """

    lower: jax.Array
    upper: jax.Array
    lowest: jax.Array
    highest: jax.Array
    turns: jax.Array
    passages: jax.Array
    first: jax.Array
    last: jax.Array

    @property
    def amplitude(self) -> jax.Array:
        """Half the range [m or rad]."""
        return 0.5 * (self.highest - self.lowest)

    @property
    def turning(self) -> jax.Array:
        """Whether the motion swings, about whatever middle."""
        return (self.turns >= 2.0) | (self.passages >= 2.0)

    def frequency(self, period: jax.Array) -> jax.Array:
        """Of a motion [rad/s], ticks being a `period` [s] apart; NaN of less than two passages."""
        known = self.passages >= 2.0
        lapse = jnp.where(known, jnp.abs(self.last) - self.first, 1.0) * period
        return jnp.where(known, 2.0 * jnp.pi * (self.passages - 1.0) / lapse, jnp.nan)


def init(like: jax.Array) -> Envelope:
    """Accumulators at the beginning of the first segment, shaped like `like`."""
    zero = jnp.zeros_like(like)
    never = zero + jnp.inf
    return Envelope(-never, never, never, -never, zero, zero, zero, zero + 0.5)


def following(before: Envelope) -> Envelope:
    """Accumulators at the beginning of a segment, from those of the one before."""
    middle = 0.5 * (before.lowest + before.highest)
    half = 2.0 * _HALF_BAND * before.amplitude
    return replace(init(middle), lower=middle - half, upper=middle + half)


def update(envelope: Envelope, outputs: Sequence[Output], ticks: Sequence[jax.Array]) -> Envelope:
    """Take in some control periods of a segment, in order.

    Args:
        envelope: so far.
        outputs: of the loop, at least one; shape (joints,).
        ticks: number of each period's end, counted from 1, as a float.

    Returns:
        The accumulators.
    """
    lowest, highest, passages = envelope.lowest, envelope.highest, envelope.passages
    first, last = envelope.first, envelope.last
    for output, tick in zip(outputs, ticks, strict=True):
        position = output.position
        lowest = jnp.minimum(lowest, position)
        highest = jnp.maximum(highest, position)
        passed = (position > envelope.upper) & (last < 0.0)
        passages = jnp.where(passed, passages + 1.0, passages)
        last = jnp.where(position < envelope.lower, -jnp.abs(last), last)
        last = jnp.where(passed, tick, last)
    # Once for all of them, which is cheaper: a turn back within them is not counted.
    turned = (outputs[0].velocity_before < 0.0) & (outputs[-1].velocity >= 0.0)
    turns = jnp.where(turned, envelope.turns + 1.0, envelope.turns)
    # So is the first passage: the last one of theirs, from which the others are counted.
    passages = jnp.where(first > 0.0, passages, jnp.minimum(passages, 1.0))
    first = jnp.where((first > 0.0) | (passages == 0.0), first, jnp.abs(last))
    return Envelope(envelope.lower, envelope.upper, lowest, highest, turns, passages, first, last)
