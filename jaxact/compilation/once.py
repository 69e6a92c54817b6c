"""Values that a compiled program computes once.

XLA computes what several operations read anew in each of them, and its text and code with it: that
is meant to save memory, and is worth it where little is computed.
"""

from __future__ import annotations

from typing import TypeVar

import jax
import jax.numpy as jnp

Values = TypeVar("Values")


def once(values: Values) -> Values:
    """The same arrays, each of which is computed by itself and kept."""
    return jax.lax.optimization_barrier(values)


def together(*values: jax.Array) -> tuple[jax.Array, ...]:
    """The same arrays of one shape, computed in one operation, with what they share, and kept."""
    return tuple(once(jnp.stack(values)))
