import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st
from quickly import compiled_quickly as compiled_quickly

from jaxact.drive import actuator
from jaxact.drive.actuator import Actuator


def _exponential(wn, zeta, time):
    """expm of (f, f', integral of f, double integral of f, u)."""
    A = np.zeros((5, 5))
    A[0, 1], A[1, 0], A[1, 1], A[1, 4] = 1.0, -(wn**2), -2.0 * zeta * wn, wn**2
    A[2, 0], A[3, 2] = 1.0, 1.0
    return scipy.linalg.expm(A * time)


@jax.jit
def _one_step(wn, zeta, step, older_for, force, rate, older, newer):
    response = actuator.response(wn, zeta, step, older_for)
    end = actuator.advance(response, force, rate, older, newer)
    return jnp.stack([*end, *actuator.impulse(response, force, rate, older, newer)])


_response = jax.jit(actuator.response)


@given(
    wn=st.floats(1.0, 3000.0),
    zeta=st.one_of(st.floats(0.01, 5.0), st.just(1.0), st.floats(1 - 1e-7, 1 + 1e-7)),
    step=st.floats(1e-5, 0.05),
    share=st.floats(0.0, 1.0),
    state=st.tuples(*[st.floats(-10.0, 10.0)] * 4),
)
def test_response_is_the_matrix_exponential(wn, zeta, step, share, state):
    force, rate, older, newer = state
    rate = rate * wn
    x = np.array([force, rate, 0.0, 0.0, older])
    x = _exponential(wn, zeta, share * step) @ x
    x[4] = newer
    x = _exponential(wn, zeta, (1.0 - share) * step) @ x
    with jax.enable_x64(True):
        got = np.asarray(_one_step(wn, zeta, step, share * step, force, rate, older, newer))
    mean, moment = got[2:]
    scale = 1e-10 * max(1.0, *np.abs(state))
    assert got[0] == pytest.approx(x[0], abs=scale)
    assert got[1] == pytest.approx(x[1], abs=scale * max(wn, 1.0))
    assert mean * step == pytest.approx(x[2], abs=scale * step)
    assert moment * 0.5 * step**2 == pytest.approx(x[3], abs=scale * step**2)


@pytest.mark.parametrize("wn", [5.0, 110.0, 2000.0])
@pytest.mark.parametrize("zeta", [0.05, 0.999999, 1.0, 1.000001, 4.0])
def test_single_precision_is_accurate(wn, zeta):
    for step in (1e-4, 1e-3, 5e-3):
        exact = _exponential(wn, zeta, step)
        response = _response(wn, zeta, step, 0.0)
        np.testing.assert_allclose(response.force[:2], exact[0, :2], rtol=3e-5, atol=3e-7)
        np.testing.assert_allclose(
            np.array(response.mean[:2]) * step, exact[2, :2], rtol=3e-5, atol=1e-9
        )
        np.testing.assert_allclose(
            np.array(response.moment[:2]) * step**2 / 2, exact[3, :2], rtol=1e-4, atol=1e-12
        )


def test_smooth_through_critical_damping():
    @jax.jit
    def value(zeta, time):
        free = actuator.free_response(100.0, zeta, time)
        return jnp.stack([free.c, free.s, free.Is, free.Js])

    slope = jax.jit(jax.jacfwd(value))
    with jax.enable_x64(True):
        for time in (1e-4, 0.01, 0.3):
            assert np.all(np.isfinite(slope(1.0, time)))
            h = 1e-5
            for zeta in (0.5, 1.0, 1.0 + 1e-6, 1.5):
                central = (value(zeta + h, time) - value(zeta - h, time)) / (2 * h)
                # the difference of two rounded values, divided by 2 h
                rounding = 1e-10 * np.max(np.abs(np.asarray(value(zeta, time))))
                np.testing.assert_allclose(slope(zeta, time), central, rtol=1e-6, atol=rounding)


def test_two_half_steps_are_one_step():
    with jax.enable_x64(True):
        whole = actuator.response(300.0, 0.3, 2e-3, 0.7e-3)
        first = actuator.response(300.0, 0.3, 1e-3, 0.7e-3)
        second = actuator.response(300.0, 0.3, 1e-3, 0.0)
        start = (1.0, -50.0)
        middle = actuator.advance(first, *start, 2.0, -1.0)
        np.testing.assert_allclose(
            actuator.advance(second, *middle, -1.0, -1.0),
            actuator.advance(whole, *start, 2.0, -1.0),
            rtol=1e-13,
        )
        means = [
            actuator.impulse(first, *start, 2.0, -1.0)[0],
            actuator.impulse(second, *middle, -1.0, -1.0)[0],
        ]
        mean = actuator.impulse(whole, *start, 2.0, -1.0)[0]
        assert 0.5 * sum(means) == pytest.approx(float(mean), rel=1e-13)


def test_a_fast_actuator_approaches_the_ideal_one():
    with jax.enable_x64(True):
        ideal = actuator.response(jnp.inf, 1.0, 1e-3, 0.4e-3)
        for wn, tolerance in ((1e5, 3e-2), (1e7, 3e-4), (1e9, 3e-6)):
            fast = actuator.response(wn, 1.0, 1e-3, 0.4e-3)
            for name in ("mean", "moment"):
                got = actuator.impulse(fast, 0.0, 0.0, 2.0, -1.0)
                want = actuator.impulse(ideal, 0.0, 0.0, 2.0, -1.0)
                np.testing.assert_allclose(got, want, atol=tolerance, err_msg=name)
        assert actuator.impulse(ideal, 0.0, 0.0, 2.0, -1.0)[0] == pytest.approx(0.4 * 2 - 0.6)


def test_force_speed_line():
    motor = Actuator(force_limit=8.0, stall_force=10.0, no_load_speed=5.0)
    speeds = jnp.array([-5.0, 0.0, 1.0, 2.5, 5.0, 7.0])
    low, high = actuator.limits(motor, speeds)
    np.testing.assert_allclose(high, [8.0, 8.0, 8.0, 5.0, 0.0, 0.0])
    np.testing.assert_allclose(low, [0.0, -8.0, -8.0, -8.0, -8.0, -8.0])
    low, high = actuator.limits(Actuator(), speeds)
    assert np.all(np.isinf(high)) and np.all(np.isinf(low))
