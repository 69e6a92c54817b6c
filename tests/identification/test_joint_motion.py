"""A joint with friction on uneven time stamps, against closed forms and the loop by itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from scipy.integrate import solve_ivp

from jaxact.drive import step as drive_step
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.identification import joint_motion
from jaxact.identification.joint_motion import Structure
from jaxact.identification.recording import of_rows
from jaxact.loops import loop as loops
from jaxact.plants.mass import Mass

ROWS = 200
PERIOD = 1e-3


@pytest.fixture(scope="module", autouse=True)
def double():
    with jax.enable_x64(True):
        yield


def _values(**changes):
    return {
        "inertia": 0.7, "gain": 1.0, "wn": 110.0, "zeta": 0.9, "delay": 2.3e-3, "force_limit": 1e9,
        "viscous": 0.0, "coulomb": 0.0, "gravity": 0.0, "zero": 0.0, "offset": 0.0, **changes,
    }  # fmt: skip


def _recording(time, *, command=None, setpoint=None, position=0.0, velocity=0.0, ticks=1):
    zero = np.zeros(len(time))
    return of_rows(
        time, setpoint=zero if setpoint is None else setpoint,
        command=zero if command is None else command, feedforward=zero, strength=zero + 1.0,
        position=zero + position, velocity=velocity, gains=(400.0, 20.0), command_limit=1e12,
        ticks_per_row=ticks, controlled=1,
    )  # fmt: skip


@pytest.mark.exhaustive
def test_without_friction_it_is_the_loop_of_the_drive_step():
    setpoint = np.repeat(np.random.default_rng(1).normal(size=ROWS // 5), 5)
    drive = drive_step.Drive(
        Controller(400.0, 20.0), Actuator(110.0, 0.9, 2.3e-3), control_period=PERIOD
    )
    options = drive_step.options(drive)
    prepared = loops.prepare(loops.Loop(Mass(0.7), drive), options)
    state = loops.init(prepared, options, jnp.zeros(()), jnp.zeros(()))

    def advance(state, at):
        state, (output, _) = loops.step(prepared, options, state, Setpoint(at))
        return state, (output.position_before, output.command)

    _, expected = jax.lax.scan(advance, state, jnp.asarray(setpoint))
    structure = Structure(closed=True, history=8, difference_ticks=0, gravity=False)
    recording = _recording(np.arange(ROWS) * PERIOD, setpoint=setpoint)
    found = joint_motion.simulate(_values(), recording, structure)
    np.testing.assert_allclose(found[0], expected[0], atol=1e-12)
    np.testing.assert_allclose(found[1], expected[1], atol=1e-8)


OPEN = Structure(closed=False, history=8, difference_ticks=0, gravity=False)


def _coasting(**changes):
    time = np.cumsum(np.random.default_rng(2).uniform(0.5e-3, 1.5e-3, ROWS))
    values = _values(wn=np.inf, zeta=1.0, delay=0.0, **changes)
    position, _ = joint_motion.simulate(values, _recording(time, velocity=2.0), OPEN)
    return time - time[0], np.asarray(position)


@pytest.mark.exhaustive
def test_viscous_friction_slows_exponentially():
    time, position = _coasting(viscous=3.0)
    expected = 2.0 * 0.7 / 3.0 * -np.expm1(-3.0 / 0.7 * time)
    np.testing.assert_allclose(position, expected, atol=1e-12)


def test_dry_friction_stops_a_joint_and_holds_it():
    time, position = _coasting(coulomb=14.0)
    end = 2.0 * 0.7 / 14.0  # it stands after v / (F / m)
    moving = np.minimum(time, end)
    np.testing.assert_allclose(position, 2.0 * moving - 0.5 * 20.0 * moving**2, atol=3e-5)
    assert time[-1] > 1.5 * end and np.ptp(position[time > 1.05 * end]) < 1e-15


def test_a_joint_that_is_pushed_back_turns_within_a_step():
    time = np.arange(ROWS) * PERIOD
    values = _values(wn=np.inf, zeta=1.0, delay=0.0, coulomb=14.0)
    pushed = _recording(time, command=np.full(ROWS, -20.0), velocity=2.0)
    position, _ = joint_motion.simulate(values, pushed, OPEN)
    stop = 2.0 * 0.7 / (20.0 + 14.0)
    there = np.minimum(time, stop)
    back = np.maximum(time - stop, 0.0)
    expected = 2.0 * there - 0.5 * 34.0 / 0.7 * there**2 - 0.5 * 6.0 / 0.7 * back**2
    assert (stop / PERIOD) % 1.0 > 0.05  # it does not stop at a row
    np.testing.assert_allclose(position, expected, atol=1e-12)


def test_dry_friction_that_is_not_overcome_holds_against_the_command():
    time = np.arange(ROWS) * PERIOD
    values = _values(wn=np.inf, zeta=1.0, delay=0.0, coulomb=5.0)
    held, _ = joint_motion.simulate(values, _recording(time, command=np.full(ROWS, 4.9)), OPEN)
    moved, _ = joint_motion.simulate(values, _recording(time, command=np.full(ROWS, 6.0)), OPEN)
    assert float(jnp.ptp(held)) < 1e-15
    np.testing.assert_allclose(moved, 0.5 * (6.0 - 5.0) / 0.7 * time**2, atol=1e-5)


def test_a_log_that_begins_in_motion_begins_with_the_force_of_its_drive():
    time = np.arange(ROWS) * PERIOD
    values = _values(wn=50.0, zeta=1.0, delay=0.0, initial_force=3.0)
    position, _ = joint_motion.simulate(values, _recording(time), OPEN)
    # A critically damped drive, left alone: f = 3 (1 + 50 t) exp(-50 t).
    w = 50.0
    fallen = (w * time + 3.0) * np.exp(-w * time) + 2.0 * w * time - 3.0
    np.testing.assert_allclose(position, 3.0 / 0.7 / w**2 * fallen, atol=1e-12)


def test_friction_that_differs_with_direction():
    there = _coasting(viscous=3.0, viscous_back=9.0)[1]
    np.testing.assert_allclose(there, _coasting(viscous=3.0)[1])
    time = np.arange(ROWS) * PERIOD
    values = _values(wn=np.inf, zeta=1.0, delay=0.0, viscous=3.0, viscous_back=9.0)
    back, _ = joint_motion.simulate(values, _recording(time, velocity=-2.0), OPEN)
    np.testing.assert_allclose(back, 2.0 * 0.7 / 9.0 * np.expm1(-9.0 / 0.7 * time), atol=1e-12)


@pytest.mark.exhaustive
def test_a_pendulum_keeps_its_energy_and_period():
    time = np.arange(4000) * PERIOD
    structure = Structure(closed=False, history=8, difference_ticks=0, gravity=True)
    values = _values(wn=np.inf, zeta=1.0, delay=0.0, gravity=6.9)
    # From the side of a small swing, whose period is 2 pi sqrt(J / G).
    recording = _recording(time, velocity=0.01)
    position = np.asarray(joint_motion.simulate(values, recording, structure)[0])
    natural = np.sqrt(6.9 / 0.7)
    np.testing.assert_allclose(position, 0.01 / natural * np.sin(natural * time), atol=2e-6)


def _exact(time, command, values):
    """Angles at each row by SciPy: it slides until it rests, and sticks until it is pushed off.

    The drive's command changes at known instants, between which everything is smooth.
    """
    wn, zeta, weight, inertia = (values[name] for name in ("wn", "zeta", "gravity", "inertia"))

    def dry(speed):
        slow = np.exp(-((speed / values["stribeck_speed"]) ** 2))
        return values["coulomb"] * (1.0 + values["stribeck"] * slow)

    def flow(_, state, told, way):
        angle, speed, force, rate = state
        pushed = force - weight * np.sin(angle) - values["viscous"] * speed - way * dry(speed)
        fall = wn**2 * (told - force) - 2.0 * zeta * wn * rate
        return [speed, pushed / inertia if way else 0.0, rate, fall]

    def rests(_, state, told, way):
        return way * state[1] if way else dry(0.0) - abs(state[2] - weight * np.sin(state[0]))

    rests.terminal, rests.direction = True, -1
    changes = np.union1d(time + values["delay"], time)
    state, way, now, found = np.zeros(4), 0, 0.0, {0.0: 0.0}
    for until in changes[changes > 0.0]:
        at = np.searchsorted(time + values["delay"], now + 1e-9) - 1
        told = command[max(at, 0)]
        while until - now > 1e-12:
            if way == 0 and rests(0.0, state, told, 0) <= 0.0:
                way = int(np.sign(state[2] - weight * np.sin(state[0])))
            span, given = (now, until), {"args": (told, way), "rtol": 1e-10, "atol": 1e-13}
            if way and state[1] == 0.0:  # it moves off before it can come to rest
                span = (now, min(now + 1e-7, until))
            solved = solve_ivp(flow, span, state, events=rests, **given)
            now, state = solved.t[-1], solved.y[:, -1]
            if solved.t_events[0].size and way:
                state[1], way = 0.0, 0
        found[until] = state[0]
    return np.array([found[at] for at in time])


@pytest.mark.exhaustive
def test_a_joint_that_sticks_and_slips_on_a_pendulum_is_followed_in_long_steps():
    time = 2e-3 * np.arange(300)
    command = np.repeat(np.random.default_rng(0).choice([-0.35, 0.0, 0.35], 10), 30)
    command[:3] = 0.0
    values = _values(
        inertia=0.02, wn=150.0, zeta=0.6, delay=2.7e-3, viscous=0.01, coulomb=0.12,
        gravity=0.5, stribeck=0.4, stribeck_speed=0.3,
    )  # fmt: skip
    structure = Structure(closed=False, history=8, difference_ticks=0, gravity=True)
    exact = _exact(time, command, values)
    found = joint_motion.simulate(values, _recording(time, command=command), structure)[0]
    sticks = np.abs(np.diff(exact[10:])) < 1e-12
    assert np.ptp(exact) > 0.5 and 10 < sticks.sum() < 100
    np.testing.assert_allclose(found, exact, atol=1e-5)


LOADED = {"loaded": 0.2, "stribeck": 0.4, "stribeck_speed": 0.5}
NAMES = ("inertia", "gain", "wn", "zeta", "delay", "viscous", "coulomb", "gravity", "loaded")


@pytest.fixture(scope="module")
def swinging():
    """Positions by the numbers in `NAMES`, and their derivatives, of a loop with friction."""
    structure = Structure(closed=True, history=8, difference_ticks=2, gravity=True)
    time = np.arange(ROWS) * 2.0**-10  # so that ticks and delays add up without rounding
    setpoint = 0.5 * np.repeat(np.random.default_rng(4).choice([-1.0, 1.0], ROWS // 10), 10)
    recording = _recording(time, setpoint=setpoint)

    def position(point):
        values = _values(viscous=0.5, gravity=2.0, **LOADED)
        given = values | dict(zip(NAMES, point, strict=True))
        return joint_motion.simulate(given, recording, structure)[0]

    return jax.jit(position), jax.jit(jax.jacfwd(position))


@pytest.mark.exhaustive
@pytest.mark.parametrize("drive", [(110.0, 0.9), (800.0, 0.45), (4e4, 100.0)])
def test_derivatives_are_central_differences_inside_a_tick(swinging, drive):
    position, slopes = swinging
    point = np.array([0.7, 1.1, *drive, 2.3e-3, 0.5, 0.3, 2.0, 0.2])
    exact = np.asarray(slopes(point))
    for index, name in enumerate(NAMES):
        step = 1e-6 * point[index] * np.eye(len(point))[index]
        measured = (position(point + step) - position(point - step)) / (2.0 * step[index])
        scale = np.max(np.abs(exact[:, index]))
        np.testing.assert_allclose(
            exact[:, index] / scale, measured / scale, atol=1e-6, err_msg=name
        )


@pytest.mark.exhaustive
def test_at_a_tick_the_delay_has_its_derivative_from_either_side(swinging):
    position, slopes = swinging
    tick, near, step, index = 2.0**-9, 2.0**-40, 2.0**-27, NAMES.index("delay")

    def at(delay):
        return np.array([0.7, 1.1, 800.0, 0.45, delay, 0.5, 0.3, 2.0, 0.2])

    there = position(at(tick))
    after = (-3.0 * there + 4.0 * position(at(tick + step)) - position(at(tick + 2.0 * step))) / (
        2.0 * step
    )
    before = (3.0 * there - 4.0 * position(at(tick - step)) + position(at(tick - 2.0 * step))) / (
        2.0 * step
    )
    scale = np.max(np.abs(after))
    for delay, measured in ((tick, after), (tick + near, after), (tick - near, before)):
        exact = np.asarray(slopes(at(delay)))[:, index]
        np.testing.assert_allclose(exact / scale, measured / scale, atol=1e-5)
    assert np.max(np.abs(after - before)) > 1e-4 * scale
