"""Actuators of other kinds that a drive takes over in an environment, against plain MuJoCo."""

import mujoco
import numpy as np
import pytest

import jaxact as jx
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


def built(model, parameters=(), gains=None, damping="joint"):
    return environment_drive.build(
        model, "env", dict(parameters), joints=(".*",), gains=gains, damping=damping,
        velocity="sampled", each_joint=False,
    )  # fmt: skip


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


@pytest.mark.parametrize("scale", (1.0, 0.5))
@pytest.mark.parametrize("servo", ('velocity kv="3"', 'position kp="8" kv="3"'))
def test_damping_in_the_drive_asks_for_the_force_of_servo_and_joint(servo, scale):
    """As MuJoCo adds up both: a servo's speed is one against the joint's damping."""
    model = model_of(f'<{servo} joint="hip" gear="-2"/>')
    model.dof_damping[0], data = 0.7, mujoco.MjData(model)
    drive = built(model, {"gain_scale": scale}, damping="drive")
    values = drive.values(np.zeros(0), model)
    asked = drive.setpoint(model, np.array([0.3]), np)
    for velocity in (0.0, 0.9):
        data.ctrl[0], data.qpos[0], data.qvel[0] = 0.3, 0.1, velocity
        mujoco.mj_forward(model, data)
        found = values["kp"] * (asked.position - 0.1) + values["kd"] * (asked.velocity - velocity)
        both = data.qfrc_actuator + data.qfrc_damper
        np.testing.assert_allclose(found, scale * both, rtol=1e-6)
    # a kd that is given is that of the servo's speed
    plain = built(model, {"kd": 2.0}, damping="drive").setpoint(model, np.array([0.3]), np)
    np.testing.assert_allclose(plain.velocity, [-0.15 if "vel" in servo else 0.0], rtol=1e-12)


def test_a_pids_other_inputs_are_refused():
    for inputs, words in (("pos vel", "a velocity input"), ("pos ff", "a feedforward input")):
        model = model_of(f'<pid joint="hip" kp="10" kv="1" input="{inputs}"/>')
        with pytest.raises(UserError, match=f"hip: its actuator has {words} of its own"):
            actuators.find(model, (".*",), "env")


def test_gains_of_a_pid_are_those_of_a_position_servo():
    found = []
    for actuator in ('<pid joint="hip" input="pos" ', '<position joint="hip" '):
        model = model_of(actuator + 'kp="10" kv="1" gear="2" forcerange="-4 4"/>')
        values = built(model).values(np.zeros(0), model)
        found.append([float(np.squeeze(values[name])) for name in ("kp", "kd", "force_limit")])
    assert found == [[40.0, 4.0, 8.0]] * 2


def test_an_actuator_with_three_forces_before_it_leaves_a_joint_its_gear():
    """Against the forces of MuJoCo, where gears are those of forces and not of actuators."""
    ball = '<body pos="1 0 0"><joint name="ball" type="ball"/><geom size="0.1"/></body>'
    servo = '<position joint="hip" kp="10" kv="1" gear="3"/>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><worldbody>{BODY}{ball}</worldbody>"
        f'<actuator><orientation joint="ball" kp="5"/>{servo}</actuator></mujoco>'
    )
    own = actuators.find(model, ("hip",), "env")
    data = mujoco.MjData(model)
    data.ctrl[own.controls], data.qpos[0], data.qvel[0] = 0.3, 0.2, 0.1
    mujoco.mj_forward(model, data)
    (kp,), (kd,) = own.gains(model)
    asked = own.setpoint(model, data.ctrl, np).position[0]
    assert (kp, kd) == (90.0, 9.0)
    assert kp * (asked - 0.2) - kd * 0.1 == pytest.approx(data.qfrc_actuator[0])


def test_what_is_given_of_some_joints_leaves_the_others_those_of_the_file(tmp_path):
    """As `jaxact.robot` has it, whichever name the parameter is given by."""
    text = "".join(
        f'<body pos="{i} 0 0"><joint name="{name}"/><geom size="0.1"/></body>'
        for i, name in enumerate(("hip", "knee"))
    )
    rows = '<position joint="hip" kp="100" kv="2"/><position joint="knee" kp="80" kv="1"/>'
    text = f"<mujoco><worldbody>{text}</worldbody><actuator>{rows}</actuator></mujoco>"
    path, file = tmp_path / "legs.xml", tmp_path / "gains.toml"
    path.write_text(text)
    file.write_text(
        "[kp]\nhip = 11.0\nknee = 12.0\n[kd]\nhip = 0.5\nknee = 0.75\n"
        "[force_limit]\nhip = 5.0\nknee = 6.0\n"
    )
    model = mujoco.MjModel.from_xml_string(text)
    of_file = {"kp": [11.0, 12.0], "kd": [0.5, 0.75], "force_limit": [5.0, 6.0]}
    for given, changed in (
        ({"kp": {"knee": 50.0}}, {"kp": [11.0, 50.0]}),
        ({"kd": {"hip": 3.0}}, {"kd": [3.0, 0.75]}),
        ({"force_limit": {"knee": 2.0}}, {"force_limit": [5.0, 2.0]}),
        ({"stiffness": 7.0}, {"kp": [7.0, 7.0]}),
        ({}, {}),
    ):
        values = built(model, given, file).values(np.zeros(0), model)
        exported = jx.export(jx.robot(path, gains=file, **given), "toml").joints
        for name, wanted in (of_file | changed).items():
            np.testing.assert_array_equal(np.broadcast_to(values[name], 2), wanted)
            assert getattr(exported, name) == tuple(wanted)
    drive = built(model, {"kp": {"knee": (40.0, 60.0)}}, file)
    np.testing.assert_array_equal(drive.values(np.full(1, 0.5), model)["kp"], [11.0, 50.0])
