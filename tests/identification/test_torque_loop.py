"""The force loop on uneven time stamps, against SciPy's integration and central differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from scipy.integrate import solve_ivp

from jaxact.identification import torque_loop

ROWS = 60
TICK = 2e-3


@pytest.fixture(scope="module")
def log():
    generator = np.random.default_rng(3)
    time = np.cumsum(TICK * generator.uniform(0.6, 1.4, ROWS))
    return time, generator.normal(size=ROWS)


@pytest.fixture(scope="module", autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def _values(**changes):
    return {
        "gain": 0.8, "offset": 0.1, "wn": 120.0, "zeta": 0.6, "delay": 3.1e-3,
        "force_limit": np.inf, "initial_force": 0.4, **changes,
    }  # fmt: skip


def _integrated(time, command, values):
    """The force at each row by a Runge-Kutta method between the instants of switching."""
    wn, zeta, switch = values["wn"], values["zeta"], time + values["delay"]
    instants = np.unique(np.concatenate([time, switch[switch < time[-1]]]))
    state, found = np.array([values["initial_force"], 0.0]), {time[0]: values["initial_force"]}
    for start, end in zip(instants[:-1], instants[1:], strict=True):
        held = max(int(np.searchsorted(switch, 0.5 * (start + end), side="right")) - 1, 0)
        u = values["gain"] * command[held]
        solved = solve_ivp(
            lambda _, x, u=u: [x[1], wn**2 * (u - x[0]) - 2.0 * zeta * wn * x[1]],
            (start, end), state, rtol=1e-10, atol=1e-12,
        )  # fmt: skip
        state = solved.y[:, -1]
        found[end] = state[0]
    return np.array([found[t] for t in time]) + values["offset"]


@pytest.mark.parametrize("delay", [0.0, 3.1e-3, 9.7e-3])
def test_forces_are_those_of_the_differential_equation(log, delay):
    values = _values(delay=delay)
    found = torque_loop.simulate(*map(jnp.asarray, log), values)
    np.testing.assert_allclose(found, _integrated(*log, values), atol=1e-7)


def test_an_ideal_drive_gives_the_command_that_has_arrived(log):
    time, command = log
    values = _values(wn=np.inf, zeta=1.0, delay=2.5e-3, gain=1.0, offset=0.0)
    found = np.asarray(torque_loop.simulate(jnp.asarray(time), jnp.asarray(command), values))
    arrived = np.searchsorted(time + 2.5e-3, time, side="right") - 1
    np.testing.assert_allclose(found[arrived >= 0], command[arrived[arrived >= 0]])


@pytest.mark.parametrize(
    "name",
    ["delay"]
    + [
        pytest.param(name, marks=pytest.mark.exhaustive)
        for name in ("gain", "offset", "wn", "zeta")
    ],
)
def test_derivatives_are_central_differences(log, name):
    time, command = map(jnp.asarray, log)
    simulate = jax.jit(lambda x: torque_loop.simulate(time, command, _values() | {name: x}))
    at = _values()[name]
    exact = jax.jvp(simulate, (jnp.asarray(at),), (jnp.asarray(1.0),))[1]
    step = 1e-6 * at
    measured = (simulate(at + step) - simulate(at - step)) / (2.0 * step)
    scale = float(jnp.max(jnp.abs(exact)))
    np.testing.assert_allclose(exact / scale, measured / scale, atol=1e-6)


def test_at_a_tick_both_one_sided_derivatives_by_the_delay_are_right():
    time = jnp.arange(ROWS) * TICK
    command = jnp.asarray(np.random.default_rng(5).normal(size=ROWS))
    # Of first order, as the response of a second order begins so softly that it has no kink.
    values = _values(wn=4e4, zeta=100.0)
    simulate = jax.jit(lambda delay: torque_loop.simulate(time, command, values | {"delay": delay}))
    by = jax.jit(lambda delay: jax.jvp(simulate, (delay,), (jnp.ones(()),))[1])
    # A first-order loop here is one of second order with a pole of 0.1 us.
    tick, near, step = 2.0 * TICK, 5e-6, 1e-7
    slopes = []
    for at in (tick + near, tick - near):
        slopes.append(by(at))
        measured = (simulate(at + step) - simulate(at - step)) / (2.0 * step)
        scale = float(jnp.max(jnp.abs(measured)))
        np.testing.assert_allclose(slopes[-1] / scale, measured / scale, atol=1e-6)
    assert float(jnp.max(jnp.abs(slopes[0] - slopes[1]))) > 0.1 * scale
