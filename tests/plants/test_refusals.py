"""What would help where MuJoCo refuses a robot: what is said works when it is written there."""

import mujoco
import numpy as np
import pytest

from jaxact.errors import UserError
from jaxact.robots import model as models

URDF = """<robot name="arm"><link name="base"/><link name="rod">{rod}</link>
<joint name="turn" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
</joint>{more}</robot>"""
INERTIAL = """<inertial><mass value="{mass}"/><origin xyz="0 0 .1"/>
<inertia ixx="{0}" iyy="{1}" izz="{2}" ixy="{3}" ixz="0" iyz="0"/></inertial>"""
GOOD = INERTIAL.format(0.01, 0.01, 0.01, 0, mass=1)
DUMMY = """<link name="end">{0}</link><joint name="turn2" type="continuous"><parent link="rod"/>
<child link="end"/></joint>"""
COLLISION = '<collision><geometry><mesh filename="meshes/rod.stl"/></geometry></collision>'


def _read(folder, text, name="robot.urdf", **options):
    path = folder / name
    path.write_text(text)
    return models.read(path, **options)


def _refusal(folder, text, name="robot.urdf"):
    with pytest.raises(UserError) as caught:
        _read(folder, text, name)
    assert "\n" not in str(caught.value)
    return str(caught.value)


HELPED = {
    "no rigid body's": (INERTIAL.format(0.1, 0.1, 0.5, 0, mass=1), "", "link 'rod' is that of no"),
    "no mass": (INERTIAL.format(0.1, 0.1, 0.1, 0, mass=0), "", "link 'rod' moves, but has no mass"),
    "no inertia": (INERTIAL.format(0, 0, 0, 0, mass=1), "", "link 'rod' moves, but has no mass"),
    "no inertial": ("", "", "link 'rod' moves, but has no mass or no inertia"),
    "one in between": ("", DUMMY.format(GOOD), "link 'rod' moves, but has no mass"),
}


@pytest.mark.parametrize("case", HELPED)
def test_what_is_proposed_helps(tmp_path, case):
    rod, more, reason = HELPED[case]
    text = URDF.format(rod=rod, more=more)
    said = _refusal(tmp_path, text)
    assert reason in said and "mjMINVAL" not in said and "fused" not in said
    proposed = said[said.index("<mujoco>") : said.index("</mujoco>")] + "</mujoco>"
    assert f"{proposed} inside <robot>" in said
    robot = _read(tmp_path, text.replace("</robot>", proposed + "</robot>"))
    assert [joint.name for joint in robot.joints] == ["turn", "turn2"][: 2 if more else 1]


def test_in_mjcf_it_has_another_place(tmp_path):
    text = """<mujoco><worldbody><body name="rod"><joint name="turn"/><inertial pos="0 0 0" mass="1"
      diaginertia=".1 .1 .5"/></body></worldbody></mujoco>"""
    said = _refusal(tmp_path, text, "robot.xml")
    option = '<compiler balanceinertia="true"/>'
    assert "body 'rod' is that of no rigid body" in said and f"{option} inside <mujoco>" in said
    _read(tmp_path, text.replace("<worldbody>", option + "<worldbody>"), "robot.xml")


def test_what_no_option_mends_is_said_to_be_corrected(tmp_path):
    matrix = INERTIAL.format(0.1, 0.1, 0.1, 0.5, mass=1)
    said = _refusal(tmp_path, URDF.format(rod=matrix, more=""))
    assert "link 'rod' is not positive definite; correct ixx to iyz" in said
    (tmp_path / "rod.dae").write_text("<COLLADA/>")
    collada = COLLISION.replace("meshes/rod.stl", "rod.dae")
    said = _refusal(tmp_path, URDF.format(rod=GOOD + collada, more=""))
    assert "rod.dae" in said and "convert it to STL or OBJ" in said
    assert "bad format in attribute" in _refusal(tmp_path, URDF.format(rod=GOOD, more="").replace(
        'ixx="0.01"', 'ixx="${i}"'
    ))  # fmt: skip


def test_a_mesh_that_touches_is_not_needed_on_a_stand(tmp_path):
    text = URDF.format(rod=GOOD + COLLISION, more="")
    said = _refusal(tmp_path, text)
    assert "meshes/rod.stl is missing, and body 'rod' needs it for its contacts" in said
    assert str(tmp_path) in said and 'base = "fixed", nothing touches' in said
    robot = _read(tmp_path, text, base="fixed")
    assert robot.model.ngeom == 0 and robot.model.body("rod").mass == 1.0
    # Its inertia would come from the mesh here, and an object that is not driven stands on it.
    weigh = text.replace("</robot>", '<mujoco><compiler inertiafromgeom="true"/></mujoco></robot>')
    with pytest.raises(UserError, match="needs it for its inertia"):
        _read(tmp_path, weigh, base="fixed")
    loose = """<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody>
      <body><joint name="j"/><geom size=".1"/></body><body name="box"><freejoint/><inertial
      pos="0 0 0" mass="1" diaginertia="1 1 1"/><geom type="mesh" mesh="m"/></body></worldbody>
      </mujoco>"""
    with pytest.raises(UserError, match="body 'box' needs it for its contacts"):
        _read(tmp_path, loose, "loose.xml", base="fixed")


BODY = """<mujoco><worldbody><body><freejoint/><geom size=".1"/>
<body><joint name="hinge" axis="0 1 0" actuatorfrcrange="-5 5"/><geom size=".1" pos="0 0 -.3"/>
<body><joint type="slide"/><geom size=".1" pos="0 0 -.5"/><body><joint type="ball"/>
<geom size=".1" pos="0 0 -.6"/></body></body></body></body></worldbody>{0}</mujoco>"""


def test_an_mjcf_without_actuators_gets_a_motor_for_each_joint(tmp_path):
    robot = _read(tmp_path, BODY.format(""), "robot.xml")
    assert [(one.name, one.kind) for one in robot.joints] == [
        ("hinge", "motor"), ("joint 2", "motor"),
    ]  # fmt: skip
    assert all(np.isnan([one.kp, one.kd]).all() for one in robot.joints)
    assert (robot.joints[0].force_low, robot.joints[0].force_high) == (-5.0, 5.0)
    (said,) = [item for item in robot.findings if item.field == "actuator"]
    assert said.value == "none in the model" and "every hinge and slide joint" in said.advice
    one = _read(tmp_path, BODY.format(""), "robot.xml", joints=["hin.*"])
    assert [joint.name for joint in one.joints] == ["hinge"] and one.model.nactuator == 1
    with pytest.raises(UserError, match="no joint matches 'knee'; .*hinge"):
        _read(tmp_path, BODY.format(""), "robot.xml", joints=["knee"])
    with pytest.raises(UserError, match="is not a regular expression"):
        _read(tmp_path, BODY.format(""), "robot.xml", joints=["("])
    some = _read(tmp_path, BODY.format('<actuator><motor joint="hinge"/></actuator>'), "some.xml")
    assert [one.name for one in some.joints] == ["hinge"]
    assert not [item for item in some.findings if item.field == "actuator"]


def test_without_joints_there_is_nothing_to_drive(tmp_path):
    text = "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body></worldbody></mujoco>"
    assert "no actuators, and no hinge or slide joints" in _refusal(tmp_path, text, "robot.xml")
    assert mujoco.MjModel.from_xml_string(text).nv == 6
