"""Limits of the force, against closed forms and an independent integration in small steps."""

import functools
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.drive import step as drives
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.drive.sensor import Sensor
from jaxact.drive.step import Drive
from jaxact.loops.loop import Loop
from jaxact.plants.mass import Mass
from jaxact.simulation import trajectory

SLEWING = Drive(Controller(1654.0, 76.95), Actuator(force_rate_limit=2054.5))
FAST = 200  # steps of the reference in a control period
HYQ, STARLETH = {"natural_frequency": 800.0, "damping_ratio": 0.45}, {
    "natural_frequency": 110.0, "damping_ratio": 0.9,
}  # fmt: skip
LINE = {"stall_force": 25.0, "no_load_speed": 0.8}
CASES = {
    "rate limit": {"force_rate_limit": 1500.0},
    "rate limit and delay": {"force_rate_limit": 1500.0, "delay": 2.4e-3},
    "line": LINE,
    "line and force limit": {**LINE, "force_limit": 18.0},
    "line and rate limit": {**LINE, "force_rate_limit": 3000.0},
    "all": {**LINE, "force_limit": 20.0, "force_rate_limit": 3000.0, "delay": 1.3e-3},
}


@functools.partial(jax.jit, static_argnums=(1, 2))
def _path(loop, options, ticks):
    return trajectory.of_loop(loop, options, ticks, Setpoint(0.1))


def simulate(drive, plant, ticks, substeps=1):
    """Trajectory at the control ticks: position and velocity, shape (ticks, 2)."""
    path = _path(Loop(plant, drive), drives.options(drive, substeps=substeps), ticks)
    return np.stack([path.position[::substeps], path.velocity[::substeps]], axis=-1)


def reference(drive, plant, ticks, fast=FAST):
    """The same by the midpoint rule in small steps, the rate limit as a differential equation."""
    own, gains, period = drive.actuator, drive.controller, float(drive.control_period)
    h, m = period / fast, plant.mass
    c, k = plant.damping or 0.0, plant.stiffness or 0.0
    delay, late = (round(float(time) / h) for time in (own.delay, drive.sensor.delay))
    wn, zeta, q, v, f, g, a = own.natural_frequency, own.damping_ratio, 0.0, 0.0, 0.0, 0.0, 0.0
    commands, seen, rows = [0.0] * delay, [(q, v)] * late, []

    def bounded(force, v):
        line = own.stall_force / own.no_load_speed if np.isfinite(own.stall_force) else 0.0
        high = max(min(own.stall_force - line * v, own.force_limit), 0.0)
        return max(min(force, high), min(max(-own.stall_force - line * v, -own.force_limit), 0.0))

    for n in range(ticks * fast):
        seen.append((q, v))
        if n % fast == 0:
            rows.append((q, v))
            there = seen[n]
            command = gains.kp * (0.1 - there[0]) - gains.kd * there[1]
        commands.append(command)
        u = commands[n]
        if np.isinf(wn):
            half = f = u
        else:
            half, rate = f + 0.5 * h * g, g + 0.5 * h * (wn * wn * (u - f) - 2 * zeta * wn * g)
            f, g = f + h * rate, g + h * (wn * wn * (u - half) - 2 * zeta * wn * rate)
        # force at the middle of the step, and then at its end
        if np.isinf(own.force_rate_limit):
            middle = bounded(half, v + 0.5 * h * (bounded(half, v) - c * v - k * q) / m)
        else:
            reach = own.force_rate_limit * h
            target = bounded(f, v + h * (a - c * v - k * q) / m)
            middle, a = a, a + np.clip(target - a, -reach, reach)
            middle = 0.5 * (middle + a)
        mid_q, mid_v = q + 0.5 * h * v, v + 0.5 * h * (middle - c * v - k * q) / m
        q, v = q + h * mid_v, v + h * (middle - c * mid_v - k * mid_q) / m
    return np.array(rows)


