"""Growth rates of simulated loops against the exact spectral radius, on maps of gains."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import quickly
from exact import growth_rate as exact_growth_rate

from jaxact.drive import step as drives
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.sensor import Sensor
from jaxact.drive.step import Drive, DriveOptions
from jaxact.loops import loop, reading
from jaxact.loops.loop import Loop
from jaxact.loops.samples import expand
from jaxact.parameters import PRESETS
from jaxact.plants.mass import Mass
from jaxact.simulation import plans, spectra
from jaxact.simulation.growth import rate as growth

TILE = 256
KP, KD = (a.ravel() for a in np.meshgrid(np.geomspace(10, 1e5, 256), np.geomspace(0.1, 2000, 256)))
CASES = [(name, delay) for name in PRESETS for delay in (0.0, 1e-3, 5e-3)]
CASES += [("hyq", 0.37e-3), ("starleth", 1.83e-3), ("ideal", 0.37e-3)]

OPTIONS = drives.options(Drive(Controller(1.0, 1.0), Actuator(delay=5e-3)))


# Compiles in a third of the time and runs as fast.
@functools.partial(jax.jit, compiler_options={"xla_backend_optimization_level": 1})
def _map(kp, kd, wn, zeta, delay):
    def one(kp, kd):
        drive = Drive(Controller(kp, kd), Actuator(wn, zeta, delay))
        prepared = loop.prepare(Loop(Mass(0.7), drive), OPTIONS)
        state = loop.init(prepared, OPTIONS, 0.0, 0.0)
        return growth.growth_rate(prepared, OPTIONS, state, Setpoint(0.0))

    return jax.lax.map(lambda tile: jax.vmap(one)(*tile), (kp, kd))


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "delay"), CASES)
def test_every_verdict_and_growth_rate_of_a_large_map(name, delay):
    wn, zeta = PRESETS[name]
    with jax.enable_x64(True):
        kp, kd = KP.reshape(-1, TILE), KD.reshape(-1, TILE)
        got = np.asarray(_map(kp, kd, wn, zeta, delay)).ravel()
    want = exact_growth_rate(KP, KD, 0.7, wn, zeta, delay)
    decided = np.abs(np.expm1(want * 1e-3)) > 1e-4
    wrong = decided & ((got > 0.0) != (want > 0.0))
    assert not np.any(wrong), list(zip(KP[wrong], KD[wrong], got[wrong], want[wrong], strict=True))
    near = np.abs(want) < 200.0
    excess = np.abs(got - want)[near] - (0.01 * np.abs(want[near]) + 0.02)
    assert np.max(excess) <= 0.0
    assert np.sum(near) > 10_000


@pytest.fixture
def quickly_compiled():
    """For what is not as large as the maps."""
    with quickly.optimised_little():
        yield


LATE = drives.options(Drive(Controller(1.0, 1.0), Actuator(delay=20.4e-3)), differenced=True)


@jax.jit
def _late_rates(kp, kd, wn, zeta, delay, cutoff):
    def one(kp, kd):
        sensor = Sensor(velocity_filter=cutoff)
        drive = Drive(Controller(kp, kd), Actuator(wn, zeta, delay), sensor)
        prepared = loop.prepare(Loop(Mass(0.7), drive), LATE)
        state = loop.init(prepared, LATE, 0.0, 0.0)
        return growth.growth_rate(prepared, LATE, state, Setpoint(0.0))

    return jax.vmap(one)(kp, kd)


@pytest.mark.exhaustive
@pytest.mark.usefixtures("quickly_compiled")
@pytest.mark.parametrize("cutoff", [np.inf, 500.0])
def test_differenced_velocity_and_long_delays(cutoff):
    """A long line is a ring buffer; lightly damped actuators have many slow modes."""
    kp, kd = KP[::97], KD[::97]
    for wn, zeta, delay in ((300.0, 0.05, 12e-3), (800.0, 0.45, 20.4e-3)):
        with jax.enable_x64(True):
            got = np.asarray(_late_rates(jnp.asarray(kp), jnp.asarray(kd), wn, zeta, delay, cutoff))
        want = exact_growth_rate(kp, kd, 0.7, wn, zeta, delay, differenced=True, cutoff=cutoff)
        decided = np.abs(np.expm1(want * 1e-3)) > 1e-4
        assert np.all((got > 0.0) == (want > 0.0), where=decided)
        near = np.abs(want) < 200.0
        np.testing.assert_array_less(np.abs(got - want)[near], 0.01 * np.abs(want[near]) + 0.02)


@pytest.mark.exhaustive
@pytest.mark.usefixtures("quickly_compiled")
def test_high_control_rates():
    """Where a control period is short, all modes are close to each other."""
    rate, delay = 20e3, 0.25e-3
    case = plans.groups(
        specification := reading.parse(
            f"engine = 'mass'\n[parameters]\nactuator = 'starleth'\ncontrol_rate = {rate}\n"
            f"delay = {delay}\n[axes]\nkp = {{min = 10, max = 1e5, num = 24, spacing = 'log'}}\n"
            "kd = {min = 0.1, max = 2000, num = 24, spacing = 'log'}"
        ),
        samples := expand(specification),
    )[0]
    got = spectra.rates_batch(
        case, specification, samples, np.arange(case.batch) % len(samples)
    ).growth
    kp, kd = samples.values["kp"], samples.values["kd"]
    want = exact_growth_rate(kp, kd, 0.7, *PRESETS["starleth"], delay, period=1.0 / rate)
    near = np.abs(want) < 200.0
    excess = np.abs(got[: want.size] - want) - (0.01 * np.abs(want) + 0.02)
    assert np.max(excess[near]) <= 0.0
    assert np.sum(near) > 100


@pytest.mark.exhaustive
@pytest.mark.usefixtures("quickly_compiled")
@pytest.mark.parametrize("slots", [6, 46])
def test_a_line_much_longer_than_the_delay_changes_nothing(slots):
    """Just inside the gain margin, where a false mode would change the verdict."""
    wn, zeta, delay = 100.0, 0.45, 5e-3
    factors = np.linspace(0.2, 3.0, 600)
    options = DriveOptions(command_slots=slots)

    @jax.jit
    def rates(factors):
        def one(factor):
            drive = Drive(Controller(400.0 * factor, 20.0 * factor), Actuator(wn, zeta, delay))
            prepared = loop.prepare(Loop(Mass(0.7), drive), options)
            state = loop.init(prepared, options, 0.0, 0.0)
            return growth.growth_rate(prepared, options, state, Setpoint(0.0))

        return jax.vmap(one)(factors)

    with jax.enable_x64(True):
        got = np.asarray(rates(jnp.asarray(factors)))
    want = exact_growth_rate(400.0 * factors, 20.0 * factors, 0.7, wn, zeta, delay)
    np.testing.assert_array_less(np.abs(got - want), 0.01 * np.abs(want) + 0.02)
