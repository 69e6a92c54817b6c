"""Batches filled up to the sizes that programs are compiled for.

Compiling takes longer than computing: a program for every number of loops would cost more than the
loops that are computed in vain.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np


def filled(tree: Any, size: int) -> Any:
    """Every array of a tree with its last axis filled up to a size, the last entry repeated.

    Args:
        tree: of arrays of NumPy or JAX, shape (..., n) with 0 < n <= size.
        size: of the batch.
    """
    import jax
    import jax.numpy as jnp

    def one(array: Any) -> Any:
        more = [(0, 0)] * (array.ndim - 1) + [(0, size - array.shape[-1])]
        return (np if isinstance(array, np.ndarray) else jnp).pad(array, more, mode="edge")

    return jax.tree.map(one, tree)


def in_chunks(function: Callable, tree: Any, size: int) -> Any:
    """What a function finds of the loops of a batch, chunk by chunk of one size.

    Args:
        function: of a tree like this one with arrays of shape (..., size); gives a tree of them.
        tree: of arrays of shape (..., n), n > 0.
        size: of a chunk.

    Returns:
        A tree of NumPy arrays, shape (..., n).
    """
    import jax

    number = jax.tree.leaves(tree)[0].shape[-1]
    parts = []
    for start in range(0, number, size):
        part = jax.tree.map(lambda array, at=start: array[..., at : at + size], tree)
        parts.append(jax.tree.map(np.asarray, function(filled(part, size))))
    return jax.tree.map(lambda *rows: np.concatenate(rows, axis=-1)[..., :number], *parts)
