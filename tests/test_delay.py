import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from quickly import compiled_quickly as compiled_quickly

from jaxact.drive import delay


@pytest.mark.exhaustive
@settings(max_examples=15)  # each compiles lines of its own
@given(whole=st.integers(0, 40), joints=st.integers(1, 3))
def test_a_whole_delay_is_a_shift(whole, joints):
    length = delay.slots(whole * 1e-3, 1e-3)
    assert length == whole + 1
    where = delay.weights(jnp.full((joints,), float(whole)), length)
    line = delay.init(jnp.full((joints,), -1.0), length)
    signal = np.arange(60.0)[:, None] + np.arange(joints)
    got = []
    for value in signal:
        line = delay.push(line, jnp.asarray(value, jnp.float32))
        got.append(np.asarray(delay.read(line, where)))
    expected = np.concatenate([np.full((whole, joints), -1.0), signal])[:60]
    np.testing.assert_array_equal(got, expected)


def test_joints_may_have_different_delays_in_short_and_long_lines():
    for length in (8, 30):
        ages = jnp.array([0.0, 3.0, 7.0])
        where = delay.weights(ages, length)
        line = delay.init(jnp.zeros(3), length)
        for value in range(20):
            line = delay.push(line, jnp.full(3, float(value)))
        np.testing.assert_array_equal(delay.read(line, where), [19.0, 16.0, 12.0])


@pytest.mark.parametrize("wide", [True, False])
def test_split_survives_decimal_rounding(wide):
    with jax.enable_x64(wide):
        for period in (1e-3, 2.5e-4, 1 / 3000):
            for whole in (0, 1, 3, 5, 20, 117):
                d, r = delay.split(jnp.asarray(whole * period), jnp.asarray(period))
                assert d == whole
                assert 0.0 <= r < 1e-4 * period
        d, r = delay.split(jnp.asarray(1.83e-3), jnp.asarray(1e-3))
        assert d == 1 and r == pytest.approx(0.83e-3, rel=1e-5)
        slope = jax.grad(lambda x: delay.split(x, 1e-3)[1])(3e-3)
        assert slope == 1.0
