"""A scan over time that ends early, once no loop of a batch has metrics left to find.

Looking whether to stop takes time too, so that many control periods are computed in between.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

# Iterations of the compiled loop between two looks at whether to stop, at least.
_STRETCH = 16


def together(length: int, most: int) -> int:
    """Largest number of ticks, not above `most`, that divides a segment of this length."""
    return next(count for count in range(most, 0, -1) if length % count == 0)


def stretch(length: int, together: int) -> int:
    """Ticks after which a rollout looks whether to stop: enough that looking costs nothing.

    Args:
        length: of a segment, in ticks.
        together: ticks in one iteration of the compiled loop.
    """
    iterations = length // together
    fewest = min(iterations, _STRETCH)
    return together * next(n for n in range(fewest, iterations + 1) if iterations % n == 0)


def parted(rows: Any, count: int) -> Any:
    """The first axis of every leaf cut into so many equal parts."""
    return jax.tree.map(lambda row: row.reshape((count, -1, *row.shape[1:])), rows)


@jax.custom_batching.custom_vmap
def _anywhere(flags: jax.Array) -> jax.Array:
    """Whether a flag is set in any loop of a batch: the same for all of them, shape ()."""
    return jnp.any(flags)


@_anywhere.def_vmap
def _anywhere_in_batch(size: int, batched: list[bool], flags: jax.Array) -> tuple[jax.Array, bool]:
    del size, batched
    return _anywhere(jnp.any(flags, axis=0)), False


def until_lost(over: Callable, carry: Any, inputs: Any) -> tuple[Any, None]:
    """As `jax.lax.scan` of a stretch, which ends once no loop of the batch has metrics to find.

    A sum that is not finite never is again, and none of the metrics that follow from it.

    Args:
        over: a stretch, (carry, inputs) -> (carry, None).
        carry: (state, `jaxact.simulation.metrics.Running`, anything).
        inputs: of all stretches, leaves of shape (stretches, ...).
    """
    count = jax.tree.leaves(inputs)[0].shape[0]

    def going(at):
        place, (_, running, _) = at
        return (place < count) & _anywhere(jnp.isfinite(running.squared_error))

    def go(at):
        place, carry = at
        carry, _ = over(carry, jax.tree.map(lambda rows: rows[place], inputs))
        return place + 1, carry

    return jax.lax.while_loop(going, go, (jnp.int32(0), carry))[1], None


def until_over(over: Callable, carry: Any, ticks: jax.Array, together: int) -> Any:
    """The carry once each loop of the batch has made its own ticks, or is lost.

    Args:
        over: some ticks, (carry, number of the first) -> (carry, None).
        carry: as for `until_lost`.
        ticks: of this loop, shape ().
        together: static; ticks that `over` makes.
    """
    span = together * _STRETCH

    def going(at):
        first, (_, running, _) = at
        return _anywhere((first < ticks) & jnp.isfinite(running.squared_error))

    def go(at):
        first, carry = at
        firsts = first + together * jnp.arange(_STRETCH, dtype=jnp.int32)
        return first + span, jax.lax.scan(over, carry, firsts)[0]

    return jax.lax.while_loop(going, go, (jnp.int32(0), carry))[1]
