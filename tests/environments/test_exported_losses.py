"""What exported files cannot say of a robot's drives and joints is refused or said, never lost."""

import re
import tomllib

import numpy as np
import pytest
from command_line import jaxact

import jaxact as jx
from jaxact.errors import UserError

BODY = '<body><joint name="{0}" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.2"/></body>'
ACTUATORS = (
    '<position joint="left_hip" kp="60" kv="2" forcerange="-20 20"/>'
    '<position joint="left-knee" kp="40" kv="1"/>'
)
PATTERNS = '[kp]\n".*_hip" = 40.0\n".*-knee" = 60.0\n[kd]\n".*_hip" = 1.0\n".*-knee" = 2.0\n'
FORMATS = ("isaaclab", "mjlab", "mjcf", "toml", "deploy-yaml", "rl-gym", "legged-gym")


@pytest.fixture
def model(tmp_path):
    bodies = "".join(BODY.format(name) for name in ("left_hip", "left-knee"))
    file = tmp_path / "legs.xml"
    file.write_text(
        f"<mujoco><worldbody>{bodies}</worldbody><actuator>{ACTUATORS}</actuator></mujoco>"
    )
    return file


@pytest.mark.parametrize("to", FORMATS)
def test_patterns_need_the_joints_that_they_match(model, to):
    file = model.with_name("patterns.toml")
    file.write_text(PATTERNS)
    words = r"'\.\*_hip' is a pattern, and does not name every joint.*give its `model`"
    with pytest.raises(UserError, match=words):
        jx.export(file, to)
    placed = jx.export(file, to, model=model).joints
    assert (placed.names, placed.kp, placed.kd) == (
        ("left_hip", "left-knee"), (40.0, 60.0), (1.0, 2.0)
    )  # fmt: skip


def test_the_command_line_says_which_option_patterns_need(model):
    model.with_name("patterns.toml").write_text(PATTERNS)
    done = jaxact("export", "patterns.toml", "--to", "isaaclab", cwd=model.parent)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.endswith("the robot; give its --model as well\n")


@pytest.mark.parametrize("name", ("gains", "drive"))
def test_a_source_is_given_once(model, name):
    file = model.with_name(f"{name}.toml")
    jx.export(model, "toml", file)
    if name == "drive":
        file.write_text('plant = "none"\nunit = "rad"\nestimates = {}\nloop = [{delay = 0.003}]\n')
    words = f"`{name}`: the source is a .*{name}.* already; leave one of them out"
    with pytest.raises(UserError, match=words):
        jx.export(file, "mjcf", model=model, **{name: file})
    if name == "gains":
        assert jx.export(file, "mjcf", model=model, gains=None).joints.kp == (60.0, 40.0)
        line = ("export", file.name, "--to", "mjcf", "--model", model.name, "--gains", file.name)
        done = jaxact(*line, cwd=model.parent)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
        assert "--gains: the source is a file of gains already" in done.stderr


def test_names_in_full_need_no_model(model):
    """Also of a file that was exported; where they are taken they match the joints of the robot."""
    file = model.with_name("names.toml")
    jx.export(model, "toml", file)
    assert jx.export(file, "toml").joints.names == ("left_hip", "left-knee")
    table = eval(re.search(r"joint_names_expr=(\[.*\])", jx.export(file, "isaaclab").text)[1])
    matched = [bool(re.fullmatch(one, name)) for one in table for name in ("left_hip", "left-knee")]
    assert matched == [True, False, False, True]
    assert tomllib.loads(file.read_text())["kp"] == {"left_hip": 60.0, "left-knee": 40.0}


@pytest.mark.parametrize("to", ("isaaclab", "mjlab"))
def test_a_range_of_the_force_limit_is_a_drive_in_torch(model, to):
    """Of the joint that has one; the other, and a limit that is fixed, stay as they are."""
    found = jx.export(model, to, parameters={"force_limit": {"left-knee": (5.0, 10.0)}})
    hip, knee = found.text[found.text.index("\nACTUATORS") :].split("left\\\\-knee")
    assert "effort_limit=20.0" in hip and "force_limit" not in hip
    assert "force_limit=(5.0, 10.0)" in knee and "effort_limit" not in knee
    assert found.lost == ()
    fixed = jx.export(model, to, parameters={"force_limit": 10.0})
    assert "class DriveActuator" not in fixed.text and fixed.lost == ()


