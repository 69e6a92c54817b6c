"""Functions that are computed for many robots side by side, with the robots along the last axis.

`jax.vmap` puts the robots along the first axis. A processor's vector units then work on the three
or six numbers of a position or a velocity, and a library is called for each small matrix. With the
robots along the last axis every operation is the same for a whole vector of them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap

Leaves = list[jax.Array]


def lanes(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function of one robot that `function` is of many.

    Derivatives can be taken in forward direction only.

    Args:
        function: of trees of arrays, each with one axis more, the last one, for the robots; so are
            its results.
    """

    @functools.wraps(function)
    def run(*inputs: Any) -> Any:
        leaves, structure = jax.tree.flatten(inputs)
        out: dict[str, Any] = {}

        def of_leaves(*leaves: jax.Array) -> Leaves:
            # Vectors of robots meet matrices of them; a user may have forbidden that.
            with jax.numpy_rank_promotion("allow"):
                found, out["structure"] = jax.tree.flatten(
                    function(*jax.tree.unflatten(structure, leaves))
                )
            return found

        found = _of_one(_of_many(of_leaves))(*map(jnp.asarray, leaves))
        return jax.tree.unflatten(out["structure"], found)

    return run


def _of_one(function: Callable[..., Leaves]) -> Callable[..., Leaves]:
    """The function of one robot; `jax.vmap` calls that of many."""

    @custom_vmap
    def run(*leaves: jax.Array) -> Leaves:
        return [each[..., 0] for each in function(*(leaf[..., None] for leaf in leaves))]

    @run.def_vmap
    def batched(size: int, moved: Sequence[bool], *leaves: jax.Array) -> Any:
        # What arrays are made of, XLA would otherwise compute anew wherever they are turned.
        leaves = jax.lax.optimization_barrier(leaves)
        last = [
            jnp.moveaxis(leaf, 0, -1)
            if has
            else jnp.broadcast_to(leaf[..., None], leaf.shape + (size,))
            for leaf, has in zip(leaves, moved, strict=True)
        ]
        found = [jnp.moveaxis(each, -1, 0) for each in function(*last)]
        return found, [True] * len(found)

    return run


def _of_many(function: Callable[..., Leaves]) -> Callable[..., Leaves]:
    """The same function; what `jax.vmap` adds to it are more robots along the last axis."""
    run = custom_vmap(function)

    @run.def_vmap
    def batched(size: int, moved: Sequence[bool], *leaves: jax.Array) -> Any:
        whole = [
            leaf if has else jnp.broadcast_to(leaf, (size, *leaf.shape))
            for leaf, has in zip(leaves, moved, strict=True)
        ]
        turned = [jnp.moveaxis(leaf, 0, -2) for leaf in whole]
        found = run(*(leaf.reshape(*leaf.shape[:-2], size * leaf.shape[-1]) for leaf in turned))
        apart = [each.reshape(*each.shape[:-1], size, each.shape[-1] // size) for each in found]
        return [jnp.moveaxis(each, -2, 0) for each in apart], [True] * len(found)

    return run
