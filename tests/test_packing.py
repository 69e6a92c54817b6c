"""Trees as one array and back."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.compilation.packing import pack, unpack


def test_a_batch_of_trees_comes_back_as_it_was():
    keys = jax.random.split(jax.random.key(0), 3)
    tree = {
        "a": (jnp.arange(6.0).reshape(3, 2), None),
        "b": jnp.arange(3.0),
        "whole": jnp.arange(3, dtype=jnp.int32),
        "key": keys,
        "matrix": jnp.arange(12.0).reshape(3, 2, 2),
    }
    packed = jax.jit(jax.vmap(pack))(tree)
    assert packed.numbers.shape == (3, 2 + 1 + 4)
    assert len(packed.others) == 2
    back = jax.jit(jax.vmap(unpack))(packed)
    assert jax.tree.structure(back) == jax.tree.structure(tree)
    np.testing.assert_array_equal(jax.random.key_data(back.pop("key")), jax.random.key_data(keys))
    tree.pop("key")
    jax.tree.map(np.testing.assert_array_equal, back, tree)


def test_a_batch_is_taken_apart_on_the_host_too():
    tree = {"a": jnp.arange(6.0).reshape(3, 2), "b": jnp.arange(3.0), "whole": jnp.arange(3)}
    back = unpack(jax.tree.map(np.asarray, jax.vmap(pack)(tree)))
    assert all(isinstance(leaf, np.ndarray) for leaf in jax.tree.leaves(back))
    jax.tree.map(np.testing.assert_array_equal, back, tree)


def test_a_tree_without_numbers():
    packed = pack((jnp.int32(3), None))
    assert packed.numbers.shape == (0,)
    assert unpack(packed) == (3, None)