def wrong(found, expected):
    """Largest error by the largest value, of positions and velocities; shape (2,)."""
    return np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0)


@pytest.mark.exhaustive
def test_an_ideal_actuator_behind_a_rate_limit_is_exact():
    """One physics step in a control period or many, with a delay that ends within one."""
    with jax.enable_x64(True):
        for delay, late in ((0.0, 0.0), (2.4e-3, 0.0), (0.0, 1.7e-3)):
            own = replace(SLEWING.actuator, delay=delay)
            drive = replace(SLEWING, actuator=own, sensor=Sensor(delay=late))
            one, many = (simulate(drive, Mass(0.7), 40, n) for n in (1, 4))
            np.testing.assert_allclose(one, many, rtol=1e-9, atol=1e-12)
            # the reference takes its steps' ends for their middles where the force turns
            assert (wrong(one, reference(drive, Mass(0.7), 40)) < 1e-4).all()


def test_a_slewing_force_moves_a_mass_along_a_cubic():
    held = Drive(Controller(0.0, 0.0, feedforward=1e3), Actuator(force_rate_limit=700.0))
    time = 1e-3 * np.arange(50)
    for x64, near in ((True, 1e-12), (False, 1e-5)):
        with jax.enable_x64(x64):
            found = simulate(held, Mass(0.7), 50)
        np.testing.assert_allclose(found[:, 0], 1e3 * time**3 / 6, rtol=near, atol=1e-12)
        np.testing.assert_allclose(found[:, 1], 1e3 * time**2 / 2, rtol=near, atol=1e-12)


@pytest.mark.parametrize("joint", [Mass(0.7), Mass(0.7, 12.0)], ids=["bare", "damped"])
def test_a_joint_on_its_line_approaches_its_speed_exactly(joint):
    """m v' + c v = F (1 - v / v0), whatever the step."""
    own = Actuator(stall_force=100.0, no_load_speed=1.0)
    held = Drive(Controller(0.0, 0.0, feedforward=1e6), own, control_period=1e-2)
    time, c = 1e-2 * np.arange(40), joint.damping or 0.0
    with jax.enable_x64(True):
        found = simulate(held, joint, 40)
    expected = 100.0 / (100.0 + c) * -np.expm1(-time * (100.0 + c) / 0.7)
    np.testing.assert_allclose(found[:, 1], expected, rtol=1e-9 if c == 0.0 else 2e-2, atol=1e-12)


@pytest.mark.exhaustive
def test_a_line_is_as_steep_for_a_step_as_it_is_for_many():
    """Speeds from beyond the no-load speed to braking, with a spring in the way."""
    own = Actuator(stall_force=40.0, no_load_speed=0.8)
    errors = []
    with jax.enable_x64(True):
        for force in (-1e3, 1e3):
            held = Drive(Controller(0.0, 0.0, feedforward=force), own, control_period=2e-3)
            drive = replace(held, controller=replace(held.controller, feedforward=force))
            plant = Mass(0.7, 1.0, 60.0)
            fine = simulate(drive, plant, 60, 64)
            errors += [[wrong(simulate(drive, plant, 60, n), fine).max() for n in (1, 2, 4)]]
    for one, two, four in errors:
        assert one < 5e-3 and one > 3 * two > 9 * four


@pytest.mark.exhaustive
@pytest.mark.parametrize("case", ["rate limit", "line and rate limit"])
def test_a_limit_behind_an_actuator_is_of_second_order(case):
    drive = Drive(Controller(400.0, 20.0), Actuator(**HYQ, **CASES[case]))
    with jax.enable_x64(True):
        expected = simulate(drive, Mass(0.7), 100, 128)
        errors = [wrong(simulate(drive, Mass(0.7), 100, n), expected).max() for n in (1, 4, 16)]
    assert errors[0] < 3e-2 and errors[1] < 4e-3 and errors[2] < 5e-4


