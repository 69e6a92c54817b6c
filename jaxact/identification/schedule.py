"""When a held, delayed signal switches between rows whose times are as they were written down.

The rows are at t_0 < t_1 < ..., a value u_k is held from t_k on, and reaches the force loop a delay
later, at t_k + delay. Merged and sorted, rows and switches are instants between which the input is
constant, so that a closed form holds over each interval: exact for any delay and any jitter,
continuous in the delay, and differentiable but where a switch passes a row.
"""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Schedule:
    """Rows and switches in order of time; the interval i lies between the instants i and i + 1.

    Attributes:
        length: of each interval [s], shape (2 rows,); the last one 0.
        held: number of the row whose value acts during the interval, -1 before the first one
            has arrived, shape (2 rows,).
        row: where each row stands among the instants, shape (rows,).
        is_row: whether the instant at which an interval begins is a row, shape (2 rows,).
    """

    length: jax.Array
    held: jax.Array
    row: jax.Array
    is_row: jax.Array


def schedule(time: jax.Array, delay: jax.Array) -> Schedule:
    """Rows and switches in order of time.

    Args:
        time: of the rows [s], shape (rows,), rising.
        delay: [s], at least 0; may be traced.
    """
    switches = time + delay
    number = jnp.arange(time.shape[0])
    # Both are sorted: where each stands among all is its own number and how many others precede it.
    row = number + jnp.searchsorted(switches, time, side="left")
    switch = number + jnp.searchsorted(time, switches, side="right")
    empty = jnp.zeros(2 * time.shape[0], time.dtype)
    instants = empty.at[row].set(time).at[switch].set(switches)
    is_row = jnp.zeros(empty.shape, bool).at[row].set(True)
    length = jnp.append(jnp.diff(instants), 0.0)
    held = jnp.cumsum(~is_row) - 1
    return Schedule(length=length, held=held, row=row, is_row=is_row)
