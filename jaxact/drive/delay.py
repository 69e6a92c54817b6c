"""Delay lines: a signal pushed once per control period, read any real time later.

A held signal changes only at ticks, so a delay of ``d`` whole periods plus a remainder ``r`` is
exact: the older value until ``r`` into the period, the newer one after it. The line therefore
stores one value per tick; who reads it splits the period (see `jaxact.drive.actuator.response`).
A sampled signal that is not held is read between its samples by linear interpolation.

Short lines are tuples, so that a shift is a renaming and an unrolled loop keeps the values in
registers; long ones are ring buffers, so that a push writes one value whatever the length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

# Reading a tuple touches every slot; beyond this many, indexing a ring buffer is cheaper.
_LONGEST_TUPLE = 16

# A delay within this many roundings below a whole number of periods is that number: the quotient of
# two rounded decimals such as 0.003 / 0.001 must not lose a period.
_SNAP = 64


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Ring:
    """A long delay line: `values` has shape (length, ...), `newest` is the index of the last."""

    values: jax.Array
    newest: jax.Array


Line = tuple[Any, ...] | Ring


def slots(delay: Any, period: Any) -> int:
    """Number of slots, a static length, that a line needs for the largest of these delays.

    Args:
        delay: the delays [s], concrete, any shape.
        period: the control periods [s], broadcastable against `delay`.

    Returns:
        One slot for each whole period and one for the newest value.
    """
    ratio = np.max(np.asarray(delay, float) / np.asarray(period, float))
    # The simulation may run in single precision, where more delays count as the next whole number.
    snap = 2 * _SNAP * float(np.finfo(np.float32).eps) * (1.0 + ratio)
    return int(np.floor(ratio + snap)) + 1


def split(delay: jax.Array, period: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Split a delay into whole periods and the remainder: ``delay = d * period + r``.

    The remainder carries the whole derivative with respect to the delay; at a multiple of the
    period ``r = 0``, so that the derivative there is the one towards longer delays.

    Args:
        delay: [s], any shape.
        period: [s], broadcastable.

    Returns:
        ``d`` (as a float, whole) and ``r`` [s] with ``0 <= r < period`` up to rounding.
    """
    ratio = delay / period
    snap = _SNAP * jnp.finfo(ratio.dtype).eps * (1.0 + ratio)
    whole = jax.lax.stop_gradient(jnp.floor(ratio + snap))
    remainder = delay - whole * period
    # Rounding may leave a remainder of a few units in the last place; a plain clip would cut the
    # derivative off exactly where it is wanted, so only the value is clipped.
    return whole, remainder + jax.lax.stop_gradient(jnp.maximum(remainder, 0.0) - remainder)


def weights(whole: jax.Array, length: int) -> tuple[jax.Array, ...] | jax.Array:
    """What `read` needs to find the value `whole` periods old in a line of `length` slots.

    Args:
        whole: whole number of periods, as a float, any shape.
        length: number of slots of the line.

    Returns:
        For a short line one selector (0 or 1) for each slot; for a long one the index itself.
    """
    if length > _LONGEST_TUPLE:
        return whole.astype(jnp.int32)
    return tuple((whole == slot).astype(whole.dtype) for slot in range(length))


def init(value: jax.Array, length: int) -> Line:
    """A line of `length` slots that has held `value` for ever."""
    if length > _LONGEST_TUPLE:
        values = jnp.broadcast_to(value, (length, *jnp.shape(value)))
        return Ring(values=values, newest=jnp.zeros((), jnp.int32))
    return (value,) * length


def begun(values: jax.Array) -> Line:
    """A line whose slots hold these values, the newest first; shape (length, ...)."""
    if len(values) > _LONGEST_TUPLE:
        return Ring(values=values, newest=jnp.zeros((), jnp.int32))
    return tuple(values)


def push(line: Line, value: jax.Array) -> Line:
    """The line after one more tick: `value` is the newest, the oldest is dropped."""
    if isinstance(line, Ring):
        length = line.values.shape[0]
        newest = jnp.where(line.newest == 0, length - 1, line.newest - 1)
        values = jax.lax.dynamic_update_index_in_dim(line.values, value, newest, 0)
        return Ring(values=values, newest=newest)
    return (value, *line[:-1])


def forget(line: Line, where: tuple[jax.Array, ...] | jax.Array, *, pushed: bool) -> Line:
    """The line with zeros for the values that are too old to be read any more.

    Args:
        line: the delay line; a ring buffer with its newest value first.
        where: what `weights` returned for the same length.
        pushed: static; whether another value is pushed before the next reading.
    """
    if isinstance(line, Ring):
        ages = jnp.arange(line.values.shape[0]).reshape((-1,) + (1,) * (line.values.ndim - 1))
        oldest = jnp.broadcast_to(where, line.values.shape[1:])[None] - int(pushed)
        return Ring(values=jnp.where(ages <= oldest, line.values, 0.0), newest=line.newest)
    kept = []
    for age, value in enumerate(line):
        later = where[age + 1 :] if pushed else where[age:]
        kept.append(sum(later, start=jnp.zeros_like(value)) * value)
    return tuple(kept)


def read(line: Line, where: tuple[jax.Array, ...] | jax.Array) -> jax.Array:
    """The value that was pushed the selected number of ticks before the newest one.

    Args:
        line: the delay line, values of shape (joints,).
        where: what `weights` returned for the same length.

    Returns:
        shape (joints,).
    """
    if isinstance(line, Ring):
        length = line.values.shape[0]
        index = jnp.mod(line.newest + where, length)
        index = jnp.broadcast_to(index, line.values.shape[1:])
        return jnp.take_along_axis(line.values, index[None], axis=0)[0]
    if len(line) == 1:
        return line[0]
    total = where[0] * line[0]
    for selector, value in zip(where[1:], line[1:], strict=True):
        total = total + selector * value
    return total
