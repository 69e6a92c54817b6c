"""The design's invariants of the drive, on the exact mass."""

import functools
from dataclasses import replace

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from quickly import compiled_fully as compiled_fully
from quickly import compiled_quickly as compiled_quickly
from scipy.linalg import expm

from jaxact.drive import step as drives
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.sensor import Sensor
from jaxact.drive.step import Drive, DriveOptions
from jaxact.loops import loop
from jaxact.loops.loop import Loop
from jaxact.plants.mass import Mass
from jaxact.simulation import rollout, trajectory
from jaxact.simulation.growth import rate as growth

BASE = Drive(Controller(400.0, 20.0), Actuator(300.0, 0.6, 2.3e-3))


_trajectory = jax.jit(trajectory.of_loop, static_argnums=(1, 2))


@functools.partial(jax.jit, static_argnums=1)
def _growth_rate(drive, options):
    prepared = loop.prepare(Loop(Mass(0.7), drive), options)
    state = loop.init(prepared, options, 0.0, 0.0)
    dense = growth.GrowthOptions(dense=True, dimension=12)
    return growth.growth_rate(prepared, options, state, Setpoint(0.0), dense)


def with_delays(command=0.0, measurement=0.0, output=0.0, setpoint=0.0, base=BASE):
    return replace(
        base,
        actuator=replace(base.actuator, delay=command),
        sensor=replace(base.sensor, delay=measurement),
        controller=replace(base.controller, setpoint_delay=setpoint),
        output_delay=output,
    )


def simulate(drive, *, mass=0.7, ticks=200, substeps=1, key=None, slots=None, **options):
    static = drives.options(drive, substeps=substeps, **options)
    if slots is not None:
        static = replace(static, **slots)
    path = _trajectory(Loop(Mass(mass), drive), static, ticks, Setpoint(0.1), key)
    return jax.tree.map(np.asarray, path)


@pytest.mark.exhaustive
@settings(max_examples=12)
@given(
    shares=st.tuples(*[st.floats(0.0, 1.0)] * 3),
    total=st.floats(1e-4, 8e-3),
    setpoint=st.floats(0.0, 5e-3),
)
def test_only_the_sum_of_the_three_delays_matters_for_stability(shares, total, setpoint):
    weight = np.array(shares) + 1e-9
    parts = map(float, total * weight / weight.sum())
    with jax.enable_x64(True):
        rates = []
        # lines long enough for every example, so that it compiles once
        options = DriveOptions(3, command_slots=9, measurement_slots=9, setpoint_slots=7)
        for drive in (with_delays(*parts, setpoint), with_delays(total)):
            rates.append(float(_growth_rate(drive, options)))
    assert rates[0] == pytest.approx(rates[1], rel=1e-6, abs=1e-2)


@pytest.mark.exhaustive
def test_delays_move_the_response_and_nothing_else():
    with jax.enable_x64(True):
        base = simulate(with_delays(3e-3), ticks=300)
        late = simulate(with_delays(3e-3, setpoint=4e-3), ticks=300)
        np.testing.assert_allclose(late.position[4:], base.position[:-4], atol=1e-15)
        # Without feedback the force is the same wherever the delay sits.
        open_loop = replace(BASE, controller=Controller(0.0, 0.0, feedforward=5.0))
        forces = [
            simulate(with_delays(*parts, base=open_loop), ticks=50).force
            for parts in ((2.7e-3, 0.0, 0.0), (0.0, 0.0, 2.7e-3), (1.2e-3, 9e-3, 1.5e-3))
        ]
        np.testing.assert_allclose(forces[1], forces[0], rtol=1e-12)
        np.testing.assert_allclose(forces[2], forces[0], rtol=1e-12)


@pytest.mark.exhaustive
def test_measurement_delay_is_exact_on_the_mass():
    """The delayed measurement against the same loop simulated with smaller physics steps."""
    with jax.enable_x64(True):
        drive = with_delays(1.1e-3, measurement=2.37e-3)
        coarse, fine = simulate(drive), simulate(drive, substeps=7)
        np.testing.assert_allclose(coarse.position, fine.position[::7], rtol=1e-10, atol=1e-14)


@pytest.mark.parametrize("substeps", [2, 5])
def test_physics_steps_compose(substeps):
    with jax.enable_x64(True):
        for delay in (0.0, 0.37e-3, 1e-3, 1.83e-3):
            one, many = (
                simulate(with_delays(delay), substeps=n, slots={"command_slots": 3})
                for n in (1, substeps)
            )
            np.testing.assert_allclose(
                many.position[::substeps], one.position, rtol=1e-11, atol=1e-15
            )
            mean = many.force.reshape(-1, substeps).mean(axis=1)
            np.testing.assert_allclose(mean, one.force, rtol=1e-10, atol=1e-12)


