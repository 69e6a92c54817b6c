"""Actuators of other kinds that a drive takes over in an environment, against plain MuJoCo."""

import mujoco
import numpy as np
import pytest

from jaxact.environments import actuators, environment_drive
from jaxact.errors import UserError

BODY = '<body><joint name="hip" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.2"/></body>'
# Servos and motors, and the force at the joint that MuJoCo gives them at rest for a control of 0.3.
SERVOS = {
    '<pid joint="hip" kp="10" kv="1" input="pos"/>': 3.0,
    '<pid joint="hip" kp="10" kv="1" gear="2" input="pos"/>': 6.0,
    '<pid joint="hip" kp="10" gear="-2" input="pos" ctrlrange="-0.1 0.2"/>': -4.0,
    '<general joint="hip" gainprm="10" biasprm="1 -10 -1" biastype="affine" gear="2"/>': 8.0,
}
MOTORS = {
    '<general joint="hip" gainprm="5" biasprm="2 0 0" biastype="none" gear="2"/>': 3.0,
    '<general joint="hip" gainprm="5" biasprm="2 -5 -1" biastype="none"/>': 1.5,
    '<general joint="hip" gainprm="5" biasprm="2 0 0" biastype="affine" gear="2"/>': 7.0,
}


def model_of(actuator):
    text = f"<mujoco><worldbody>{BODY}</worldbody><actuator>{actuator}</actuator></mujoco>"
    return mujoco.MjModel.from_xml_string(text)


def force(model, control, position=0.0):
    """Of the actuator at the joint, by MuJoCo."""
    data = mujoco.MjData(model)
    data.ctrl[:], data.qpos[:] = control, position
    mujoco.mj_forward(model, data)
    return data.qfrc_actuator[0]


@pytest.mark.parametrize("actuator", SERVOS)
def test_a_servo_asks_for_the_position_that_mujocos_does(actuator):
    model = model_of(actuator)
    own = actuators.find(model, (".*",), "env")
    asked = own.setpoint(model, np.array([0.3]), np)
    kp, _ = own.gains(model)
    assert force(model, 0.3) == pytest.approx(SERVOS[actuator])
    for position in (0.0, 0.4):
        found = kp * (asked.position - position)
        np.testing.assert_allclose(found, [force(model, 0.3, position)], rtol=1e-12)


@pytest.mark.parametrize("actuator", MOTORS)
def test_a_motor_asks_for_the_force_that_mujocos_gives(actuator):
    model = model_of(actuator)
    own = actuators.find(model, (".*",), "env")
    assert force(model, 0.3) == pytest.approx(MOTORS[actuator])
    asked = own.setpoint(model, np.array([0.3]), np)
    np.testing.assert_allclose(asked.force, [MOTORS[actuator]], rtol=1e-12)
    limited = model_of(actuator.replace("/>", ' ctrlrange="-1 1"/>'))
    ends = own.forces(limited, np)
    expected = [[force(limited, -9.0)], [force(limited, 9.0)]]
    np.testing.assert_allclose(ends, expected, rtol=1e-12)


@pytest.mark.parametrize("actuator", (*SERVOS, *MOTORS))
def test_what_a_drive_took_over_is_a_motor(actuator):
    """Its force is gear times the control, within `forcerange`, at any position."""
    model = model_of(actuator.replace("/>", ' forcerange="-4 4"/>'))
    own = actuators.find(model, (".*",), "env")
    for name, values in own.as_motors(model, damping=False).items():
        getattr(model, name)[:] = values
    gear = model.actuator_gear[0, 0]
    for control, clamped in ((3.0, 3.0), (-9.0, -4.0)):
        assert force(model, control, 0.1) == pytest.approx(gear * clamped)


def test_a_pids_other_inputs_are_refused():
    for inputs, words in (("pos vel", "a velocity input"), ("pos ff", "a feedforward input")):
        model = model_of(f'<pid joint="hip" kp="10" kv="1" input="{inputs}"/>')
        with pytest.raises(UserError, match=f"hip: its actuator has {words} of its own"):
            actuators.find(model, (".*",), "env")


def test_gains_of_a_pid_are_those_of_a_position_servo():
    found = []
    for actuator in ('<pid joint="hip" input="pos" ', '<position joint="hip" '):
        model = model_of(actuator + 'kp="10" kv="1" gear="2" forcerange="-4 4"/>')
        drive = environment_drive.build(
            model, "env", {}, joints=(".*",), gains=None, damping="joint", velocity="sampled",
            each_joint=False,
        )  # fmt: skip
        values = drive.values(np.zeros(0), model)
        found.append([float(np.squeeze(values[name])) for name in ("kp", "kd", "force_limit")])
    assert found == [[40.0, 4.0, 8.0]] * 2
