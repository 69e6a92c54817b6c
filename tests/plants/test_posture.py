"""Robots brought to rest: light joints that carry a heavy trunk, loose objects, bad keyframes."""

import mujoco
import numpy as np
import pytest

from jaxact.errors import UserError
from jaxact.robots import model, posture

LEG = """<body name="{name}" pos="{x} {y} 0"><joint name="{name} hip" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".01" mass=".05"/>
  <body pos="0 0 -.2"><joint name="{name} knee" axis="0 1 0"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".01" mass=".02"/>
  <geom name="{name} foot" size=".02" pos="0 0 -.2" mass=".01"/></body></body>"""


def _robot(folder, body, joints, options="", keyframes="", **chosen):
    motors = "".join(f'<motor joint="{name}"/>' for name in joints)
    text = f"<mujoco>{options}<worldbody>{body}</worldbody><actuator>{motors}</actuator>{keyframes}"
    path = folder / "robot.xml"
    path.write_text(text + "</mujoco>")
    return model.read(path, **chosen)


def test_light_legs_carry_a_heavy_trunk_as_the_keyframe_has_them(tmp_path):
    places = {"FL": (0.2, 0.1), "FR": (0.2, -0.1), "HL": (-0.2, 0.1), "HR": (-0.2, -0.1)}
    legs = "".join(LEG.format(name=name, x=x, y=y) for name, (x, y) in places.items())
    body = (
        '<geom type="plane" size="1 1 1"/><body pos="0 0 .37"><freejoint/>'
        f'<geom type="box" size=".25 .1 .05" mass="30"/>{legs}</body>'
    )
    bent = '<keyframe><key name="bent" qpos="0 0 .37 1 0 0 0' + " .5 -1" * 4 + '"/></keyframe>'
    joints = [f"{name} {part}" for name in places for part in ("hip", "knee")]
    options = '<option timestep="0.004" integrator="implicitfast"/>'
    robot = _robot(tmp_path, body, joints, options, bent, keyframe="bent")
    found = posture.settled(robot)
    assert found.residual < 0.01
    np.testing.assert_allclose(found.qpos[7:], robot.qpos[7:], atol=0.02)
    # The legs carry the weight: it is what the contacts exert.
    data = mujoco.MjData(robot.model)
    data.qpos, data.ctrl = found.qpos, found.force
    mujoco.mj_forward(robot.model, data)
    weight = 9.81 * robot.model.body_mass.sum()
    assert data.qfrc_constraint[2] == pytest.approx(weight, rel=1e-3)


def test_an_upright_pole_stays_upright(tmp_path):
    body = (
        '<body><joint name="cart" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/>'
        '<body><joint axis="0 1 0"/><geom size=".02" pos="1e-6 0 .5" mass=".1"/></body></body>'
    )
    robot = _robot(tmp_path, body, ["cart"])
    found = posture.settled(robot)
    assert 0.0 < found.residual < 1e-3
    np.testing.assert_array_equal(found.qpos, robot.qpos)


def test_bodies_that_overlap_at_the_keyframe_are_named(tmp_path):
    body = (
        '<geom type="box" size=".1 .1 .1"/><body name="link" pos="0 0 {height}">'
        '<joint name="turn" axis="0 1 0"/><geom type="box" size=".05 .05 .1"/></body>'
    )
    said = posture._overlap(_robot(tmp_path, body.format(height=0.12), ["turn"]))
    assert said == "; body 'world' and body 'link' overlap by 80 mm at the keyframe"
    assert posture._overlap(_robot(tmp_path, body.format(height=0.2), ["turn"])) == ""


def test_a_robot_that_slides_down_a_slope_is_not_only_said_to_fall(tmp_path):
    """In plain MuJoCo it stays upright all the way."""
    body = (
        '<geom type="plane" size="9 9 1" friction=".05"/><body pos="0 0 .1"><freejoint/>'
        '<geom type="box" size=".2 .15 .1" mass="8" friction=".05"/><body pos="0 0 .1">'
        '<joint name="arm" axis="0 1 0"/><geom size=".02" pos="0 0 .1" mass=".1" contype="0" '
        'conaffinity="0"/></body></body>'
    )
    robot = _robot(tmp_path, body, ["arm"], '<option timestep="0.004" gravity="1 0 -9.8"/>')
    data = mujoco.MjData(robot.model)
    for _ in range(500):
        data.ctrl[0] = -2.0 * data.qpos[7] - 0.05 * data.qvel[6]
        mujoco.mj_step(robot.model, data)
    assert data.qpos[0] > 0.3 and data.qpos[3] > 0.999
    with pytest.raises(UserError, match="falls from its keyframe, or slides off it"):
        posture.settled(robot)