@pytest.mark.exhaustive
@pytest.mark.usefixtures("compiled_fully")
def test_switched_off_parts_leave_the_loop_bit_for_bit():
    plain = simulate(BASE)
    static = drives.options(BASE)
    everything = replace(
        static,
        sensor=replace(static.sensor, noise=True, walk=True, quantise=True),
        quantised_command=True,
        limited=True,
        rate_limited=True,
    )
    path = _trajectory(Loop(Mass(0.7), BASE), everything, 200, Setpoint(0.1), jax.random.key(1))
    for name in ("position", "velocity", "command", "force"):
        np.testing.assert_array_equal(getattr(path, name), getattr(plain, name))


@settings(max_examples=10)
@given(factor=st.floats(0.05, 50.0))
def test_scaling_mass_gains_and_limits_changes_nothing(factor):
    with jax.enable_x64(True):
        limited = replace(BASE, actuator=replace(BASE.actuator, force_limit=15.0))
        scaled = replace(
            limited,
            controller=Controller(400.0 * factor, 20.0 * factor),
            actuator=replace(limited.actuator, force_limit=15.0 * factor),
        )
        np.testing.assert_allclose(
            simulate(scaled, mass=0.7 * factor).position,
            simulate(limited).position,
            rtol=1e-10,
            atol=1e-14,
        )


@settings(max_examples=10)
@given(factor=st.floats(0.1, 10.0))
def test_scaling_time_changes_nothing(factor):
    slow = Drive(
        Controller(400.0 / factor**2, 20.0 / factor),
        Actuator(300.0 / factor, 0.6, 2.3e-3 * factor),
        control_period=1e-3 * factor,
    )
    with jax.enable_x64(True):
        np.testing.assert_allclose(
            simulate(slow).position, simulate(BASE).position, rtol=1e-9, atol=1e-14
        )


def test_a_fast_actuator_approaches_the_ideal_one():
    with jax.enable_x64(True):
        ideal = simulate(replace(BASE, actuator=Actuator(delay=2.3e-3)))
        errors = []
        for wn in (1e4, 1e5, 1e6):
            fast = simulate(replace(BASE, actuator=Actuator(wn, 0.7, 2.3e-3)))
            errors.append(float(np.max(np.abs(fast.position - ideal.position))))
        assert errors[0] > 5 * errors[1] > 25 * errors[2]
        assert errors[2] < 1e-5


def test_noise_has_the_stated_size_and_each_sample_its_own_draws():
    noisy = replace(
        BASE,
        controller=Controller(1.0, 0.0),
        sensor=Sensor(position_noise=1e-2, position_resolution=0.0),
        actuator=Actuator(),
    )
    # With a huge mass nothing moves and the command is the measurement.
    path = simulate(noisy, mass=1e9, ticks=4000, key=jax.random.key(3))
    sample = 0.1 - np.asarray(path.command)
    assert np.std(sample) == pytest.approx(1e-2, rel=0.05)
    assert abs(np.mean(sample)) < 1e-3
    again = simulate(noisy, mass=1e9, ticks=4000, key=jax.random.key(3))
    np.testing.assert_array_equal(again.command, path.command)
    other = simulate(noisy, mass=1e9, ticks=4000, key=jax.random.key(4))
    assert np.corrcoef(other.command, path.command)[0, 1] < 0.1


def test_bias_walks_with_the_square_root_of_time():
    walking = replace(
        BASE,
        controller=Controller(1.0, 0.0),
        sensor=Sensor(position_bias_walk=0.1),
        actuator=Actuator(),
    )
    options = drives.options(walking)

    def last(key):
        path = _trajectory(Loop(Mass(1e9), walking), options, 400, Setpoint(0.0), key)
        return path.command[-1]

    ends = jax.vmap(last)(jax.random.split(jax.random.key(0), 400))
    assert np.std(ends) == pytest.approx(0.1 * np.sqrt(0.4), rel=0.12)


def test_quantised_signals_are_multiples_of_their_step():
    coarse = replace(
        BASE,
        controller=replace(BASE.controller, command_resolution=0.5),
        sensor=Sensor(position_resolution=1e-3, velocity_resolution=1e-2),
    )
    path = simulate(coarse)
    np.testing.assert_allclose(np.mod(path.command + 0.25, 0.5), 0.25, atol=1e-4)
    difference = np.diff(np.unique(np.round(np.asarray(path.command) / 0.5)))
    assert np.all(difference >= 1.0)


