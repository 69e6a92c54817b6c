"""Rollouts: derivatives, metrics against independent ones, and Python transformations."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.drive import step as drives
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.sensor import Sensor
from jaxact.drive.step import Drive, DriveOptions
from jaxact.loops import loop
from jaxact.loops.loop import Loop
from jaxact.plants.mass import Mass
from jaxact.simulation import metrics, rollout, trajectory
from jaxact.simulation.rollout import RolloutOptions
from jaxact.status import Verdict


def _delayed(place, delay):
    delays = {"command": 0.0, "measurement": 0.0, "output": 0.0, "setpoint": 0.0} | {place: delay}
    return Drive(
        Controller(400.0, 20.0, setpoint_delay=delays["setpoint"]),
        Actuator(110.0, 0.9, delays["command"]),
        Sensor(delay=delays["measurement"]),
        output_delay=delays["output"],
    )


PLACES = ("command", "measurement", "output")


@functools.partial(jax.jit, static_argnums=0)
def _final(options, delays, direction):
    """The last position and its derivative in a direction of the three delays."""

    def final(delays):
        drive = Drive(
            Controller(400.0, 20.0),
            Actuator(110.0, 0.9, delays[0]),
            Sensor(delay=delays[1]),
            output_delay=delays[2],
        )
        built, target = Loop(Mass(0.7), drive), Setpoint(0.1)
        path = trajectory.of_loop(built, options, 150, target, velocity=0.2)
        return path.position[-1]

    return jax.jvp(final, (delays,), (direction,))


@pytest.mark.exhaustive
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("substeps", [1, 4])
def test_derivative_with_respect_to_a_delay(place, substeps):
    options = DriveOptions(
        substeps, command_slots=8, measurement_slots=8 if place == "measurement" else 0
    )
    with jax.enable_x64(True):
        direction = jnp.asarray([float(name == place) for name in PLACES])

        def at(delay):
            value, derivative = _final(options, delay * direction, direction)
            return float(value), float(derivative)

        h = 1e-6
        for delay in (0.37e-3, 1.83e-3, 4.001e-3, 4.999e-3):
            central = (at(delay + h)[0] - at(delay - h)[0]) / (2 * h)
            assert at(delay)[1] == pytest.approx(central, rel=1e-5), delay
        for delay in (0.0, 1e-3, 5e-3):
            # one-sided, second order, towards longer delays
            value = [at(delay + k * h)[0] for k in range(3)]
            forward = (-3 * value[0] + 4 * value[1] - value[2]) / (2 * h)
            assert at(delay)[1] == pytest.approx(forward, rel=1e-5), delay


@pytest.mark.exhaustive
def test_gradients_of_every_kind():
    options = drives.options(_delayed("command", 2e-3))

    def error(kp, kd, wn, zeta, delay, mass):
        drive = Drive(Controller(kp, kd), Actuator(wn, zeta, delay))
        path = trajectory.of_loop(Loop(Mass(mass), drive), options, 200, Setpoint(0.1))
        return jnp.sum((path.position - 0.1) ** 2)

    with jax.enable_x64(True):
        at = (400.0, 20.0, 110.0, 1.0, 1.3e-3, 0.7)
        value = jax.jit(jax.value_and_grad(error, argnums=range(6)))
        reverse = value(*at)[1]
        forward = jax.jit(jax.jacfwd(error, argnums=range(6)))(*at)
        np.testing.assert_allclose(reverse, forward, rtol=1e-9)
        for place, point in enumerate(at):
            h = 1e-5 * point
            above, below = (
                value(*(x + s * h * (i == place) for i, x in enumerate(at)))[0] for s in (1, -1)
            )
            assert float((above - below) / (2 * h)) == pytest.approx(
                float(reverse[place]), rel=1e-5
            )


def _step_figures(time, y, setpoint, period):
    """Overshoot, rise and settling time of a sampled step response, the textbook way."""
    relative = y / setpoint
    low, high = (np.argmax(relative >= level) for level in (0.1, 0.9))

    def when(index, level):
        before, after = relative[index - 1], relative[index]
        return time[index - 1] + period * (level - before) / (after - before)

    outside = np.flatnonzero(np.abs(relative - 1.0) > 0.02)
    return {
        "overshoot": max(relative.max() - 1.0, 0.0),
        "rise_time": when(high, 0.9) - when(low, 0.1),
        "settling_time": time[outside[-1] + 1],
    }


@jax.jit
def _both(setpoint):
    """Trajectory and metrics of a step response."""
    drive, ticks = _delayed("command", 1.4e-3), 2000
    options = drives.options(drive)
    built = Loop(Mass(0.7), drive)
    prepared = loop.prepare(built, options)
    state = loop.init(prepared, options, 0.0, 0.0)
    got = rollout.evaluate(prepared, options, RolloutOptions(ticks), state, Setpoint(setpoint))
    return trajectory.of_loop(built, options, ticks + 1, Setpoint(setpoint)), got


@pytest.mark.parametrize("setpoint", [0.1, -0.25])
def test_metrics_equal_those_of_the_trajectory(setpoint):
    period = 1e-3
    with jax.enable_x64(True):
        path, got = jax.tree.map(np.asarray, _both(setpoint))
    for name, value in _step_figures(path.time, path.position, setpoint, period).items():
        assert getattr(got, name) == pytest.approx(value, rel=1e-9), name
    force, command = path.force[:-1], path.command[:-1]
    whole = path.position - setpoint
    absolute, squared = (np.trapezoid(f(whole), dx=period) for f in (np.abs, np.square))
    assert got.integrated_absolute_error == pytest.approx(absolute, rel=1e-9)
    assert got.integrated_squared_error == pytest.approx(squared, rel=1e-9)
    assert got.control_effort == pytest.approx(np.sum(command**2) * period)
    assert got.peak_force == pytest.approx(np.max(np.abs(force)))
    assert got.rms_force == pytest.approx(np.sqrt(np.mean(force**2)))
    assert got.verdict == Verdict.STABLE and got.limit_cycle_amplitude == 0.0


@functools.partial(jax.jit, static_argnums=0)
def _run(options, drive, key):
    prepared = loop.prepare(Loop(Mass(0.7), drive), options)
    state = loop.init(prepared, options, 0.0, 0.0)
    return rollout.evaluate(prepared, options, RolloutOptions(4000), state, Setpoint(0.1), key)


def _evaluate(drive):
    return _run(drives.options(drive), drive, jax.random.key(0))


@pytest.mark.exhaustive
def test_a_saturated_unstable_loop_ends_in_a_limit_cycle():
    """Far smaller than the settling band, and still shaking: held against a plain simulation."""
    drive = Drive(Controller(8e3, 400.0), Actuator(delay=5e-3, force_limit=50.0))
    with jax.enable_x64(True):
        got = jax.tree.map(np.asarray, _evaluate(drive))
    assert got.verdict == Verdict.LIMIT_CYCLE
    assert got.growth_rate > 0.0
    assert got.peak_force == pytest.approx(50.0)
    position, velocity, commands = 0.0, 0.0, [0.0] * 5
    positions, velocities = [], []
    for _ in range(4000):
        commands.append(8e3 * (0.1 - position) - 400.0 * velocity)
        force = np.clip(commands[-6], -50.0, 50.0)
        position += 1e-3 * velocity + 0.5e-6 * force / 0.7
        velocity += 1e-3 * force / 0.7
        positions.append(position)
        velocities.append(velocity)
    last, speed = np.array(positions[3000:]), np.array(velocities[2999:])
    assert got.limit_cycle_amplitude == pytest.approx(np.ptp(last) / 2, rel=0.1)
    turns = np.flatnonzero((speed[:-1] < 0) & (speed[1:] >= 0))
    frequency = 2 * np.pi * (len(turns) - 1) / ((turns[-1] - turns[0]) * 1e-3)
    assert got.limit_cycle_frequency == pytest.approx(frequency, rel=0.05)


@pytest.mark.exhaustive
def test_verdicts_of_the_four_kinds():
    stable = Drive(Controller(400.0, 20.0), Actuator(110.0, 0.9, 1e-3, force_limit=100.0))
    assert _evaluate(stable).verdict == Verdict.STABLE
    unstable = Drive(Controller(4e4, 20.0), Actuator(110.0, 0.9, 1e-3))
    got = _evaluate(unstable)
    assert got.verdict == Verdict.UNSTABLE and got.growth_rate > 0.0
    assert np.isnan(got.overshoot) and np.isnan(got.rms_force)
    limited = Drive(Controller(4e4, 20.0), Actuator(110.0, 0.9, 1e-3, force_limit=1e30))
    assert _evaluate(limited).verdict == Verdict.UNSTABLE
    invalid = Drive(Controller(jnp.nan, 20.0), Actuator(110.0, 0.9, 1e-3))
    assert _evaluate(invalid).verdict == Verdict.INVALID


def test_a_diverged_lane_does_not_touch_its_neighbours():
    options = drives.options(_delayed("command", 1e-3))

    @jax.jit
    def run(kp):
        def one(kp):
            drive = Drive(Controller(kp, 20.0), Actuator(110.0, 0.9, 1e-3))
            prepared = loop.prepare(Loop(Mass(0.7), drive), options)
            state = loop.init(prepared, options, 0.0, 0.0)
            return rollout.evaluate(
                prepared, options, RolloutOptions(400), state, Setpoint(0.1), growth_rate=kp
            )

        return jax.vmap(one)(kp)

    calm = run(jnp.array([100.0, 200.0, 300.0, 400.0]))
    wild = run(jnp.array([100.0, 1e9, jnp.nan, 400.0]))
    for name in metrics.Metrics.__dataclass_fields__:
        if name != "growth_rate":
            a, b = np.asarray(getattr(calm, name)), np.asarray(getattr(wild, name))
            np.testing.assert_array_equal(a[[0, 3]], b[[0, 3]], err_msg=name)


@pytest.mark.exhaustive
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_what_ends_early_gives_the_same_figures(noise):
    """A batch ends once its last loop is lost, and not before."""
    stiffness, ticks = np.geomspace(1e3, 1e8, 16, dtype=np.float32), 2000
    drive = replace(_delayed("command", 2e-3), sensor=Sensor(position_noise=noise))
    options = drives.options(drive)

    def one(kp, key, stops):
        own = replace(drive, controller=Controller(kp, 10.0))
        prepared = loop.prepare(Loop(Mass(0.7), own), options)
        state = loop.init(prepared, options, 0.0, 0.0)
        inputs = prepared, options, RolloutOptions(ticks, 4, stops=stops), state, Setpoint(0.1), key
        return rollout.run(*inputs)[2].lowest, rollout.evaluate(*inputs, growth_rate=kp)

    @functools.partial(jax.jit, static_argnums=1)
    def batch(kp, stops):
        keys = jax.random.split(jax.random.key(0), len(kp))
        return jax.vmap(lambda *each: one(*each, stops))(kp, keys)

    lost = np.isnan(batch(stiffness, False)[1].peak_force)
    assert lost[-8:].all() and not lost[0]
    for chosen, early in ((stiffness, False), (np.repeat(stiffness[-8:], 2), True)):
        whole, ended = batch(chosen, False), batch(chosen, True)
        jax.tree.map(np.testing.assert_array_equal, whole[1], ended[1])
        assert np.isposinf(ended[0][:, -1]).all() == early


@pytest.mark.exhaustive
def test_ticks_are_whole_segments():
    assert rollout.whole_ticks(2.0, 1e-3) == 2000
    assert rollout.whole_ticks(1e-9, 1e-3) == 4
    assert rollout.whole_ticks(0.0101, 1e-3) == 12
    with pytest.raises(ValueError, match="multiple of 4"):
        drive = _delayed("command", 0.0)
        options = drives.options(drive)
        prepared = loop.prepare(Loop(Mass(0.7), drive), options)
        state = loop.init(prepared, options, 0.0, 0.0)
        rollout.run(prepared, options, RolloutOptions(ticks=5), state, Setpoint(0.1))
