"""Robots on a stand and held: against models edited by hand, and against a free base made heavy."""

import copy

import mujoco
import numpy as np
import pytest

from jaxact.errors import UserError
from jaxact.plants import linearize
from jaxact.robots import model as models
from jaxact.robots import mounting, posture

LEG = """<body name="{side} thigh" pos="0 {y} 0">
  <joint name="{side} hip" axis="0 1 0" damping=".4" armature=".01"/>
  <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5"/>
  <body pos="0 0 -.2"><joint name="{side} knee" axis="0 1 0" damping=".2" armature=".01"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".3"/>
    <geom name="{side} toe" pos=".0588 0 -.2119" size=".03" mass=".1"/>
    <geom name="{side} heel" pos="-.0588 0 -.1881" size=".03" mass=".1"/></body></body>"""
LEGS = LEG.format(side="left", y=0.1) + LEG.format(side="right", y=-0.1)
TRUNK = '<geom type="box" size=".1 .12 .05" pos=".02 0 .05" mass="6"/>'
BIPED = """
<mujoco>
  <option timestep="0.002" cone="elliptic" impratio="10"/>
  <worldbody>
    <geom type="plane" size="3 3 1"/>
    {before}
    <body name="trunk" {pose}>{joint}{trunk}{legs}</body>
    {after}
  </worldbody>
  <actuator>
    <position joint="left hip" kp="300" dampratio=".4"/><motor joint="left knee"/>
    <position joint="right hip" kp="300" dampratio=".4"/><motor joint="right knee"/>
  </actuator>
  {keys}
</mujoco>"""
BENT = ".2 -.4 .2 -.4"
# Turned about the vertical, so that the pose of the base matters.
POSE, TURNED = "0.3 -0.2 0.4215", "0.9689124 0 0 0.247404"
KEYS = '<keyframe><key name="bent" qpos="{0}"/><key name="other"/></keyframe>'


def _robot(folder, text, **options):
    path = folder / "robot.xml"
    path.write_text(text)
    return models.read(path, **options)


def _biped(joint="<freejoint/>", pose='pos="0 0 1"', qpos=f"{POSE} {TURNED} {BENT}", **more):
    keys = KEYS.format(qpos)
    around = {"before": "", "after": "", "trunk": TRUNK, "legs": LEGS} | more
    return BIPED.format(joint=joint, pose=pose, keys=keys, **around)


def _by_hand():
    """The file as a person would edit it: no free joint, the keyframe's pose, nothing touches."""
    text = _biped(joint="", pose=f'pos="{POSE}" quat="{TURNED}"', qpos=BENT)
    return text.replace("<geom ", '<geom contype="0" conaffinity="0" ')


def test_a_fixed_base_is_the_model_without_free_joint_and_contacts(tmp_path):
    robot = _robot(tmp_path, _biped(), keyframe="bent", base="fixed")
    model = mujoco.MjModel.from_xml_string(_by_hand())
    # What the compiler derives from inertias belongs to the free model.
    free = mujoco.MjModel.from_xml_string(_biped())
    data = mujoco.MjData(model)
    data.qpos = model.key("bent").qpos
    np.testing.assert_array_equal(robot.qpos, data.qpos)
    assert [joint.kd for joint in robot.joints[::2]] == list(-free.actuator_biasprm[::2, 2])

    model.actuator_gainprm[:] = model.actuator_biasprm[:] = 0.0
    model.actuator_gainprm[:, 0] = 1.0
    mujoco.mj_inverse(model, data)
    data.ctrl = data.qfrc_inverse
    A, B = np.zeros((8, 8)), np.zeros((8, 4))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, A, B, None, None)
    found_A, found_B, residual = linearize.linearise_c(robot, posture.settled(robot), 0.002)
    np.testing.assert_allclose(found_A, A, atol=1e-8)
    np.testing.assert_allclose(found_B, B, atol=1e-8)
    assert residual < 1e-9