@pytest.mark.exhaustive
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("actuator", [{}, HYQ, STARLETH], ids=["ideal", "hyq", "starleth"])
@pytest.mark.parametrize("plant", [Mass(0.7), Mass(0.7, 3.0, -40.0)], ids=["bare", "sprung"])
def test_limits_are_those_of_an_integration_in_small_steps(plant, actuator, case):
    late = Sensor(delay=1.7e-3) if case == "all" else Sensor()
    drive = Drive(Controller(400.0, 20.0), Actuator(**actuator, **CASES[case]), late)
    with jax.enable_x64(True):
        found = simulate(drive, plant, 200, 4)
    assert (wrong(found, reference(drive, plant, 200)) < 5e-3).all()


@pytest.mark.exhaustive
def test_what_was_held_for_ever_was_held_within_the_limits():
    """A joint that does not move: the force falls from its limit, and not from the command."""
    loop = jx.joint(mass=1e9, kp=0.0, kd=0.0, force_limit=2.5, force_rate_limit=50.0)
    drive = jx.drive_around(
        lambda state, force: (*state[:2], force), loop, measure=lambda state: state[:2],
        physics_step=1e-3,
    )  # fmt: skip
    zero, forces = jnp.zeros(()), []
    state = drive.init((zero, zero, zero), command=10.0)
    for _ in range(3):
        state, _ = drive.step(state, 0.0)
        forces.append(float(state.simulator[2]))
    np.testing.assert_allclose(forces, 2.5 - 0.05 * (np.arange(3) + 0.5), rtol=1e-5)


def _forces(drive, substeps, commands):
    """The mean force of every physics step under a command [N] for each control period."""

    def step(seen, force):
        number, forces = seen
        return number + 1, forces.at[number].set(force)

    around = jx.drive_around(
        step, drive, measure=lambda seen: (jnp.zeros(()), jnp.zeros(())),
        physics_step=0.01 / substeps,
    )  # fmt: skip
    state = around.init((0, jnp.zeros(substeps * len(commands))))
    state, _ = jax.lax.scan(around.step, state, commands)
    return state.simulator[1]


@pytest.mark.parametrize("substeps", [1, pytest.param(4, marks=pytest.mark.exhaustive)])
def test_no_mean_is_beyond_the_limit_or_changes_faster_than_the_rate_limit(substeps):
    """Which those of a bounded force that changes no faster cannot be, however long the step."""
    random = np.random.default_rng(0)
    for limit, rate, wn in ((15.0, 400.0, 800.0), (15.0, 3000.0, 200.0), (6.0, 900.0, 300.0)):
        loop = jx.joint(
            kp=1.0, kd=0.0, control_rate=100.0, wn=wn, zeta=0.3, delay=3.7e-3,
            force_limit=limit, force_rate_limit=rate,
        )  # fmt: skip
        with jax.enable_x64(True):
            commands = jnp.asarray(random.uniform(-3.0 * limit, 3.0 * limit, 200))
            forces = np.asarray(_forces(loop, substeps, commands))
        assert np.abs(forces).max() <= limit * (1.0 + 1e-12)
        steps = np.abs(np.diff(forces))
        assert steps.max() <= rate * 0.01 / substeps * (1.0 + 1e-12)
        assert steps.max() > 0.5 * min(rate * 0.01 / substeps, limit)


def test_a_command_that_arrives_within_a_step_slews_from_then_on():
    """Beyond the force limit, too: 6 ms at 400 N/s have a mean of 0.72 N over the step."""
    loop = jx.joint(
        kp=1.0, kd=0.0, control_rate=100.0, delay=4e-3, force_limit=10.0, force_rate_limit=400.0
    )
    with jax.enable_x64(True):
        forces = np.asarray(_forces(loop, 1, jnp.full(5, 60.0)))
    np.testing.assert_allclose(forces, [0.72, 4.4, 0.9 * 8.2 + 0.1 * 10.0, 10.0, 10.0], rtol=1e-12)


