"""Gains in an <actuator> section without its model: as MuJoCo takes them in one, or refused."""

import mujoco
import numpy as np
import pytest

from jaxact.errors import UserError
from jaxact.gains import reading
from jaxact.gains.table import FORCE_HIGH, FORCE_LOW, matched
from jaxact.parameters import FORCE_LIMIT, KD, KP

JOINTS = ("hip", "knee")
TREE = "".join(
    f'<body><joint name="{one}" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.2"/></body>'
    for one in JOINTS
)
KNEE = '<position joint="knee" kp="3" kv="0.2"/>'


def read(folder, actuators, before=""):
    file = folder / "section.xml"
    file.write_text(f"<mujoco>{before}<actuator>{actuators}</actuator></mujoco>")
    return reading.read(file)


def by_mujoco(actuators, before=""):
    """kp and kd at the joints, and the ends of the force there, of MuJoCo's model."""
    text = f"<mujoco>{before}<worldbody>{TREE}</worldbody><actuator>{actuators}</actuator></mujoco>"
    model = mujoco.MjModel.from_xml_string(text)
    gear = model.actuator_gear[:, 0]
    limited = model.actuator_forcelimited.astype(bool)[:, None]
    ends = np.where(limited, np.sort(gear[:, None] * model.actuator_forcerange), [-np.inf, np.inf])
    return *(-model.actuator_biasprm[:, 1:3] * gear[:, None] ** 2).T, *ends.T


@pytest.mark.parametrize("limited", ("", 'forcelimited="auto"', 'forcelimited="true"',
                                     'forcelimited="false"'))  # fmt: skip
@pytest.mark.parametrize("ends", ("-4 4", "-1 4"))
def test_what_a_section_says_is_what_mujoco_takes(tmp_path, limited, ends):
    """Also beside defaults of what is none of actuators, and classes that nothing has."""
    row = f'<position joint="hip" kp="10" kv="1" gear="-3" forcerange="{ends}" {limited}/>{KNEE}'
    before = '<default><joint armature="0.1"/><default class="a"><position gear="5"/></default>'
    before += "</default>"
    found = matched(read(tmp_path, row, before), [(one, one) for one in JOINTS]).parameters
    kp, kd, low, high = by_mujoco(row, before)
    assert [found[KP][one] for one in JOINTS] == pytest.approx(kp)
    assert [found[KD][one] for one in JOINTS] == pytest.approx(kd)
    limit = found.get(FORCE_LIMIT, {}).get("hip", np.inf)
    assert max(found.get(FORCE_LOW, {}).get("hip", -np.inf), -limit) == low[0]
    assert min(found.get(FORCE_HIGH, {}).get("hip", np.inf), limit) == high[0]


@pytest.mark.parametrize("kind", ("position", "general"))
def test_defaults_of_actuators_need_the_model(tmp_path, kind):
    """They would count: MuJoCo's gains are 9 times those that the element says."""
    row, before = '<position joint="hip" kp="10" kv="1"/>', f'<default><{kind} gear="3"/></default>'
    assert by_mujoco(row + KNEE, before)[0][0] == 90.0
    with pytest.raises(UserError, match=f"its <default> has <{kind}>.*; give the whole model"):
        read(tmp_path, row, before)


@pytest.mark.parametrize("what", ("class", "tendon", "jointinparent", "site", "body"))
def test_what_only_the_model_knows_needs_it(tmp_path, what):
    with pytest.raises(UserError, match=f"<position name='hip'> has a {what}; give the whole"):
        read(tmp_path, f'<position name="hip" {what}="a" kp="2" kv="0.1"/>{KNEE}')


def test_several_servos_of_a_joint_are_refused(tmp_path):
    """Their forces add up in MuJoCo: neither has the gains of the joint."""
    rows = KNEE + '<position name="other" joint="knee" kp="5" kv="0.1"/>'
    stiffness, *_ = by_mujoco(rows)
    assert stiffness.tolist() == [3.0, 5.0]
    with pytest.raises(UserError, match="has several <position joint='knee'>, whose forces add up"):
        read(tmp_path, rows)


def test_a_joint_named_by_itself_and_by_its_actuator_is_refused(tmp_path):
    """Neither servo has the gains of the joint, on which both would act."""
    servo = '<position name="knee_servo" kp="%g" kv="0.2"/>'
    joints = [("hip", "hip_servo"), ("knee", "knee_servo")]
    words = "'knee' and 'knee_servo' both give kp of knee; leave one of them out"
    with pytest.raises(UserError, match=words):
        matched(read(tmp_path, KNEE + servo % 5), joints)
    for rows in (servo % 3 + KNEE, servo % 3):  # the same twice, or once
        assert matched(read(tmp_path, rows), joints).parameters[KP] == {"knee": 3.0}


def test_what_is_not_taken_is_said(tmp_path):
    row = (
        '<position joint="hip" kp="3" kv="0.2" ctrlrange="-1 1" timeconst="0.05"/><motor name="b"/>'
        '<general joint="knee" gainprm="50" biasprm="0 -50 -2" biastype="affine"/><pid name="c"/>'
    )
    assert read(tmp_path, row).notes == (
        "limits of its setpoints (ctrlrange) are not taken",
        "filters and delays of its setpoints (timeconst) are not taken",
        "its other actuators are not taken: <general joint='knee'>, <pid name='c'>",
    )
    assert read(tmp_path, KNEE).notes == ()
