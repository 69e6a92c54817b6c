"""Robots as users bring them: the law that is read, the model that is made, and what is refused.

The referee is C MuJoCo: the user's own model with its own actuators against the converted model
under the law that was read, computed in NumPy at every physics step.
"""

import dataclasses
import math
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest

from jaxact.errors import UserError
from jaxact.robots import assets
from jaxact.robots import model as models
from jaxact.robots.findings import ENGINES

STEP = 0.001
ARM = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="{step}" {option}>{flags}</option>
  <default><default class="knee"><position kp="30" dampratio="0.5" ctrlrange="-1 1"/></default>
  </default>
  <worldbody>
    <body name="upper" pos="0 0 1" gravcomp="{gravcomp}">
      <joint name="hip" axis="0 1 0" damping="0.05" range="-3 3" {joint}/>
      <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
      <body name="lower" pos="0.3 0 0">
        <joint name="knee" axis="0 1 0" armature="0.01" ref="0.2"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/>
        <body pos="0.3 0 0"><joint axis="1 0 0" type="slide" stiffness="100" damping="1"/>
        <geom size="0.02" mass="0.1"/></body>
      </body>
    </body>
    <geom type="plane" size="2 2 0.1" pos="0 0 0.55"/>
  </worldbody>
  <tendon>{tendon}</tendon>
  <actuator>{actuator}</actuator>
  <sensor><actuatorpos actuator="a"/><jointpos joint="hip" delay="0.01" nsample="20"/></sensor>
  <keyframe><key name="home" qpos="0.3 0.1 0" qvel="0.1 0 0" ctrl="{ctrl}" act="{act}"/></keyframe>
