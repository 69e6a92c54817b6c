"""A joint with friction on uneven time stamps, against closed forms and the loop by itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxact.drive import step as drive_step
from jaxact.drive.actuator import Actuator
from jaxact.drive.controller import Controller, Setpoint
from jaxact.identification import joint_motion
from jaxact.identification.joint_motion import Structure
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
    return joint_motion.recording(
        time, setpoint=zero if setpoint is None else setpoint,
        command=zero if command is None else command, feedforward=zero, strength=zero + 1.0,
        position=zero + position, velocity=velocity, gains=(400.0, 20.0), command_limit=1e12,
        ticks_per_row=ticks, controlled=1,
    )  # fmt: skip


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


def test_dry_friction_that_is_not_overcome_holds_against_the_command():
    time = np.arange(ROWS) * PERIOD
    values = _values(wn=np.inf, zeta=1.0, delay=0.0, coulomb=5.0)
    held, _ = joint_motion.simulate(values, _recording(time, command=np.full(ROWS, 4.9)), OPEN)
    moved, _ = joint_motion.simulate(values, _recording(time, command=np.full(ROWS, 6.0)), OPEN)
    assert float(jnp.ptp(held)) < 1e-15
    np.testing.assert_allclose(moved, 0.5 * (6.0 - 5.0) / 0.7 * time**2, atol=1e-5)


def test_friction_that_differs_with_direction():
    there = _coasting(viscous=3.0, viscous_back=9.0)[1]
    np.testing.assert_allclose(there, _coasting(viscous=3.0)[1])
    time = np.arange(ROWS) * PERIOD
    values = _values(wn=np.inf, zeta=1.0, delay=0.0, viscous=3.0, viscous_back=9.0)
    back, _ = joint_motion.simulate(values, _recording(time, velocity=-2.0), OPEN)
    np.testing.assert_allclose(back, 2.0 * 0.7 / 9.0 * np.expm1(-9.0 / 0.7 * time), atol=1e-12)


def test_a_pendulum_keeps_its_energy_and_period():
    time = np.arange(4000) * PERIOD
    structure = Structure(closed=False, history=8, difference_ticks=0, gravity=True)
    values = _values(wn=np.inf, zeta=1.0, delay=0.0, gravity=6.9)
    # From the side of a small swing, whose period is 2 pi sqrt(J / G).
    recording = _recording(time, velocity=0.01)
    position = np.asarray(joint_motion.simulate(values, recording, structure)[0])
    natural = np.sqrt(6.9 / 0.7)
    np.testing.assert_allclose(position, 0.01 / natural * np.sin(natural * time), atol=2e-6)
