"""Functions with the derivatives of others that compute the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
from jax.custom_derivatives import SymbolicZero


def derived(function: Callable[..., Any], like: Callable[..., Any]) -> Callable[..., Any]:
    """The same function of trees, with derivatives, and values beside them, that are `like`'s.

    Args:
        function: of trees; what is not a JAX array in them is taken as it is.
        like: a function of the same that gives the same.
    """

    def run(*inputs: Any) -> Any:
        leaves, structure = jax.tree.flatten(inputs)
        moving = [place for place, leaf in enumerate(leaves) if isinstance(leaf, jax.Array)]
        out: dict[str, Any] = {}

        def of_arrays(function: Callable[..., Any], arrays: Sequence[jax.Array]) -> Any:
            filled = list(leaves)
            for place, array in zip(moving, arrays, strict=True):
                filled[place] = array
            found, out["structure"] = jax.tree.flatten(
                function(*jax.tree.unflatten(structure, filled))
            )
            out["fixed"] = [None if isinstance(leaf, jax.Array) else leaf for leaf in found]
            return [leaf for leaf in found if isinstance(leaf, jax.Array)]

        @jax.custom_jvp
        def plain(*arrays: jax.Array) -> Any:
            return of_arrays(function, arrays)

        @partial(plain.defjvp, symbolic_zeros=True)
        def slopes(arrays: Sequence[jax.Array], tangents: Sequence[Any]) -> Any:
            varied = [i for i, each in enumerate(tangents) if not isinstance(each, SymbolicZero)]

            def of_varied(*some: jax.Array) -> Any:
                filled = list(arrays)
                for place, array in zip(varied, some, strict=True):
                    filled[place] = array
                return of_arrays(like, filled)

            return jax.jvp(of_varied, [arrays[i] for i in varied], [tangents[i] for i in varied])

        found = iter(plain(*(leaves[place] for place in moving)))
        whole = [next(found) if leaf is None else leaf for leaf in out["fixed"]]
        return jax.tree.unflatten(out["structure"], whole)

    return run
