"""A joint with damping and stiffness of its own under the one drive, against scipy's expm."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from quickly import compiled_quickly as compiled_quickly

from jaxact.analysis.sampled.period_map import SampledLoop, one_period_matrix
from jaxact.drive import step as drives
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.sensor import Sensor
from jaxact.drive.step import Drive
from jaxact.loops import loop
from jaxact.loops.loop import Loop
from jaxact.plants.mass import Mass
from jaxact.simulation import trajectory
from jaxact.simulation.growth import rate as growth

PERIOD, TICKS = 1e-3, 60
DRIVE = Drive(Controller(400.0, 20.0), Actuator(110.0, 0.9, 2.3e-3), Sensor(delay=1.7e-3))
UPRIGHT, HANGING = Mass(0.7, 3.0, -250.0), Mass(0.7, 0.4, 5e4)
_trajectory = jax.jit(trajectory.of_loop, static_argnums=(1, 2))


@pytest.fixture(autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def _simulated(plant, drive=DRIVE, substeps=1):
    options = drives.options(drive, substeps=substeps)
    path = _trajectory(Loop(plant, drive), options, TICKS, Setpoint(0.1))
    return jax.tree.map(np.asarray, path)


def _by_events(plant, drive):
    """Positions at the ticks: from one switching instant to the next by `scipy.linalg.expm`."""
    m, c, k = plant.mass, plant.damping, plant.stiffness
    wn, zeta = drive.actuator.natural_frequency, drive.actuator.damping_ratio
    ideal = np.isinf(wn)
    A = np.zeros((5, 5))  # q, v, f, f', u
    A[0, 1], A[1, :2], A[1, 4 if ideal else 2] = 1.0, (-k / m, -c / m), 1 / m
    if not ideal:
        A[2, 3], A[3, 2:] = 1.0, (-(wn**2), -2 * zeta * wn, wn**2)
    late, seen = drive.actuator.delay + drive.output_delay, drive.sensor.delay
    x, now, commands, measured, positions = np.zeros(5), 0.0, [], {}, []
    events = sorted(
        [(tick * PERIOD, 2, tick) for tick in range(TICKS)]
        + [(tick * PERIOD - seen, 0, tick) for tick in range(TICKS) if tick * PERIOD > seen]
        + [(tick * PERIOD + late, 1, tick) for tick in range(TICKS)]
    )
    for time, kind, tick in events:
        if time > (TICKS - 1) * PERIOD:
            break
        x, now = scipy.linalg.expm(A * max(time - now, 0.0)) @ x, max(time, now)
        if kind == 0:
            measured[tick] = x[:2].copy()
        elif kind == 1:
            x[4] = commands[tick]
        else:
            q, v = measured.get(tick, x[:2] * (seen == 0))
            commands.append(drive.controller.kp * (0.1 - q) - drive.controller.kd * v)
            positions.append(x[0])
            if late == 0:
                x[4] = commands[tick]
    return np.array(positions)


@pytest.mark.exhaustive
@pytest.mark.parametrize("plant", [UPRIGHT, HANGING], ids=["upright", "hanging"])
@pytest.mark.parametrize(
    ("wn", "delay", "measured"),
    [(110.0, 2.3e-3, 1.7e-3), (800.0, 0.4e-3, 0.6e-3), (np.inf, 1.3e-3, 0.0), (3e4, 3e-3, 0.2e-3)],
)
@pytest.mark.parametrize("substeps", [1, 3])
def test_a_rollout_is_exact_between_all_switching_instants(plant, wn, delay, measured, substeps):
    drive = replace(DRIVE, actuator=Actuator(wn, 0.6, delay), sensor=Sensor(delay=measured))
    found = _simulated(plant, drive, substeps).position[::substeps][:TICKS]
    expected = _by_events(plant, drive)
    assert np.abs(expected).max() > 5e-4
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


@functools.partial(jax.jit, static_argnums=2)
def _growth_rate(plant, drive, options):
    prepared = loop.prepare(Loop(plant, drive), options)
    state = loop.init(prepared, options, 0.0, 0.0)
    dense = growth.GrowthOptions(dense=True, dimension=14)
    return growth.growth_rate(prepared, options, state, Setpoint(0.0), dense)


@pytest.mark.exhaustive
def test_the_derivative_of_the_step_is_the_matrix_of_the_sampled_theory():
    rng = np.random.default_rng(5)
    for _ in range(40):
        mass, rate = 10 ** rng.uniform(-2, 1), 10 ** rng.uniform(0, 2.3)
        c = 2 * mass * rate * 10 ** rng.uniform(-3, 0.5)
        k = mass * rate**2 * rng.choice([-1.0, 1.0])
        kp, kd = abs(k) * 10 ** rng.uniform(-0.5, 1.5), mass * rate * 10 ** rng.uniform(-1, 1)
        wn, zeta, delay = 10 ** rng.uniform(1.5, 3), rng.uniform(0.3, 1.5), rng.uniform(0, 2.9e-3)
        drive = Drive(Controller(kp, kd), Actuator(wn, zeta, delay), Sensor(delay=0.8e-3))
        options = replace(drives.options(drive), command_slots=4)
        found = float(_growth_rate(Mass(mass, c, k), drive, options))
        sampled = SampledLoop(
            *map(jnp.asarray, (kp, kd, mass, wn, zeta, delay + 0.8e-3, PERIOD)),
            jnp.asarray(np.inf), joint_damping=jnp.asarray(c), joint_stiffness=jnp.asarray(k),
        )  # fmt: skip
        radius = np.abs(np.linalg.eigvals(np.asarray(_matrix(sampled)))).max()
        assert found == pytest.approx(np.log(radius) / PERIOD, rel=1e-6, abs=1e-4)


_matrix = jax.jit(lambda sampled: one_period_matrix(sampled, 4))


@pytest.mark.exhaustive
def test_no_damping_and_no_stiffness_move_as_the_bare_mass():
    bare, zero = _simulated(Mass(0.7), substeps=2), _simulated(Mass(0.7, 0.0, 0.0), substeps=2)
    np.testing.assert_allclose(zero.position, bare.position, rtol=1e-11, atol=1e-14)
    np.testing.assert_allclose(zero.velocity, bare.velocity, rtol=1e-11, atol=1e-13)


def test_a_bare_mass_computes_nothing_of_it():
    def state_after(plant):
        prepared = loop.prepare(Loop(plant, DRIVE), OPTIONS)
        assert (prepared.drive.responses.joint is None) == (plant.joint is None)
        state = loop.init(prepared, OPTIONS, 0.0, 0.0)
        return loop.step(prepared, OPTIONS, state, Setpoint(0.1))[0]

    assert "while" not in str(jax.make_jaxpr(lambda: state_after(Mass(0.7)))())
    assert "scan" in str(jax.make_jaxpr(lambda: state_after(UPRIGHT))())


OPTIONS = drives.options(DRIVE)


@pytest.mark.exhaustive
def test_a_saturated_force_moves_the_joint_as_what_is_left_of_it():
    """Of first order in the step only where the limit is reached or left within one."""
    limited = replace(DRIVE, actuator=replace(DRIVE.actuator, force_limit=8.0))
    coarse, fine = (_simulated(UPRIGHT, limited, substeps) for substeps in (1, 8))
    free = _simulated(UPRIGHT)
    assert np.abs(free.position - coarse.position).max() > 1e-3
    np.testing.assert_allclose(
        coarse.position, fine.position[::8], atol=1e-3 * np.abs(fine.position).max()
    )
    held = replace(limited, controller=Controller(0.0, 0.0, feedforward=50.0))
    held = replace(held, actuator=Actuator(np.inf, 1.0, 0.0, force_limit=8.0))
    times = PERIOD * np.arange(TICKS)
    A = np.array([[0.0, 1.0, 0.0], [250.0 / 0.7, -3.0 / 0.7, 8.0 / 0.7], [0.0, 0.0, 0.0]])
    expected = [(scipy.linalg.expm(A * time) @ [0, 0, 1])[0] for time in times]
    found = _simulated(UPRIGHT, held).position[:TICKS]
    np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.exhaustive
def test_coefficients_have_derivatives_by_damping_and_stiffness():
    def end(c, k):
        path = trajectory.of_loop(Loop(Mass(0.7, c, k), DRIVE), OPTIONS, 40, Setpoint(0.1))
        return path.position[-1]

    at = jnp.asarray(3.0), jnp.asarray(-250.0)
    exact = jax.jit(jax.grad(end, (0, 1)))(*at)
    end = jax.jit(end)
    for number, step in ((0, 1e-4), (1, 1e-2)):
        ends = [end(*(jnp.stack(at) + s * step * jnp.eye(2)[number])) for s in (1, -1)]
        difference = float(ends[0] - ends[1]) / (2 * step)
        assert float(exact[number]) == pytest.approx(difference, rel=1e-5)