@pytest.mark.parametrize("substeps", [5, pytest.param(20, marks=pytest.mark.exhaustive)])
def test_a_force_that_an_actuator_builds_up_slews_from_when_it_begins(substeps):
    """As it must: 3000 N/s are reached 8 us after the command has arrived at the actuator."""
    loop = jx.joint(
        kp=1.0, kd=0.0, control_rate=100.0, wn=800.0, zeta=0.45, delay=2.3e-3,
        force_rate_limit=3000.0,
    )  # fmt: skip
    with jax.enable_x64(True):
        forces = np.asarray(_forces(loop, substeps, jnp.full(1, 600.0)))
    ends = 0.01 / substeps * np.arange(substeps + 1)
    ramp = 0.5 * 3000.0 * np.maximum(ends - 2.3e-3, 0.0) ** 2  # its integral
    np.testing.assert_allclose(forces, np.diff(ramp) * substeps / 0.01, atol=3000.0 * 2e-5)


def test_a_past_setpoint_is_what_reaches_a_drive_with_a_setpoint_delay():
    loop = jx.joint(mass=1e9, kp=20.0, kd=0.0, setpoint_delay=2.5e-3)
    drive = jx.drive_around(
        lambda state, force: (*state[:2], force), loop, measure=lambda state: state[:2],
        physics_step=1e-3,
    )  # fmt: skip
    zero = jnp.zeros(())
    for past, expected in ((None, [0, 0, 5, 10]), (0.5, [10] * 4), (0.3, [6, 6, 8, 10])):
        state, forces = drive.init((zero, zero, zero), command=1.0, setpoint=past), []
        for _ in range(4):
            state, _ = drive.step(state, 0.5)
            forces.append(float(state.simulator[2]))
        np.testing.assert_allclose(forces, expected, rtol=1e-5, atol=1e-6)


def test_a_rate_limit_that_is_never_reached_changes_nothing():
    for own in ({}, HYQ, STARLETH):
        free = Drive(Controller(400.0, 20.0), Actuator(**own, delay=1.3e-3))
        far = replace(free, actuator=replace(free.actuator, force_rate_limit=1e13))
        with jax.enable_x64(True):
            found, expected = (simulate(drive, Mass(0.7, 3.0), 80) for drive in (far, free))
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)


def test_fast_actuators_behind_a_rate_limit_approach_the_ideal_one():
    with jax.enable_x64(True):
        ideal = simulate(SLEWING, Mass(0.7), 60)
        for wn, near in ((1e4, 2e-2), (1e6, 2e-4)):
            own = Actuator(wn, 0.8, force_rate_limit=2054.5)
            found = simulate(replace(SLEWING, actuator=own), Mass(0.7), 60)
            assert (wrong(found, ideal) < near).all()


@pytest.mark.exhaustive
def test_limits_have_derivatives():
    @jax.jit
    def last(limits):
        own = Actuator(300.0, 0.7, 1.3e-3, 20.0, *limits)
        loop = Loop(Mass(0.7), Drive(Controller(400.0, 20.0), own))
        return _path(loop, drives.options(given), 40).position[-1]

    given = Drive(Controller(400.0, 20.0), Actuator(300.0, 0.7, 1.3e-3, 20.0, 3e3, 25.0, 0.8))
    at = jnp.array([3e3, 25.0, 0.8])
    with jax.enable_x64(True):
        at = jnp.asarray(np.asarray(at), float)
        exact = jax.jacfwd(last)(at)
        for i, own in enumerate(1e-4 * np.diag(np.asarray(at))):
            assert float(exact[i]) == pytest.approx(
                float(last(at + own) - last(at - own)) / (2e-4 * float(at[i])), rel=2e-2, abs=1e-9
            )