def test_a_held_base_is_a_free_one_too_heavy_to_move(tmp_path):
    robot = _robot(tmp_path, _biped(), keyframe="bent", base="held")
    free = _robot(tmp_path, _biped(), keyframe="bent")
    stands, there = posture.settled(robot), posture.settled(free)
    np.testing.assert_allclose(stands.qpos, there.qpos[7:], atol=1e-9)
    np.testing.assert_allclose(stands.force, there.force, atol=1e-3)
    heavy = copy.copy(free.model)
    heavy.dof_armature[:6] = 1e8
    A, B, _ = linearize.linearise_c(free, there, 0.002, heavy)
    kept = [*range(6, 10), *range(16, 20)]
    found_A, found_B, _ = linearize.linearise_c(robot, stands, 0.002)
    np.testing.assert_allclose(found_A, A[np.ix_(kept, kept)], atol=2e-3)
    np.testing.assert_allclose(found_B, B[kept], rtol=1e-3, atol=1e-6)
    assert np.abs(found_A - np.eye(8)).max() > 1.0  # the contacts are there


def test_the_base_stays_where_frames_and_angles_have_put_it(tmp_path):
    pose = 'pos=".1 0 0" euler="0 0 30"'
    text = _biped(pose=pose, before='<frame pos="1 0 1" euler="40 0 0">', after="</frame>")
    for options in ({}, {"keyframe": "bent"}):
        free = _robot(tmp_path, text, **options)
        fixed = _robot(tmp_path, text, base="fixed", **options)
        places = []
        for robot in (free, fixed):
            data = mujoco.MjData(robot.model)
            data.qpos = robot.qpos
            mujoco.mj_kinematics(robot.model, data)
            places.append([*data.xpos, *data.geom_xmat])
        for there, here in zip(*places, strict=True):
            np.testing.assert_allclose(here, there, atol=1e-12)


LOOSE = """<body name="ball" pos=".6 0 .1"><freejoint/><geom size=".1"/></body>
<body name="other" pos="-1 0 .6"><freejoint/><geom type="box" size=".1 .1 .1" mass="1"/>
  <body pos=".3 0 0"><joint name="passive"/><geom size=".02"/></body></body>"""


def test_loose_objects_and_other_robots_stay_loose(tmp_path):
    qpos = "0 0 0 1 0 0 0".replace("0 0 0 1", ".6 0 .1 1", 1)
    text = _biped(before=LOOSE, qpos=f"{qpos} -1 0 .6 1 0 0 0 .2 {POSE} {TURNED} {BENT}")
    robot = _robot(tmp_path, text, keyframe="bent", base="fixed")
    assert robot.model.nv == 6 + 7 + 4
    np.testing.assert_array_equal(robot.qpos[-4:], [float(x) for x in BENT.split()])
    np.testing.assert_array_equal(robot.model.key("bent").qpos, robot.qpos)
    said = [item for item in robot.findings if item.field == "base"]
    assert [item.where for item in said] == ["joint 3"]
    data = mujoco.MjData(robot.model)
    data.qpos = robot.qpos
    for _ in range(1000):
        mujoco.mj_step(robot.model, data)
    assert data.body("ball").xpos[2] == pytest.approx(0.1, abs=5e-3)  # on the ground


PLANAR = """<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>
<joint name="pitch" axis="0 1 0"/>"""


def test_slides_of_a_planar_robot_are_its_base(tmp_path):
    text = _biped(joint=PLANAR, pose='pos="0.3 0 0"', qpos=f"0 .42 0.3 {BENT}")
    robot = _robot(tmp_path, text, keyframe="bent", base="fixed")
    assert robot.model.nv == 4
    np.testing.assert_allclose(robot.model.body("trunk").pos, [0.3, 0.0, 0.42])
    turned = [np.cos(0.15), 0.0, np.sin(0.15), 0.0]
    np.testing.assert_allclose(robot.model.body("trunk").quat, turned)


def test_a_joint_that_a_tendon_drives_is_no_base(tmp_path):
    text = _biped(joint=PLANAR, pose='pos="0 0 .42"', qpos=f"0 0 0 {BENT}")
    tendon = '<tendon><fixed name="t"><joint joint="x" coef="1"/></fixed></tendon><actuator>'
    text = text.replace("<actuator>", tendon + '<motor tendon="t"/>')
    robot = _robot(tmp_path, text, joints=[".*hip", ".*knee"], base="fixed")
    assert robot.model.nv == 7


STAYS = {
    "a base that is fixed already": ("", BENT),
    "a passive hinge": ('<joint name="swing" axis="0 1 0"/>', f"0 {BENT}"),
    "a sprung mount": ('<joint type="slide" axis="0 0 1" stiffness="9e3"/>', f"0 {BENT}"),
}


