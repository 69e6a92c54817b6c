"""Random words by counting: JAX's own, and normal numbers of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

from jaxact.drive import sensor, threefry
from jaxact.drive.sensor import SensorOptions


@pytest.mark.parametrize("seed", [0, 7, 2**31 + 5])
def test_words_are_those_of_jax(seed):
    key = jax.random.fold_in(jax.random.key(np.uint32(seed)), 3)
    counts = np.array([0, 1, 2, 1000, 2**31, 2**32 - 1], np.uint32)
    each = jax.vmap(lambda count: jax.random.key_data(jax.random.fold_in(key, count)))
    found = threefry.words(jax.random.key_data(key), jnp.asarray(counts))
    np.testing.assert_array_equal(np.stack(found, axis=1), each(counts))


def test_uniform_numbers_and_keys_are_those_of_jax():
    key = jax.random.key(11)
    words = jax.random.key_data(key)
    np.testing.assert_array_equal(
        threefry.uniform(words, 9, jnp.float32), jax.random.uniform(key, (9,), jnp.float32)
    )
    np.testing.assert_array_equal(
        threefry.folded(words, 5), jax.random.key_data(jax.random.fold_in(key, 5))
    )


@pytest.mark.parametrize("joints", [(), (3,)])
def test_draws_of_ticks_and_joints_are_normal_and_apart(joints):
    options = SensorOptions(noise=True, walk=True)
    key, like = jax.random.key(5), jnp.zeros(joints)
    drawn = jax.jit(jax.vmap(lambda n: sensor.draw(options, key, n, like)))(jnp.arange(20000))
    rows = np.stack([np.asarray(row).reshape(-1) for row in (*drawn.noise, *drawn.walk)])
    assert len(np.unique(rows)) > 0.99 * rows.size
    assert np.abs(np.corrcoef(rows) - np.eye(4)).max() < 0.03
    for row in rows:
        assert scipy.stats.kstest(row, "norm").pvalue > 1e-4


def test_noise_without_a_key_is_refused():
    with pytest.raises(ValueError, match="random key"):
        sensor.draw(SensorOptions(noise=True), None, jnp.int32(0), jnp.zeros(()))