@pytest.mark.exhaustive
def test_a_loop_that_slews_too_slowly_is_unstable_by_default():
    """What was said to be stable while a limit acted on the mean of a whole step."""
    for unit in ({"mass": 0.7}, {"inertia": 0.7}):
        loop = jx.joint(**unit, kp=[1654.0, 1076.0], kd=[76.95, 43.91],
                        force_rate_limit=[2054.5, 1391.5])  # fmt: skip
        run = jx.simulate(loop, setpoint=0.1, duration=1.5)
        assert (run.verdict.values == jx.Verdict.UNSTABLE).all()
        assert run.sizes["time"] == 1500


@pytest.mark.exhaustive
def test_no_joint_is_faster_than_its_no_load_speed_by_default():
    loop = jx.joint(mass=[0.7, 1.0], kp=[400, 800], kd=[20, 45.17], stall_force=[100, 106.6],
                    no_load_speed=[1.0, 0.206], control_rate=[100, 50])  # fmt: skip
    for one, most in ((loop[0], 1.0), (loop[1], 0.206)):
        run = jx.simulate(one, setpoint=1.0, duration=0.3)
        assert float(run.velocity.max()) == pytest.approx(most, rel=1e-3)
        assert float(run.velocity.max()) <= 1.01 * most


def by_hand(drive, mass, ticks, damping=0.0):
    """A mass under an ideal drive, each command limited by itself; exact. (ticks, 2), forces."""
    from scipy.linalg import expm

    gains, own, T = drive.controller, drive.actuator, float(drive.control_period)
    late = own.delay % T
    whole, low, high = int(own.delay // T), own.lowest_force, own.highest_force
    low, high = (-own.force_limit, own.force_limit) if low is None else (low, high)
    state, rows, forces = np.zeros(2), [], []
    commands = [0.0] * (whole + 2)

    def moved(state, force, time):
        A = np.array([[0.0, 1.0, 0.0], [0.0, -damping / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
        return (expm(A * time) @ [*state, force])[:2]

    for _ in range(ticks):
        rows.append(state)
        commands = [gains.kp * (0.1 - state[0]) - gains.kd * state[1], *commands[:-1]]
        older, newer = np.clip(commands[whole + 1], low, high), np.clip(commands[whole], low, high)
        forces.append((late * older + (T - late) * newer) / T)
        state = moved(moved(state, older, late), newer, T - late)
    return np.array(rows), np.array(forces)


@pytest.mark.parametrize(
    "limits",
    ({"force_limit": 10.0}, {"force_limit": 20.0, "lowest_force": -4.0, "highest_force": 15.0}),
)
@pytest.mark.parametrize("delay", (0.3e-3, 1.4e-3))
def test_each_command_of_an_ideal_actuator_is_limited_by_itself(limits, delay):
    """Gains that turn the command round from tick to tick; the mean of both is no measure."""
    drive = Drive(Controller(400.0, 3000.0), Actuator(delay=delay, **limits))
    expected, forces = by_hand(drive, 0.7, 25)
    assert np.abs(np.diff(forces)).max() > 3.0
    with jax.enable_x64(True):
        for substeps in (1, 3):
            found = simulate(drive, Mass(0.7), 25, substeps)
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@pytest.mark.exhaustive
def test_so_it_is_of_a_joint_with_damping_and_in_every_result():
    drive = Drive(Controller(400.0, 3000.0), Actuator(delay=0.3e-3, force_limit=10.0))
    expected, forces = by_hand(drive, 0.7, 1000, damping=5.0)
    with jax.enable_x64(True):
        found = simulate(drive, Mass(0.7, damping=jnp.float64(5.0)), 1000)
        np.testing.assert_allclose(found[:100], expected[:100], rtol=0, atol=1e-10)
    loop = jx.joint(
        mass=0.7,
        joint_damping=5.0,
        kp=400,
        kd=3000,
        delay=0.3e-3,
        force_limit=10,
        control_rate=1000,
    )
    run = jx.simulate(loop, setpoint=0.1, duration=1.0)
    rms = float(np.sqrt(np.mean(forces**2)))
    assert float(run.rms_force) == pytest.approx(rms, rel=1e-2)  # it is chaotic