</mujoco>
"""
PAIR = '<fixed name="t"><joint joint="hip" coef="{0}"/></fixed>'


def arm(actuator, ctrl="0.4", act="", option="", flags="", tendon="", joint="", gravcomp=0, **keys):
    text = ARM.format(
        actuator=actuator, ctrl=ctrl, act=act, option=option, flags=flags, tendon=tendon,
        joint=joint, gravcomp=gravcomp, step=STEP, **keys,
    )  # fmt: skip
    return text if act else text.replace(' act=""', "")


@pytest.fixture
def read(tmp_path):
    def from_text(text, **options):
        path = tmp_path / "robot.xml"
        path.write_text(text)
        return models.read(path, **options)

    return from_text


def native(text, steps=300):
    """Positions of the user's own model, its own actuators under the keyframe's controls."""
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    return _path(model, data, lambda: None, steps)


def driven(robot, steps=300, force=None):
    """Positions of the converted model under the law that was read."""
    data = mujoco.MjData(robot.model)
    data.qpos, data.qvel, data.ctrl = robot.qpos, robot.qvel, robot.ctrl
    if robot.model.na:
        data.act = robot.act

    def control():
        for joint in robot.joints:
            position, velocity = data.qpos[joint.qpos], data.qvel[joint.dof]
            if force is not None:
                wanted = force
            else:
                wanted = joint.kd * (joint.setpoint_velocity - velocity)
                if joint.kp:
                    wanted += joint.kp * (joint.setpoint - position)
            data.ctrl[joint.index] = np.clip(wanted, joint.force_low, joint.force_high)

    return _path(robot.model, data, control, steps)


def _path(model, data, control, steps):
    path = []
    for _ in range(steps):
        path.append(data.qpos.copy())
        control()
        mujoco.mj_step(model, data)
    return np.array(path)


SERVOS = {
    "position": ('<position name="a" joint="knee" kp="40" kv="2"/>', {}),
    "limits": (
        '<position name="a" joint="knee" kp="90" ctrlrange="-1 .3" forcerange="-2 5"/>', {},
    ),
    "gear": (
        '<position name="a" joint="hip" kp="4" kv="0.3" gear="-3" forcerange="-2 1"/>',
        {"ctrl": "0.8"},
    ),
    "dampratio": ('<position name="a" joint="hip" kp="40" dampratio="0.7"/>', {}),
    "default class": ('<position name="a" class="knee" joint="knee"/>', {}),
    "inheritrange": ('<position name="a" joint="hip" kp="9" inheritrange="0.1"/>', {}),
    "general": (
        '<general name="a" joint="hip" gainprm="20" biastype="affine" biasprm="3 -30 -2"/>', {},
    ),
    "velocity": ('<velocity name="a" joint="hip" kv="3" gear="2"/>', {}),
    "pair": (
        '<position name="a" joint="hip" kp="40"/><velocity joint="hip" kv="3"/>',
        {"ctrl": "0.4 0.2"},
    ),
    "pair reversed": (
        '<velocity name="a" joint="hip" kv="3"/><position joint="hip" kp="40"/>',
        {"ctrl": "0.2 0.4"},
    ),
    "intvelocity": (
        '<intvelocity name="a" joint="hip" kp="40" actrange="-1 1"/>', {"ctrl": "0", "act": "0.5"},
    ),
    "pid": (
        '<pid name="a" joint="hip" kp="40" kv="2" velrange="-1 1"/>', {"ctrl": "0.4 3"},
    ),
    "tendon": (
        '<position name="a" tendon="t" kp="10" kv="1" gear="2"/>', {"tendon": PAIR.format(-1.5)},
    ),
    "tendon limits": (
        '<position name="a" tendon="t" kp="60" gear="2" forcerange="-9 9"/>',
        {"tendon": PAIR.format(-1.5).replace("<fixed", '<fixed actuatorfrcrange="-2 1"')},
    ),
    "jointinparent": ('<position name="a" jointinparent="knee" kp="40" kv="2"/>', {}),
    "inertia": (
        '<position name="a" joint="hip" kp="10" gear="3" armature="0.02" damping="0.1"/>', {},
    ),
    "inertia of a tendon": (
        '<position name="a" tendon="t" kp="10" gear="3" armature="0.02" damping="0.1"/>',
        {"tendon": PAIR.format(-1.5)},
    ),
    "spring and damper by time constant": (
        '<position name="a" joint="hip" kp="10" gear="3" damping="0.1"/>',
        {"joint": 'springdamper="0.5 0.3"'},
    ),
    "joint limits": (
        '<position name="a" joint="hip" kp="400"/>',
        {"joint": 'actuatorfrcrange="-2 3" actuatorgravcomp="true"', "gravcomp": 0.5},
    ),
    "joint limits of its own": (
        '<position name="a" joint="hip" kp="400" forcerange="-1 9"/>',
        {"joint": 'actuatorfrcrange="-2 3"'},
    ),
    "an undriven spring beside it": (
        '<position name="a" joint="hip" kp="40"/><position joint="knee" kp="7" kv="0.2"/>'
        '<general joint="knee" dyntype="filter" dynprm="0.03" gainprm="2"/>',
        {"ctrl": "0.4 0.7 0.1", "act": "0.3"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SERVOS)
def test_the_law_that_is_read_moves_the_robot_as_its_own_actuators_do(read, name):
    actuator, options = SERVOS[name]
    text = arm(actuator, **options)
    chosen = ("hip",) if "undriven" in name else (".*",)
    robot = read(text, keyframe="home", joints=chosen)
    assert not [item for item in robot.findings if item.engines]
    assert np.ptp(native(text)[:, 0]) > 0.01
    np.testing.assert_allclose(driven(robot), native(text), rtol=0, atol=1e-11)


def test_limits_of_the_joint_are_the_drives_where_it_has_them_alone(read):
    limited = {"joint": 'actuatorfrcrange="-2 3"'}
    alone = arm('<motor name="a" joint="hip" ctrlrange="-9 1"/><motor joint="knee"/>', **limited)
    joint = read(alone.replace(' ctrl="0.4"', "")).joints[0]
    assert (joint.force_low, joint.force_high) == (-2.0, 1.0)
    shared = arm('<motor name="a" joint="hip"/><motor joint="hip"/>', **limited)
    (joint,) = read(shared.replace(' ctrl="0.4"', ""), joints=["a"]).joints
    assert (joint.force_low, joint.force_high) == (-math.inf, math.inf)


def test_a_higher_limit_of_the_drive_replaces_that_of_the_joint(read):
    """As it does that of the actuator: forces within a given limit act."""
    text = arm('<motor name="a" joint="hip" gear="2" ctrlrange="-5 5"/>', ctrl="20")
    robot = read(text.replace('name="hip"', 'name="hip" actuatorfrcrange="-4 4"'), keyframe="home")
    (joint,) = robot.joints
    assert (joint.force_low, joint.force_high) == (-4.0, 4.0)
    unlimited = dataclasses.replace(joint, force_low=-50.0, force_high=50.0)
    wanted = native(text.replace(' ctrlrange="-5 5"', ""), 50)
    got = driven(dataclasses.replace(robot, joints=(unlimited,)), 50, force=40.0)
    np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-11)


def test_a_remark_of_the_compiler_is_a_finding_and_no_warning(read):
    text = arm('<motor name="a" joint="hip"/>').replace("<compiler", '<compiler settotalmass="9"')
    robot = read(text)
    assert ["settotalmass" in item.value for item in robot.findings] == [True, False]
    assert robot.model.body_mass.sum() == pytest.approx(9.0)


@pytest.mark.parametrize("integrator", ["Euler", "implicitfast", "RK4"])
@pytest.mark.parametrize(
    "flags",
    ['<flag spring="disable"/>', '<flag damper="disable"/>',
     '<flag spring="disable" damper="disable"/>'],
)  # fmt: skip
def test_springs_and_dampers_that_are_switched_off_stay_off(read, flags, integrator):
    text = arm(
        '<motor name="a" joint="hip" damping="0.3"/>', flags=flags, gravcomp=0.7,
        option=f'density="50" integrator="{integrator}"', joint='springdamper="0.5 0.3"',
    )  # fmt: skip
    robot = read(text, keyframe=0)
    assert robot.model.opt.disableflags == mujoco.mjtDisableBit.mjDSBL_AUTORESET
    got = driven(robot, 100, force=0.4)
    np.testing.assert_allclose(got, native(text, 100), rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("actuator", "force", "low", "high"),
    [
        ('<motor name="a" joint="hip"/>', 0.4, -math.inf, math.inf),
        ('<motor name="a" joint="hip" gear="-5" ctrlrange="-1 0.3"/>', -1.5, -1.5, 5.0),
        ('<motor name="a" joint="hip" gear="9" forcerange="-.2 .3"/>', 2.7, -1.8, 2.7),
        ('<general name="a" joint="hip" gainprm="3" biastype="affine" biasprm="1 0 0"'
         ' ctrlrange="0 2"/>', 2.2, 1.0, 7.0),
    ],
)  # fmt: skip
def test_a_motor_is_the_force_within_its_limits(read, actuator, force, low, high):
    text = arm(actuator)
    robot = read(text, keyframe="home")
    (joint,) = robot.joints
    assert math.isnan(joint.kp) and math.isnan(joint.kd) and math.isnan(joint.setpoint)
    assert (joint.force_low, joint.force_high) == pytest.approx((low, high))
    np.testing.assert_allclose(driven(robot, force=force), native(text), rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ('delay="0.004" nsample="6"', 0.004),
        ('delay="0.0035" nsample="6"', 0.004),  # held samples: whole steps, rounded up
        ('delay="0.0041" nsample="6"', 0.005),
        ('delay="0.0035" nsample="6" interp="linear"', 0.0035),
        ('delay="0.02" nsample="3"', 0.003),  # no sample is older than the buffer
    ],
)
def test_a_delay_is_lifted_as_mujoco_carries_it_out(read, given, expected):
    text = arm(f'<motor name="a" joint="hip" {given}/>')
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    missing = 0.0
    for _ in range(40):
        data.ctrl[0] = 1.0
        mujoco.mj_step(model, data)
        missing += STEP * (1.0 - data.actuator_force[0])
    assert missing == pytest.approx(expected)
    robot = read(text)
    (joint,) = robot.joints
    assert (joint.delay, joint.setpoint_delay) == (pytest.approx(expected), 0.0)
    assert robot.model.nhistory == 0  # mjd_transitionFD refuses models with delays
    finding = next(item for item in robot.findings if item.field == "delay")
    assert finding.action == "lifted" and "command delay" in finding.advice
    servo = read(arm(f'<position name="a" joint="hip" kp="9" {given}/>')).joints[0]
    assert (servo.delay, servo.setpoint_delay) == (0.0, pytest.approx(expected))


def test_a_filter_of_the_force_becomes_a_force_loop_and_one_of_the_setpoint_is_left_out(read):
    text = '<general name="a" joint="hip" gainprm="5" dyntype="filterexact" dynprm="0.02"/>'
    robot = read(arm(text, act="0"))
    (joint,) = robot.joints
    wn, zeta = joint.natural_frequency, joint.damping_ratio
    poles = np.sort(np.roots([1.0, 2.0 * zeta * wn, wn**2]))
    assert poles[1] == pytest.approx(-1.0 / 0.02, rel=1e-9) and poles[0] / poles[
        1
    ] == pytest.approx(1000)
    servo = read(arm('<position name="a" joint="hip" kp="5" timeconst="0.02"/>', act="0"))
    assert math.isnan(servo.joints[0].natural_frequency)
    assert servo.model.na == 0 and servo.act.size == 0
    assert "outside the loop" in servo.findings[-2].advice + servo.findings[-1].advice


@pytest.mark.parametrize("limit", ["ctrlrange", "forcerange"])
def test_a_command_that_is_clamped_before_a_filter_is_said(read, limit):
    """A `forcerange` acts behind the filter in MuJoCo, too."""
    filtered = f'dyntype="filterexact" dynprm=".02" gear="10" {limit}="-.3 .3"'
    robot = read(arm(f'<general name="a" joint="hip" {filtered}/>', act="0"))
    assert robot.joints[0].force_high == pytest.approx(3.0)
    said = [item for item in robot.findings if item.field == limit]
    assert len(said) == (limit == "ctrlrange")
    if said:
        assert (said[0].value, said[0].action) == ("-0.3 0.3", "lifted")
        assert "before the filter" in said[0].advice


def test_a_motor_with_damping_of_its_own_gives_it_to_the_joint(read):
    damped = (
        '<general name="a" joint="hip" gainprm="3" biastype="affine" biasprm="0 0 -2" gear="2"/>'
    )
    text = arm(damped, option='integrator="implicitfast"')
    robot = read(text, keyframe="home")
    assert math.isnan(robot.joints[0].kp)
    got = driven(robot, force=0.4 * 3 * 2)
    np.testing.assert_allclose(got, native(text), rtol=0, atol=1e-11)


def test_what_is_not_driven_stays_as_it_is(read):
    text = arm(
        '<general name="f" joint="hip" dyntype="filter" dynprm="0.03" gainprm="2"/>'
        '<position name="a" joint="knee" kp="7" timeconst="0.1"/>'
        '<motor name="b" joint="knee" delay="0.01" nsample="11"/>',
        ctrl="0.1 0.7 0.3", act="0.5 0.6",
    )  # fmt: skip
    robot = read(text, keyframe="home", joints=["a"])
    assert [(joint.name, joint.index) for joint in robot.joints] == [("knee", 1)]
    assert robot.joints[0].setpoint == pytest.approx(0.7)
    np.testing.assert_allclose(robot.ctrl, [0.1, 0.0, 0.3])
    np.testing.assert_allclose(robot.act, [0.5])
    np.testing.assert_allclose(robot.model.key_ctrl[0], robot.ctrl)
    np.testing.assert_allclose(robot.model.key_act[0], robot.act)
    np.testing.assert_allclose(robot.model.key_qpos[0], robot.qpos)
    assert [item.action for item in robot.findings if "'b'" in item.where] == ["ignored harmlessly"]


def test_a_model_switches_actuators_off_by_their_group(read):
    two = (
        '<position name="a" joint="hip" kp="9" group="3"/>'
        '<position name="off" joint="knee" kp="9" group="2"/>'
    )
    text = arm(two, ctrl="0.4 0.8", option='actuatorgroupdisable="2"')
    robot = read(text, keyframe="home")
    assert [joint.name for joint in robot.joints] == ["hip"]
    np.testing.assert_allclose(driven(robot), native(text), rtol=0, atol=1e-11)


def test_a_setpoint_is_what_a_keyframe_asks_for(read):
    text = arm('<position name="a" joint="hip" kp="9" gear="2" ctrlrange="-1 1"/>', ctrl="5")
    assert read(text, keyframe="home").joints[0].setpoint == pytest.approx(0.5)
    assert read(text, keyframe="0").joints[0].setpoint == pytest.approx(0.5)
    assert math.isnan(read(text).joints[0].setpoint)
    assert np.array_equal(read(text).qpos, [0.0, 0.2, 0.0])
    silent = text.replace(' ctrl="5"', "")
    assert math.isnan(read(silent, keyframe="home").joints[0].setpoint)


BALL = '<body><joint name="b" type="ball"/><geom size="0.1"/></body>'
REFUSED = [
    ('<motor name="m" joint="b"/>', "ball joint 'b'"),
    ('<motor name="m" site="s"/>', "a site"),
    ('<adhesion name="m" body="upper" gain="1" ctrlrange="0 1"/>', "adhesion"),
    ('<motor name="m" cranksite="s" slidersite="s2" cranklength="1"/>', "slider-crank"),
    ('<motor name="m" tendon="two"/>', "couples several joints (hip, knee)"),
    ('<motor name="m" tendon="space"/>', "runs through space"),
    ('<pid name="m" joint="hip" kp="1" ki="2"/>', "pid with an integral part (ki = 2)"),
    ('<pid name="m" joint="hip" kp="1" slewmax="2"/>', "slew limit (2)"),
    ('<pid name="m" joint="hip" kp="1" input="vel"/>', "without a position input"),
    ('<dcmotor name="m" joint="hip" motorconst="0.1" resistance="1"/>', "dcmotor"),
    ('<muscle name="m" joint="hip"/>', "muscle"),
    ('<damper name="m" joint="hip" kv="1" ctrlrange="0 1"/>', "damper"),
    ('<motor name="m" joint="hip" gear="0"/>', "gear is 0"),
    ('<general name="m" joint="hip" gainprm="0"/>', "gain is 0"),
    ('<general name="m" joint="hip" biastype="affine" biasprm="0 3 0"/>', "away from the setpoint"),
    ('<general name="m" joint="hip" dyntype="integrator"/>', "integrates its input"),
    ('<general name="m" joint="hip" gaintype="affine" gainprm="1 2 3"/>', "not linear"),
    ('<motor name="m" joint="hip" damping="0 1"/>', "polynomial"),
    ('<motor name="m" joint="hip"/><motor name="n" joint="hip"/>', "act on it together"),
    (
        '<position name="m" joint="hip" kp="1" forcerange="-1 1"/><velocity joint="hip" kv="1"/>',
        "act on it together",
    ),
]  # fmt: skip


@pytest.mark.parametrize(("actuator", "reason"), REFUSED)
def test_what_cannot_be_driven_says_why_in_one_line(read, actuator, reason):
    text = arm('<motor name="a" joint="knee"/>' + actuator, tendon=(
        '<fixed name="two"><joint joint="hip" coef="1"/><joint joint="knee" coef="1"/></fixed>'
        '<spatial name="space"><site site="s"/><site site="s2"/></spatial>'
    ))  # fmt: skip
    text = text.replace(' ctrl="0.4"', "").replace(
        '<body name="lower"', BALL + '<site name="s" pos="0.1 0 0"/><body name="lower"'
    ).replace('<geom type="plane"', '<site name="s2"/><geom type="plane"')  # fmt: skip
    text = text.replace('<key name="home" qpos="0.3 0.1 0" qvel="0.1 0 0"/>', "")
    robot = read(text)
    stops = [item for item in robot.findings if item.engines == ENGINES]
    assert any(reason in item.advice or reason in item.field for item in stops)
    for engine in ENGINES:
        with pytest.raises(UserError) as caught:
            models.demand(robot, engine)
        assert "\n" not in str(caught.value)
    if "polynomial" not in reason:
        assert {joint.actuator for joint in robot.joints} == {"a"}
        models.demand(read(text, joints=["knee"]), "mujoco")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"keyframe": "hom"}, "no keyframe 'hom'; did you mean 'home'"),
        ({"keyframe": 7}, "no keyframe 7; allowed: home"),
        ({"joints": ["hpi"]}, "no joint matches 'hpi'; did you mean 'hip'"),
        ({"joints": ["hip", ".*_knee"]}, "no joint matches '.*_knee'"),
        ({"joints": ["("]}, "not a regular expression"),
    ],
)
def test_a_name_that_is_not_there_is_refused_with_the_known_ones(read, options, reason):
    with pytest.raises(UserError) as caught:
        read(arm('<motor name="a" joint="hip"/>'), **options)
    assert reason in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("<mujoco><worldbody/></mujoco>", "has no actuators"),
        ("<mujoco><wrong/></mujoco>", "cannot read this model"),
        ("no xml at all", "cannot read this model"),
        ("", "cannot read this model"),
        (arm('<motor name="a" joint="nowhere"/>'), "cannot compile this model"),
        (arm('<motor name="a" joint="hip"/>').replace("0.3 0.1 0", "0.3 0.1 0 1"), "keyframe"),
        ('<mujoco><include file="absent.xml"/></mujoco>', "absent.xml"),
    ],
)
def test_a_file_that_is_no_model_is_refused_in_one_line(read, tmp_path, text, reason):
    with pytest.raises(UserError) as caught:
        read(text)
    assert reason in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(UserError, match="no such model file"):
        models.read(tmp_path)


URDF = """<?xml version="1.0"?><!-- <mujoco/> -->
<robot name="r"><link name="base"/>
<link name="l1"><inertial><mass value="1"/><origin xyz="0 0 0.1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="12" velocity="3"/><dynamics damping="0.1"/></joint></robot>"""


