"""A tree of many small arrays as one array, for calls that are made very often.

What a call of a compiled function costs, beside its work, is proportional to the number of arrays
that go in and out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp


@dataclass(frozen=True)
class Layout:
    """How a tree lies in its array: static.

    Attributes:
        structure: of the tree.
        shapes: of its leaves; None for one that is kept apart, being no real number.
    """

    structure: Any
    shapes: tuple[tuple[int, ...] | None, ...]


@dataclass(frozen=True)
class Packed:
    """A tree whose real leaves are one array.

    Attributes:
        numbers: shape (..., n), one after another; leading axes are those of batches.
        others: the leaves that are not real numbers.
        layout: static.
    """

    numbers: jax.Array
    others: tuple[jax.Array, ...]
    layout: Layout


jax.tree_util.register_dataclass(Packed, data_fields=["numbers", "others"], meta_fields=["layout"])


def pack(tree: Any) -> Packed:
    """The tree with its real leaves, all of JAX's usual precision, in one array."""
    dtype = jnp.result_type(float)
    leaves, structure = jax.tree.flatten(tree)
    real = [jnp.result_type(leaf) == dtype for leaf in leaves]
    pairs = list(zip(leaves, real, strict=True))
    shapes = tuple(jnp.shape(leaf) if inside else None for leaf, inside in pairs)
    numbers = [jnp.ravel(leaf) for leaf, inside in pairs if inside]
    return Packed(
        numbers=jnp.concatenate(numbers) if numbers else jnp.zeros(0, dtype),
        others=tuple(leaf for leaf, inside in pairs if not inside),
        layout=Layout(structure, shapes),
    )


def unpack(packed: Packed) -> Any:
    """The tree that `pack` was given, with the leading axes of batches; views of NumPy's arrays."""
    numbers, others = packed.numbers, iter(packed.others)
    leaves, first = [], 0
    for shape in packed.layout.shapes:
        if shape is None:
            leaves.append(next(others))
            continue
        size = math.prod(shape)
        leaves.append(numbers[..., first : first + size].reshape((*numbers.shape[:-1], *shape)))
        first += size
    return jax.tree.unflatten(packed.layout.structure, leaves)
