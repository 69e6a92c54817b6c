"""Gains as MuJoCo actuators: C MuJoCo with them against the law of the drive, in NumPy."""

import re

import mujoco
import numpy as np
import pytest

from jaxact.robots import elements
from jaxact.robots import model as models

ARM = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <default>
    <position inheritrange="1" timeconst="0.02" dampratio="1" forcerange="-3 3" gear="2"/>
    <default class="strong"><position kp="90" forcerange="-7 5" inheritrange="0.5"/></default>
  </default>
  <worldbody>
    <body><joint name="hip" axis="0 1 0" range="-1 2" damping="0.3"/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
      <body pos="0.3 0 0"><joint name="knee" axis="0 1 0" range="-2 -0.5" ref="0.2"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/>
        <body pos="0.3 0 0"><joint name="slide" type="slide" axis="1 0 0"/>
          <geom size="0.02" mass="0.1"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="servo" class="strong" joint="hip"/>
    <position name="turned" joint="knee" kp="8" kv="1" timeconst="0" gear="-3" armature="0.01"/>
    {last}
  </actuator>
</mujoco>
"""
LAST = {
    "motor": '<motor name="last" joint="slide" gear="4" ctrlrange="-2 3" forcelimited="false"/>',
    "servo": '<position name="last" joint="slide" kp="7" kv="1" inheritrange="0" gear="0.5" '
    'timeconst="0" ctrlrange="-0.1 0.3" forcelimited="false"/>',
    "damped": '<general name="last" joint="slide" biastype="affine" gainprm="1" biasprm="0 0 -0.5" '
    'gear="2" ctrlrange="-9 9" forcelimited="false"/>',
}


@pytest.mark.parametrize("last", LAST.values(), ids=LAST)
def test_they_replace_the_models_own(last, tmp_path):
    """Forces, limits and the mass matrix of a model with them are those of the drives."""
    path = tmp_path / "arm.xml"
    path.write_text(ARM.format(last=last))
    robot = models.read(path)
    kp, kd = np.array([60.0, 20.0, 30.0]), np.array([3.0, 0.7, 1.1])
    text = elements.actuators(robot, kp, kd)
    own = text[text.index("<actuator>") : text.index("</actuator>") + len("</actuator>")]
    swapped = re.sub("<actuator>.*</actuator>", lambda _: own, path.read_text(), flags=re.S)
    original = mujoco.MjModel.from_xml_string(path.read_text())
    model = mujoco.MjModel.from_xml_string(swapped)
    for index in range(3):
        assert model.actuator(index).name == original.actuator(index).name
        assert model.actuator_trnid[index, 0] == original.actuator_trnid[index, 0]
    assert np.allclose(model.actuator_ctrlrange[:2], original.actuator_ctrlrange[:2])
    assert np.allclose(model.actuator_forcerange[:2], original.actuator_forcerange[:2])
    assert np.allclose(model.actuator_gear[:2], original.actuator_gear[:2])
    data, passive = mujoco.MjData(model), mujoco.MjData(robot.model)
    generator = np.random.default_rng(1)
    for _ in range(200):
        data.qpos[:] = passive.qpos[:] = generator.normal(size=3)
        data.qvel[:] = passive.qvel[:] = generator.normal(size=3)
        setpoint = 2.0 * generator.normal(size=3)
        data.ctrl[:] = setpoint * [joint.gear for joint in robot.joints]
        for one, other in ((model, data), (robot.model, passive)):
            mujoco.mj_forward(one, other)
        expected = [
            np.clip(
                p * (np.clip(r, joint.setpoint_low, joint.setpoint_high) - q) - d * v,
                joint.force_low, joint.force_high,
            )
            for joint, p, d, r, q, v in zip(
                robot.joints, kp, kd, setpoint, data.qpos, data.qvel, strict=True
            )
        ]  # fmt: skip
        # Damping of an actuator's own is an actuator's force in one and the joint's in the other.
        found = data.qfrc_actuator + data.qfrc_passive - passive.qfrc_passive
        assert np.allclose(found, expected, rtol=1e-9, atol=1e-9)
    push, moved = generator.normal(size=3), np.zeros((2, 3))
    data.qpos[:] = passive.qpos
    for row, one, other in zip(moved, (model, robot.model), (data, passive), strict=True):
        mujoco.mj_forward(one, other)
        mujoco.mj_mulM(one, other, row, push)
    assert np.allclose(*moved, rtol=1e-12)
