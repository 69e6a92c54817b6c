"""Random words by counting, written out so that they are computed where they are used.

The generator is Threefry-2x32 with 20 rounds, JAX's own; its words are those of
`jax.random.fold_in`. JAX runs the rounds as a loop, for which the words of many ticks have to be
drawn together and kept.

Source: J. Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

_PARITY = 0x1BD11BDA
_ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def words(key: jax.Array, counts: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Two random words for each count.

    Args:
        key: two words, as `jax.random.key_data` gives them, shape (2,), uint32.
        counts: uint32, any shape.

    Returns:
        two arrays in the shape of the counts, uint32: what `jax.random.fold_in` makes of them.
    """
    parity = key[0] ^ key[1] ^ jnp.uint32(_PARITY)
    schedule = (key[0], key[1], parity)
    first, second = jnp.broadcast_to(key[0], counts.shape), counts + key[1]
    for block in range(5):
        for turn in _ROTATIONS[block % 2]:
            first = first + second
            second = (second << jnp.uint32(turn)) | (second >> jnp.uint32(32 - turn))
            second = second ^ first
        first = first + schedule[(block + 1) % 3]
        second = second + schedule[(block + 2) % 3] + jnp.uint32(block + 1)
    return first, second


def uniform(key: jax.Array, number: int, dtype: jax.typing.DTypeLike) -> jax.Array:
    """Random numbers from 0 up to 1, shape (number,): in float32 those of `jax.random.uniform`."""
    first, second = words(key, jnp.arange(number, dtype=jnp.uint32))
    # The 23 highest bits are the fraction of a number between 1 and 2.
    fraction = ((first ^ second) >> 9) | jnp.uint32(0x3F800000)
    return (jax.lax.bitcast_convert_type(fraction, jnp.float32) - 1.0).astype(dtype)


def folded(key: jax.Array, number: jax.Array | int) -> jax.Array:
    """The key that `jax.random.fold_in` makes of a key's two words and a number, shape (2,)."""
    return jnp.stack(words(key, jnp.asarray(number, jnp.uint32)))