@pytest.mark.parametrize("substeps", [1, 4])
def test_limits_hold_at_every_step(substeps):
    limited = replace(
        BASE,
        actuator=replace(
            BASE.actuator,
            force_limit=12.0,
            force_rate_limit=2000.0,
            stall_force=20.0,
            no_load_speed=1.0,
        ),
    )
    path = simulate(limited, substeps=substeps)
    force, velocity = np.asarray(path.force), np.asarray(path.velocity)
    assert np.max(np.abs(force)) <= 12.0 + 1e-5
    assert np.max(np.abs(np.diff(force))) <= 2000.0 * 1e-3 / substeps + 1e-4
    assert np.any(np.abs(force) > 5.0)
    line = 20.0 * (1.0 - velocity / 1.0)
    slack = 2000.0 * 1e-3 / substeps
    assert np.all(force <= np.maximum(line, 0.0) + slack)


@pytest.mark.parametrize("cutoff", [np.inf, 300.0])
def test_differenced_velocity_is_the_filtered_difference(cutoff):
    drive = replace(BASE, controller=Controller(0.0, 1.0), sensor=Sensor(velocity_filter=cutoff))
    with jax.enable_x64(True):
        options = drives.options(drive, differenced=True)
        path = _trajectory(Loop(Mass(0.7), drive), options, 50, Setpoint(0.0), velocity=0.3)
        position, command = np.asarray(path.position), np.asarray(path.command)
        estimate, gain = 0.3, 1.0 if np.isinf(cutoff) else 1.0 - np.exp(-cutoff * 1e-3)
        before = position[0] - 0.3 * 1e-3
        for q, u in zip(position, command, strict=True):
            estimate += gain * ((q - before) / 1e-3 - estimate)
            before = q
            assert u == pytest.approx(-estimate, abs=1e-13)


def _plain(drive, ticks, *, differenced, position, velocity, mass=0.7, setpoint=0.1):
    """The loop again, written out: commands of a plant that has come at a constant velocity."""
    (wn, zeta), sensor, period = (300.0, 0.6), drive.sensor, 1e-3
    matrix = np.zeros((5, 5))  # of position, velocity, force, its rate, and the command that acts
    matrix[0, 1], matrix[1, 2], matrix[2, 3] = 1.0, 1.0 / mass, 1.0
    matrix[3, 2:] = -wn * wn, -2.0 * zeta * wn, wn * wn
    advance, states = expm(matrix * period), [np.array([position, velocity, 0.0, 0.0, 0.0])]
    commands = []

    def seen(tick):
        """Position and velocity as they are measured at a tick, which may lie before time 0."""
        time = tick * period - sensor.delay
        if time <= 0.0:
            there, rate = position + velocity * time, velocity
        else:
            whole = min(int(time / period + 1e-9), len(commands) - 1)
            there, rate = (expm(matrix * (time - whole * period)) @ states[whole])[:2]
        there, count = there + sensor.position_bias, sensor.position_resolution
        return (np.round(there / count) * count if count else there), rate

    share = 1.0 - np.exp(-sensor.velocity_filter * period)
    estimate = velocity
    for tick in range(ticks):
        there, rate = seen(tick)
        if differenced:
            estimate += share * ((there - seen(tick - 1)[0]) / period - estimate)
            rate = estimate
        commands.append(400.0 * (setpoint - there) - 20.0 * rate)
        states[-1][4] = commands[-1]
        states.append(advance @ states[-1])
    return np.array(commands)


@pytest.mark.parametrize(
    "differenced, sensor",
    [
        (True, {}),
        (True, {"velocity_filter": 120.0}),
        (True, {"position_resolution": 1e-3, "position_bias": 3e-4}),
        (False, {"delay": 3e-3}),
        (False, {"delay": 2.3e-3}),
        (False, {"delay": 21.6e-3}),
        (True, {"delay": 2.6e-3, "velocity_filter": 120.0, "position_resolution": 1e-3}),
    ],
)
def test_a_loop_has_come_to_its_start_at_the_velocity_that_it_starts_with(differenced, sensor):
    drive = replace(BASE, actuator=replace(BASE.actuator, delay=0.0), sensor=Sensor(**sensor))
    start = {"position": 0.0324, "velocity": -0.83}
    with jax.enable_x64(True):
        options = drives.options(drive, substeps=2, differenced=differenced)
        path = _trajectory(Loop(Mass(0.7), drive), options, 40, Setpoint(0.1), **start)
        found = np.asarray(path.command)[::2]
    np.testing.assert_allclose(
        found, _plain(drive, 40, differenced=differenced, **start), rtol=1e-9
    )


def test_options_refuse_nonsense():
    with pytest.raises(ValueError, match="substeps"):
        drives.options(BASE, substeps=0)
    noisy = replace(BASE, sensor=Sensor(position_noise=1e-3))
    options = drives.options(noisy)

    def run_without_a_key():
        prepared = loop.prepare(Loop(Mass(0.7), noisy), options)
        state = loop.init(prepared, options, 0.0, 0.0)
        return rollout.run(prepared, options, rollout.RolloutOptions(ticks=4), state, Setpoint(0.1))

    with pytest.raises(ValueError, match="random key"):
        jax.eval_shape(run_without_a_key)
