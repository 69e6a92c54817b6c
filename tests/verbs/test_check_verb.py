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


HINGE = """<mujoco><option {option}/><worldbody><body><joint name="j" axis="0 1 0"/>
<geom size=".1" pos="0 0 -.3"/></body></worldbody><actuator><{actuator} joint="j"/></actuator>
</mujoco>"""


@pytest.fixture
def written(tmp_path):
    def write(option, actuator):
        path = tmp_path / "hinge.xml"
        path.write_text(HINGE.format(option=option, actuator=actuator))
        return path

    return write


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("own", "given", "used", "why"),
    [
        (0.005, {}, 0.001, " (the model's 5 ms exceeds the control period)"),
        (0.0003, {}, 0.00025, " (the model's 0.3 ms does not divide the control period)"),
        (0.0005, {}, 0.0005, ""),
        (0.005, {"control_rate": 200}, 0.005, ""),
        (0.005, {"physics_step": 0.0005}, 0.0005, ""),
    ],
)
def test_the_physics_step_is_the_one_that_is_used(written, own, given, used, why):
    path = written(f'timestep="{own}"', "motor")
    loop = jx.robot(path, kp=10.0, kd=1.0, **given)
    found = jx.check(loop)
    assert json.loads(found.to_json())["physics_step"] == pytest.approx(used)
    said = f", physics step {1e3 * used:g} ms{why}"
    assert f"{said} default posture" in " ".join(repr(found).split())
    assert f"{said}, mujoco" in repr(jx.margins(loop))


def test_a_velocity_servo_has_a_kp_of_0(written):
    found = jx.check(jx.robot(written("", 'velocity kv="1"')))
    assert '"kp": 0.0' in found.to_json() and " -0 " not in repr(found)


def test_a_group_that_is_switched_off_is_named_where_nothing_can_be_driven(written):
    loop = jx.robot(written('actuatorgroupdisable="2"', 'position group="2"'))
    said = r"can be driven, as <option actuatorgroupdisable> switches off actuator 0 \(group 2\)"
    with pytest.raises(UserError, match=said):
        jx.margins(loop)


def test_shaking_and_toppling_have_each_their_own_rate(tmp_path):
    """An upright pendulum held too weakly, and a hanging one with too little kd."""
    file = tmp_path / "two.xml"
    body = (
        '<body pos="{0} 0 1"><joint name="{1}" axis="0 1 0"/><geom type="capsule" size=".02"'
        ' fromto="0 0 0 0 0 {2}" mass="1"/></body>'
    )
    servo = '<position name="{0}" joint="{0}" kp="{1}" kv="{2}"/>'
    bodies = body.format(0, "weak", 0.3) + body.format(1, "shaky", -0.3)
    servos = servo.format("weak", 0.5, 0.01) + servo.format("shaky", 60, 0.06)
    file.write_text(
        '<mujoco><option timestep="0.001"/><worldbody>'
        f"{bodies}</worldbody><actuator>{servos}</actuator></mujoco>"
    )
    loop = jx.robot(file, control_rate=1000, delay=6e-4, integrator_correction=True)
    found = jx.check(loop)
    borne = found.on_stand.as_it_is.borne
    # The upright one without delay: I s^2 + kd s + kp - m g l = 0, and a delay changes little.
    model = mujoco.MjModel.from_xml_path(str(file))
    held = mujoco.MjData(model)
    mujoco.mj_forward(model, held)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, held, inertia)
    falls = np.roots([inertia[0, 0], 0.01, 0.5 - 1.0 * 9.81 * 0.15]).max()
    assert borne.toppling_rate == pytest.approx(falls, rel=0.02)
    alone = jx.margins(loop)
    assert borne.shaking_rate == pytest.approx(float(alone.shaking_rate), rel=1e-6)
    assert 0.0 < borne.shaking_rate < 0.1 * borne.toppling_rate
    said = " ".join(repr(found).split())
    assert f"growing by {borne.shaking_rate:.3g} 1/s, and do not stop what leaves" in said
    assert f"the posture, by {borne.toppling_rate:.3g} 1/s" in said


def test_a_differenced_velocity_is_looked_at_as_such(path):
    given = {"keyframe": "home", "control_rate": 500, "velocity": "differenced"}
    filtered = {"velocity_filter": 300.0, **given}
    loop = jx.robot(path, base="fixed", integrator_correction=True, **filtered)
    changes = jx.margins(loop).details[0].margins.changes
    borne = jx.check(jx.robot(path, **filtered)).on_stand.as_it_is.borne
    assert borne.delay == pytest.approx(changes.more_delay.value, rel=1e-6)