def test_a_urdf_gets_a_motor_for_each_joint(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    robot = models.read(path)
    (joint,) = robot.joints
    assert (joint.name, joint.kind) == ("j1", "motor")
    np.testing.assert_allclose(robot.model.jnt_actfrcrange, [[-12.0, 12.0]])
    assert robot.findings[0].value == "none in a URDF"
    assert path.read_text() == URDF


MESHES = """<mujoco><asset><mesh file="gone.stl"/><texture name="t" type="2d" file="gone.png"/>
  <material name="m" texture="t"/></asset><worldbody><body name="b"><joint name="j"/>
  <geom type="mesh" mesh="gone" {visual}/><geom size="0.1" material="m" mass="1"/>{inertial}</body>
  </worldbody><actuator><motor joint="j"/></actuator></mujoco>"""
LOOKS = 'contype="0" conaffinity="0"'


def test_missing_meshes_matter_only_where_they_touch_or_weigh(read):
    inertial = '<inertial pos="0 0 0.1" mass="1" diaginertia="0.1 0.1 0.1"/>'
    seen = read(MESHES.format(visual=LOOKS, inertial=inertial))
    assert seen.model.nmesh == 0 and seen.model.ngeom == 1
    assert seen.model.body_mass[1] == 1.0 and seen.model.body_ipos[1, 2] == 0.1
    (finding,) = seen.findings
    assert finding.value in ("gone.stl and 1 more", "gone.png and 1 more")
    assert read(MESHES.format(visual=LOOKS + ' mass="0"', inertial="")).model.ngeom == 1
    for visual, given in ((LOOKS, ""), ("", inertial)):
        with pytest.raises(UserError, match=r"mesh file gone.stl is missing, and body 'b' needs"):
            read(MESHES.format(visual=visual, inertial=given))


def test_many_missing_meshes_are_left_out_at_once_and_those_there_stay(tmp_path, monkeypatch):
    names = [f"m{number}" for number in range(20)]
    (tmp_path / "m3.obj").write_text(CORNERS)
    spec = mujoco.MjSpec.from_string(
        "<mujoco><asset>"
        + "".join(f'<mesh file="{name}.obj"/>' for name in names)
        + '</asset><worldbody><body><joint/><geom size="0.1" mass="1"/>'
        + "".join(f'<geom type="mesh" mesh="{name}" mass="0" {LOOKS}/>' for name in names)
        + "</body></worldbody></mujoco>"
    )
    spec.modelfiledir = str(tmp_path)
    model, (finding,) = assets.compile_model(spec)
    assert model.nmesh == 1 and model.ngeom == 2 and finding.value == "m0.obj and 18 more"


SHELL = """<robot name="r"><link name="base"/><link name="arm">
  <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
  <collision><geometry><mesh filename="package://arm_description/meshes/shell.obj"/></geometry>
  </collision></link><joint name="j1" type="continuous"><parent link="base"/><child link="arm"/>
  </joint></robot>"""
CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.mark.parametrize("package", ["arm_description", "arm_description-1.2"])
def test_meshes_of_a_ros_package_are_found(tmp_path, package):
    folders = [tmp_path / package / name for name in ("urdf", "meshes")]
    for folder in folders:
        folder.mkdir(parents=True)
    (path := folders[0] / "robot.urdf").write_text(SHELL)
    with pytest.raises(UserError, match=r"mesh file package://arm_description/meshes/shell.obj is"):
        models.read(path)
    (folders[1] / "shell.obj").write_text(CORNERS)
    assert models.read(path).model.nmesh == 1


def test_inertia_that_no_single_joint_can_carry_stays_with_its_actuator(read):
    text = """<mujoco><worldbody>
      <body><joint name="hip" axis="0 1 0"/><geom size="0.1" pos="0.2 0 0"/>
      <body pos="0.3 0 0"><joint name="b" type="ball"/><geom size="0.1" pos="0 0 0.1"/></body>
      </body></worldbody><tendon><fixed name="t"><joint joint="hip" coef="2"/></fixed></tendon>
      <actuator><position joint="hip" kp="9"/>
      <motor name="ball" joint="b" gear="0 1 0" armature="0.1" damping="0.3"/>
      <motor name="tendon" tendon="t" gear="2" armature="0.01" damping="0.1 0.2"/></actuator>
      <keyframe><key name="home" ctrl="0.4 0.1 0.2"/></keyframe></mujoco>"""
    robot = read(text, keyframe="home", joints=["actuator 0"])
    np.testing.assert_allclose(driven(robot), native(text), rtol=0, atol=1e-11)
    models.demand(robot, "mujoco")
    with pytest.raises(UserError, match=r"'ball': give armature to the joints .*and 2 more"):
        models.demand(robot, "mjx")
    # MJX-Warp simulates the damping
    with pytest.raises(UserError, match=r"'ball': give armature to the joints instead, as one n"):
        models.demand(robot, "warp")


def test_a_name_is_made_for_a_joint_without_one(read):
    robot = read(
        """<mujoco><worldbody><body><joint/><geom size="0.1"/>
        <body><joint name="joint 0"/><geom size="0.1"/></body></body></worldbody>
        <tendon><fixed name="t"><joint joint="joint 0" coef="1"/></fixed></tendon>
        <actuator><motor joint="joint 0"/></actuator></mujoco>"""
    )
    assert [joint.name for joint in robot.joints] == ["joint 0"]
    assert robot.joints[0].actuator == "actuator 0"


def test_patterns_are_held_against_the_names_of_the_model(read):
    text = """<mujoco><worldbody><body><joint name="arm"/><geom size="0.1"/>
        <body><joint name="leg"/><geom size="0.1"/></body></body></worldbody>
        <actuator><motor joint="leg"/><motor joint="arm"/></actuator></mujoco>"""
    second = re.escape("actuator 1")
    for pattern, chosen in (("a.*", ["arm"]), (".*t.*", []), (".*", ["leg", "arm"]),
                            ("actuator 0", ["leg"]), (second, ["arm"])):  # fmt: skip
        if chosen:
            assert [one.name for one in read(text, joints=[pattern]).joints] == chosen
        else:
            with pytest.raises(UserError, match="no joint matches"):
                read(text, joints=[pattern])


def test_the_digest_follows_what_is_included(tmp_path):
    part = tmp_path / "part.xml"
    part.write_text('<mujoco><worldbody><body><joint name="j"/><geom size="0.1"/></body>'
                    "</worldbody></mujoco>")  # fmt: skip
    whole = tmp_path / "whole.xml"
    whole.write_text('<mujoco><include file="part.xml"/><actuator><motor joint="j"/></actuator>'
                     "</mujoco>")  # fmt: skip
    first = models.read(whole).digest
    assert models.read(whole).digest == first
    part.write_text(part.read_text().replace("0.1", "0.2"))
    assert models.read(whole).digest != first


TEST_DATA = Path(mujoco.__file__).parent / "mjx" / "test_data"


@pytest.mark.parametrize(
    ("file", "count"),
    [("barkour_v0/assets/barkour_v0_mjx.xml", 12), ("shadow_hand/right_hand.xml", 24)],
)
def test_robots_that_nobody_here_prepared(file, count):
    robot = models.demand(models.read(TEST_DATA / file), "mjx")
    assert len(robot.joints) == count
    assert [item.field for item in robot.findings] == ["iterations"]  # one, for speed
    original = mujoco.MjModel.from_xml_path(str(TEST_DATA / file))
    # the law is computed once a step, as Euler's integrator does with servos
    original.opt.integrator = robot.model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    original.opt.iterations, original.opt.ls_iterations = 100, 50  # as the finding says
    data = mujoco.MjData(original)
    data.ctrl = original.actuator_ctrlrange.mean(axis=1) + 0.1
    asked = tuple(
        dataclasses.replace(joint, setpoint=float(target))
        for joint, target in zip(robot.joints, data.ctrl, strict=True)
    )
    want = _path(original, data, lambda: None, 100)
    got = driven(dataclasses.replace(robot, joints=asked), 100)
    np.testing.assert_allclose(got, want, rtol=0, atol=1e-11)
