"""Gains in the files that training runs write: several robots, and what stands beside the gains."""

import math
import re

import pytest

from jaxact.environments.gain_formats import JointGains, text
from jaxact.errors import UserError
from jaxact.gains import reading
from jaxact.gains.table import matched
from jaxact.loops.reading import parse

JOINTS = [("hip", "hip"), ("knee", "knee")]
ROBOT = """{init_state: {joint_pos: {.*: 0.1}}, actuators: {legs: {joint_names_expr: ['%s'],
    stiffness: %s, damping: 1.0, joint_parameter_lookup: [[1.0, 2.0]]}}}"""
ENV = f"""
decimation: 4
sim: {{dt: 0.005}}
actions: {{joint_pos: {{scale: 0.25, asset_name: robot}}}}
scene:
  robot: {ROBOT % (".*", 20.0)}
"""


def write(tmp_path, content, name="env.yaml"):
    file = tmp_path / name
    file.write_text(content)
    return file


def kp(file):
    return matched(reading.read(file), JOINTS).parameters["kp"]


def test_one_of_several_robots_is_named(tmp_path):
    file = write(tmp_path, ENV + f"  robot2: {ROBOT % ('.*', 40.0)}\n")
    words = f"has several robots, scene.robot and scene.robot2, .*name one: {file}:scene.robot$"
    with pytest.raises(UserError, match=words):
        kp(file)
    for name, value in (("scene.robot", 20.0), ("robot2", 40.0), ("scene.robot2", 40.0)):
        assert kp(f"{file}:{name}") == {"hip": value, "knee": value}
    with pytest.raises(UserError, match="has no single robot 'robot3'; did you mean"):
        kp(f"{file}:robot3")
    with pytest.raises(UserError, match="has no robots with names"):
        kp(f"{write(tmp_path, 'kps: [1]', 'gym.yaml')}:robot")
    with pytest.raises(UserError, match="only a Python source and an env.yaml"):
        kp(f"{write(tmp_path, '[kp]', 'gains.toml')}:robot")


def test_a_specification_names_one_of_them_too(tmp_path):
    file = write(tmp_path, ENV + f"  robot2: {ROBOT % ('.*', 40.0)}\n")
    write(tmp_path, "<mujoco/>", "legs.xml")
    text = '[plant]\nmodel = "legs.xml"\ngains = "env.yaml:%s"\n[axes]\nkp = [1]\n'
    plant = parse(text % "scene.robot2", tmp_path).plant
    assert plant is not None and plant.gains == f"{file}:scene.robot2"
    assert kp(plant.gains) == {"hip": 40.0, "knee": 40.0}
    with pytest.raises(UserError, match="plant.gains = 'other.yaml': no such file"):
        parse(text.replace("env.yaml", "other.yaml") % "scene.robot2", tmp_path)


def test_robots_with_other_joints_or_the_same_gains_need_no_name(tmp_path):
    for pattern, value in (("door", 40.0), (".*", 20.0)):
        file = write(tmp_path, ENV + f"  cabinet: {ROBOT % (pattern, value)}\n")
        assert kp(file) == {"hip": 20.0, "knee": 20.0}


def test_robots_of_mjlab_have_names(tmp_path):
    group = "{target_names_expr: ['.*'], stiffness: %s, damping: 1.0}"
    robot = "{articulation: {actuators: [" + group + "]}}"
    file = write(tmp_path, f"scene: {{entities: {{one: {robot % 20.0}, two: {robot % 40.0}}}}}")
    assert kp(f"{file}:two")["hip"] == 40.0
    with pytest.raises(UserError, match=re.escape("scene.entities.one and scene.entities.two")):
        kp(file)


def test_what_a_file_of_a_run_has_beside_the_gains_is_listed(tmp_path):
    (notes,) = reading.read(write(tmp_path, ENV)).notes
    assert set(notes.split(": ")[1].split(", ")) == {
        "joint_parameter_lookup", "init_state.joint_pos", "decimation", "sim.dt",
        "actions.joint_pos.scale",
    }  # fmt: skip
    gym = "kps: [1, 2]\nkds: [1, 2]\ncontrol_decimation: 10\naction_scale: 0.25\n"
    notes = reading.read(write(tmp_path, gym)).notes
    assert "not taken from it: control_decimation, action_scale" in notes
    legged = "control: {stiffness: {hip: 1}, damping: {hip: 1}}\nsim: {dt: 0.005}\n"
    legged += "init_state: {default_joint_angles: {hip: 0.1}}\n"
    assert reading.read(write(tmp_path, legged)).notes == (
        "not taken from it: sim.dt, init_state.default_joint_angles",
    )


def test_limits_of_some_joints_are_written_and_read_back(tmp_path):
    joints = JointGains(("hip", "knee"), (1.0, 2.0), (0.1, 0.2), (9.0, math.inf))
    file = write(tmp_path, text(joints, "isaaclab", "a test"), "gains.py")
    found = matched(reading.read(file), JOINTS).parameters
    assert found["force_limit"] == {"hip": 9.0, "knee": math.inf}


def test_a_limit_that_stands_for_none_is_read_as_none(tmp_path):
    source = 'A = {"legs": LegCfg(joint_names_expr=[".*"], stiffness=1.0, damping=1.0,'
    source += ' effort_limit={"hip": 9.0, "knee": 1e9})}\n'
    found = matched(reading.read(write(tmp_path, source, "a.py")), JOINTS).parameters
    assert found["force_limit"] == {"hip": 9.0, "knee": math.inf}