@pytest.mark.parametrize("to", FORMATS[2:])
def test_where_a_range_of_the_force_limit_has_no_place_it_is_said(model, to):
    found = jx.export(model, to, parameters={"force_limit": {"left-knee": (5.0, 10.0)}})
    (lost,) = [one for one in found.lost if "force limits" in one]
    assert "force limits, 20, 5 to 10" in lost.replace("limits 20", "limits, 20")
    assert lost in found.text
    written = found.text.replace(lost, "")
    assert ("their upper ends are written" in lost) == ("10.0" in written)


def test_a_control_rate_that_is_given_is_a_drive(model):
    """Its controller runs at that rate, which one of plain gains has not: at every physics step."""
    specification = model.with_name("run.toml")
    text = (
        f'[plant]\nmodel = "{model.name}"\n[parameters]\ncontrol_rate = 100\n[axes]\nkd = [2.0]\n'
    )
    specification.write_text(text)
    loop = jx.robot(model, control_rate=100.0)
    words = "Left out, this format has no place for it: the drive behind the gains"
    for source, given in ((model, {"control_rate": 100.0}), (loop, None), (specification, None)):
        for to in ("mjlab", "isaaclab"):
            found = jx.export(source, to, parameters=given)
            assert found.text.count("control_rate=100.0,\n") == 2 and found.lost == ()
        for to in ("toml", "mjcf"):
            assert jx.export(source, to, parameters=given).lost == (words,)
    assert "class DriveActuator" not in jx.export(model, "mjlab").text


def test_what_is_a_joints_own_is_said_joint_by_joint(model):
    loop = jx.robot(
        model, joint_friction={"left_hip": 0.3}, joint_armature={".*knee": 0.01}, joint_damping=0.2
    )
    words = "joint_damping 0.2, joint_friction of left_hip 0.3, joint_armature of .*knee 0.01"
    for to in ("mjlab", "mjcf"):
        assert jx.export(loop, to).lost == (
            f"Left out, as the joint's and not the drive's: {words}",
        )
    single = jx.joint(kp=30.0, kd=1.0, joint_stiffness=2.0, delay=1e-3)
    assert jx.export(single, "mjlab").lost == (
        "Left out, as the joint's and not the drive's: joint_stiffness 2",
    )


def test_the_rate_of_a_policy_is_written_or_said(model):
    """Of a single joint as of a robot."""
    held = "Left out, as the environment's own step holds an action: policy_rate 50 Hz"
    nowhere = "Left out, this format has no place for it: the period of the policy, 0.02 s"
    robot = jx.robot(model, policy_rate=50.0)
    single = jx.joint(kp=20.0, kd=1.0, mass=1.0, policy_rate=50.0, delay=4e-3)
    for to in FORMATS:
        found = jx.export(robot, to)
        if to in ("deploy-yaml", "rl-gym"):
            assert re.search(r"^(step_dt|control_dt): 0\.02$", found.text, re.MULTILINE)
        else:
            assert (held if "lab" in to else nowhere) in found.lost
            assert found.lost[-1] in found.text
    for to in ("mjlab", "isaaclab"):
        assert jx.export(single, to).lost == (held,)


def test_a_factor_that_is_fixed_is_in_the_gains_of_its_joint(model):
    """Also where that of another joint is drawn from a range."""
    factor = np.array([2.0, 0.5]), np.array([2.0, 1.0])
    found = jx.export(model, "toml", parameters={"gain_scale": factor})
    assert (found.joints.kp, found.joints.kd) == ((120.0, 40.0), (4.0, 1.0))
    assert found.lost == ("Left out, this format has no place for it: the drive behind the gains",)
    text = jx.export(model, "mjlab", parameters={"gain_scale": factor}).text
    hip, knee = text[text.index("\nACTUATORS") :].split("left\\\\-knee")
    assert "stiffness=120.0" in hip and "gain_scale" not in hip
    assert "stiffness=40.0" in knee and "gain_scale=(0.5, 1.0)" in knee