@pytest.mark.parametrize("case", STAYS)
def test_what_does_not_move_the_robot_as_a_whole_stays(tmp_path, case):
    joint, qpos = STAYS[case]
    text = _biped(joint=joint, qpos=qpos)
    free, fixed = (_robot(tmp_path, text, keyframe="bent", base=base) for base in ("free", "fixed"))
    assert fixed.model.nv == free.model.nv
    (said,) = [item for item in fixed.findings if item.field == "base"]
    assert "does not move in the model either; nothing touches the robot" in said.advice
    assert not fixed.model.geom_contype[1:].any() and not fixed.model.geom_conaffinity[1:].any()


def test_an_actuator_on_the_base_itself_forbids_it(tmp_path):
    thrust = '<motor joint="root" gear="0 0 1 0 0 0"/><motor joint="left knee"/>'
    text = _biped(joint='<freejoint name="root"/>').replace('<motor joint="left knee"/>', thrust)
    with pytest.raises(UserError, match="acts on the free joint 'root'.*base = \"free\""):
        _robot(tmp_path, text, base="fixed")


def test_what_needs_the_joints_of_the_base_is_named(tmp_path):
    coupled = '<equality><joint joint1="pitch" joint2="left hip"/></equality>'
    text = _biped(joint=PLANAR, qpos=f"0 .42 0 {BENT}").replace(
        "<actuator>", coupled + "<actuator>"
    )
    with pytest.raises(UserError, match='base = "fixed": the model cannot do without.*pitch'):
        _robot(tmp_path, text, base="fixed")


def test_a_robot_that_falls_is_proposed_a_stand(tmp_path):
    text = _biped(qpos=f"0 0 3 1 0 0 0 {BENT}")
    with pytest.raises(UserError, match='falls.*base="fixed".* to put it on a stand'):
        _robot(tmp_path, text, keyframe="bent", base="held")
    robot = _robot(tmp_path, text, keyframe="bent", base="held", settle=False)
    assert robot.model.body("trunk").pos[2] == 3.0
    with pytest.raises(UserError, match="base = 'table'; allowed: free, fixed, held"):
        _robot(tmp_path, text, base="table")


INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/>'
    "</inertial>"
)
LINK = '<link name="{0}">' + INERTIAL + "</link>"
FLOATING = f"""<robot name="r"><link name="ground"/>
{LINK.format("trunk")}{LINK.format("box")}{LINK.format("arm")}
<joint name="float" type="floating"><parent link="ground"/><child link="trunk"/>
<origin xyz="0 0 1" rpy="0 0.3 0"/></joint>
<joint name="bolt" type="fixed"><parent link="trunk"/><child link="box"/></joint>
<joint name="turn" type="continuous"><parent link="box"/><child link="arm"/>
<origin xyz="0 0 .2"/><axis xyz="0 1 0"/></joint></robot>"""


def test_links_of_a_urdf_keep_their_names_on_a_stand(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(FLOATING)
    free, fixed = models.read(path), models.read(path, base="fixed")
    assert (free.model.nv, fixed.model.nv) == (7, 1)
    names = [
        [robot.model.body(index).name for index in range(robot.model.nbody)]
        for robot in (free, fixed)
    ]
    assert names[0] == names[1] and {"trunk", "arm"} <= set(names[1])
    places = []
    for robot in (free, fixed):
        data = mujoco.MjData(robot.model)
        data.qpos = robot.qpos
        mujoco.mj_kinematics(robot.model, data)
        places.append([*data.body("arm").xpos, *data.body("arm").xquat])
    np.testing.assert_allclose(*places, atol=1e-12)


def test_what_lay_on_a_robot_is_named_when_it_falls(tmp_path):
    rider = '<body name="rider" pos="0 0 2"><freejoint/><geom size=".05" mass=".1"/></body>'
    robot = _robot(tmp_path, _biped(after=rider, qpos=f"{POSE} {TURNED} {BENT} .3 -.2 .57 1 0 0 0"),
                   keyframe="bent", base="fixed")  # fmt: skip
    with pytest.raises(UserError, match="body 'rider' falls from its keyframe") as raised:
        posture.settled(robot)
    assert 'posture="keyframe"' in str(raised.value) and "stand" not in str(raised.value)


def test_only_a_base_that_moves_floats(tmp_path):
    assert mounting.floats(_robot(tmp_path, _biped()))
    assert not mounting.floats(_robot(tmp_path, _biped(), base="fixed"))
    assert not mounting.floats(_robot(tmp_path, _biped(joint="", qpos=BENT)))
