"""A policy slower than the controller: against a plain loop in NumPy, in every engine."""

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.simulation import single

MASS, KP, KD, WN, ZETA, RATE = 0.7, 400.0, 20.0, 110.0, 0.9, 500.0
SPECIFICATION = """
precision = "float64"
duration = 0.24
{options}
[parameters]
{mass}
actuator = "starleth"
delay = 0.004
control_rate = 500
setpoint = 0.1
{parameters}
[axes]
feedforward = [0.0]
"""
ARM = """<mujoco><option timestep="0.001"/><worldbody><body name="b">
<joint name="j" type="slide" axis="1 0 0" armature="0"/><inertial pos="0 0 0" mass="0.7"
diaginertia="1 1 1"/></body></worldbody>
<actuator><motor joint="j" ctrlrange="-9999 9999"/></actuator></mujoco>"""
SINE = (
    '[motion]\nkind = "sine"\nfrequency = 6.0\n[plant]\nmodel = "arm.xml"\nposture = "keyframe"\n'
)


def plain_loop(setpoints, every, late):
    """Positions, held setpoints and commands at the control ticks, exact between them.

    every: control ticks in a period of the policy
    late: delay of the setpoint in control ticks
    """
    flow = np.zeros((5, 5))
    flow[0, 1], flow[1, 2], flow[2, 3] = 1.0, 1.0 / MASS, 1.0
    flow[3, 2], flow[3, 3], flow[3, 4] = -(WN**2), -2.0 * ZETA * WN, WN**2
    step = scipy.linalg.expm(flow / RATE)
    state, commands, told = np.zeros(4), [0.0, 0.0], [0.0] * late
    positions, held, issued = [], [], []
    for tick, given in enumerate(setpoints):
        now = given if tick % every == 0 else held[-1]
        told.append(now)
        command = KP * (told[tick] - state[0]) - KD * state[1]
        commands.append(command)
        positions.append(state[0])
        held.append(now)
        issued.append(command)
        # The actuator's delay is two whole control periods.
        state = (step @ np.append(state, commands[-3]))[:4]
    return np.array(positions), np.array(held), np.array(issued)


def simulated(options="", parameters="", folder=None):
    mass = "" if "[plant]" in parameters else f"mass = {MASS}"  # the robot has its own
    text = SPECIFICATION.format(options=options, parameters=parameters, mass=mass)
    folder = folder or Path.cwd()
    path = folder / "loop.toml"
    path.write_text(text)
    return single.simulate(reading.load(path)).trajectory


@pytest.mark.exhaustive
@pytest.mark.parametrize("late", [0, 3])
def test_a_robots_moving_setpoint_is_held_as_in_a_plain_loop(tmp_path, late):
    (tmp_path / "arm.xml").write_text(ARM)
    time = np.arange(120) / RATE
    moving = 0.1 * np.sin(2.0 * np.pi * 6.0 * time)
    gains = f"kp = {KP}\nkd = {KD}\nsetpoint_delay = {late / RATE}\npolicy_rate = 50"
    positions, held, commands = plain_loop(moving, 10, late)
    tables = SINE.replace("[motion]", f"{gains}\n[motion]")
    for engine, substeps in (("mujoco", 2), ("mjx", 2)):
        run = simulated(f'engine = "{engine}"', tables, tmp_path)
        every = slice(None, None, substeps)
        np.testing.assert_allclose(run.setpoint[every, 0], held, atol=1e-12)
        # MuJoCo's steps are of first order; the commands show when the policy spoke.
        scale = np.abs(positions).max()
        assert np.abs(run.position[every, 0] - positions).max() < 0.05 * scale
        assert np.abs(run.command[every, 0] - commands).max() < 0.05 * np.abs(commands).max()


@pytest.mark.parametrize("engine", ["mujoco", "mjx"])
def test_a_robot_whose_setpoints_arrive_late_is_held_before_they_do(tmp_path, engine):
    """Its weight, 0.5 kg at 0.2 m, was held before the start: nothing moves."""
    path = tmp_path / "pendulum.xml"
    path.write_text(
        '<mujoco><option timestep="0.001"/><worldbody><body><joint name="j" axis="0 1 0"/>'
        '<inertial pos="0.2 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/></body></worldbody>'
        '<actuator><motor joint="j"/></actuator></mujoco>'
    )
    loop = jx.robot(path, kp=20.0, kd=0.5, wn=300.0, zeta=0.7, setpoint_delay=0.0043)
    run = jx.simulate(loop, setpoint=0.0, duration=0.2, engine=engine, precision="float64")
    np.testing.assert_allclose(run.command.values, -0.5 * 9.81 * 0.2, rtol=1e-9)
    assert np.abs(run.position.values).max() < 1e-9


@pytest.mark.exhaustive
def test_a_step_is_one_whatever_the_policy(tmp_path):
    """The first tick is the policy's too: the same bits as without one."""
    free = simulated(parameters=f"kp = {KP}\nkd = {KD}", folder=tmp_path)
    slow = simulated(parameters=f"kp = {KP}\nkd = {KD}\npolicy_rate = 50", folder=tmp_path)
    np.testing.assert_array_equal(free.position, slow.position)
    expected, _, _ = plain_loop(np.full(120, 0.1), 10, 0)
    np.testing.assert_allclose(slow.position[:, 0], expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("rate", "message"),
    [
        ("300", "policy_rate = 300 Hz does not divide the control rate 500 Hz; allowed e.g.: 250"),
        (
            "1000",
            "policy_rate = 1000 Hz does not divide the control rate 500 Hz; allowed e.g.: 500",
        ),
        ("0", "policy_rate = 0 is out of range"),
    ],
)
def test_a_rate_that_does_not_divide_is_refused(tmp_path, rate, message):
    with pytest.raises(UserError, match=message):
        simulated(parameters=f"policy_rate = {rate}", folder=tmp_path)
