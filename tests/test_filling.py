"""Batches filled up to one size: the numbers of the loops that count stay what they were."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.compilation.filling import filled, in_chunks


def test_the_last_entry_is_repeated_along_the_last_axis():
    tree = {"a": np.arange(6.0).reshape((2, 3)), "b": jnp.arange(3), "none": None}
    full = filled(tree, 5)
    np.testing.assert_array_equal(full["a"], [[0, 1, 2, 2, 2], [3, 4, 5, 5, 5]])
    np.testing.assert_array_equal(full["b"], [0, 1, 2, 2, 2])
    assert full["none"] is None and isinstance(full["a"], np.ndarray)
    assert jax.jit(lambda x: filled(x, 4))(tree["b"]).shape == (4,)


def test_chunks_have_one_size_and_their_results_are_those_of_the_whole():
    x = np.linspace(0.0, 1.0, 23)
    sizes = set()

    def function(tree):
        sizes.add(tree[0].shape)
        return {"sum": tree[0] + tree[1], "both": np.stack(tree)}

    found = in_chunks(function, (x, x**2), 8)
    assert sizes == {(8,)}
    np.testing.assert_array_equal(found["sum"], x + x**2)
    np.testing.assert_array_equal(found["both"], [x, x**2])
