"""A function compiled into one kernel, for calls whose work is less than starting their parts.

On the CPU, XLA starts the operations of a program one by one, some of them on other threads, which
takes a microsecond or more each. What is inside a loop it compiles as a whole: a drive's control
period takes 25 instead of 150 microseconds that way. Releases before JAX 0.12 do not.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxact.compilation.processor import platform


def single_kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function of arrays as the body of a loop that runs once.

    Where XLA would gain nothing from it, the function itself. Derivatives can be taken in forward
    direction only.

    Args:
        function: of trees of arrays; one that multiplies matrices, sorts, scatters, or calls
            libraries is compiled in parts as usual.
    """
    if platform() != "cpu":
        return function

    @functools.wraps(function)
    def run(*inputs: Any) -> Any:
        """The function's value; the compiler is not told that the loop ends after one round."""
        shapes = jax.eval_shape(function, *inputs)
        blank = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)
        end = jax.lax.optimization_barrier(jnp.int32(1))

        def round_(carried: Any) -> Any:
            count, inputs, _ = carried
            # What XLA sees to be the same in all rounds it would compute before the loop.
            return count + 1, jax.lax.optimization_barrier(inputs), function(*inputs)

        start = jnp.int32(0), inputs, blank
        return jax.lax.while_loop(lambda carried: carried[0] < end, round_, start)[2]

    return run
