"""A function as one kernel: the same values, and on newer releases of JAX indeed one kernel."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.compilation.single_kernel import single_kernel


def _function(tree, number):
    x, words = tree["x"], tree["words"]
    count = jax.random.fold_in(jax.random.wrap_key_data(words), number)
    y = jnp.sin(x) * jnp.cos(x).T + jnp.sum(x, axis=1, keepdims=True)
    moved = jnp.where(y > 0.0, jnp.roll(y, 1), jnp.abs(y)) / (1.0 + jnp.max(y))
    return {"y": moved, "bits": jax.random.bits(count, (3,)), "none": None}, number + 1


def _inputs():
    x = np.random.default_rng(3).normal(size=(5, 5)).astype(np.float32)
    return {"x": jnp.asarray(x), "words": jnp.asarray([7, 9], jnp.uint32)}, jnp.int32(4)


def test_values_are_the_functions():
    want, number = _function(*_inputs())
    found, following = jax.jit(single_kernel(_function))(*_inputs())
    assert int(number) == int(following) == 5
    np.testing.assert_array_equal(found["bits"], want["bits"])
    np.testing.assert_allclose(found["y"], want["y"], rtol=1e-5, atol=1e-6)
    assert found["none"] is None


def test_derivatives_forward():
    def square(x):
        return x * x

    value, slope = jax.jvp(single_kernel(square), (jnp.float32(3.0),), (jnp.float32(1.0),))
    assert float(value) == 9.0 and float(slope) == 6.0


@pytest.mark.skipif(jax.__version_info__ < (0, 12), reason="older releases must be told to")
@pytest.mark.skipif(jax.default_backend() != "cpu", reason="of the CPU's compiler")
def test_it_is_one_kernel():
    def started(function):
        """How many parts with inputs the program starts, one by one."""
        compiled = jax.jit(function).lower(*_inputs()).compile().as_text()
        entry = compiled[compiled.index("\nENTRY ") :]
        return len(re.findall(r" (?:fusion|reduce|while|call)\(%(?!constant)", entry))

    assert started(_function) > 3
    assert started(single_kernel(_function)) == 1
