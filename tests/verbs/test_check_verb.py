"""`jaxact.check`: what is known of a robot before anything is simulated."""

import json

import mujoco
import numpy as np
import pytest
from robots import PENDULUM

import jaxact as jx
from jaxact.errors import UserError


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    file = tmp_path_factory.mktemp("check") / "pendulum.xml"
    file.write_text(PENDULUM)
    return file


@pytest.fixture(scope="module")
def found(path):
    return jx.check(jx.robot(path, keyframe="home", control_rate=500))


def test_what_is_driven_is_what_mujoco_has(path, found):
    model = mujoco.MjModel.from_xml_path(str(path))
    gains = model.actuator_gainprm[:, 0]
    assert [row["kp"] for row in found.joints] == gains.tolist()
    assert [row["kd"] for row in found.joints] == (-model.actuator_biasprm[:, 2]).tolist()
    assert [row["name"] for row in found.joints] == ["shoulder", "elbow"]
    assert {"mjx", "mujoco"} <= set(found.engines) and not found.refused


def test_the_delay_that_the_gains_bear_is_that_of_the_margins(path, found):
    loop = jx.robot(path, keyframe="home", control_rate=500, base="fixed",
                    integrator_correction=True)  # fmt: skip
    changes = jx.margins(loop).details[0].margins.changes
    assert found.on_stand.as_it_is.borne.delay == pytest.approx(changes.more_delay.value, rel=1e-6)
    assert found.on_stand.control_rate == 500.0


def test_behind_a_late_drive_the_gains_bear_that_much_less(path, found):
    late = jx.check(jx.robot(path, keyframe="home", control_rate=500, delay=1e-3))
    borne = found.on_stand.as_it_is.borne.delay
    assert late.on_stand.as_it_is.borne.delay == pytest.approx(borne - 1e-3, rel=1e-6)
    assert "at 500 Hz, behind these drives, the gains bear" in repr(late)
    assert json.loads(late.to_json())["on_stand"]["drive"] == {"delay": 1e-3}


def test_printed_it_names_parameters_and_not_options(found):
    said = repr(found)
    assert "On a stand, at 500 Hz, the gains bear" in said and "shoulder" in said
    assert "--" not in said


def test_json_has_the_same(found):
    document = json.loads(found.to_json())
    assert document["joints"] == found.joints and document["keyframe"] == "home"
    share = list(document["on_stand"]["as_it_is"]["participation"].values())
    assert np.sum(share) == pytest.approx(1.0)


def test_a_joint_is_not_checked():
    with pytest.raises(UserError, match=r"jaxact\.robot"):
        jx.check(jx.joint())
