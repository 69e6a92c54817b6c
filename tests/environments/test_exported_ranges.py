"""Ranges of force and setpoint in exported files, against MuJoCo and numbers by hand."""

import math
import os
import subprocess
from pathlib import Path

import mujoco
import numpy as np
import pytest
from command_line import jaxact

import jaxact as jx
from jaxact.environments.torch_export import RANGED
from jaxact.errors import UserError
from jaxact.loops import robots

ROOT = Path(__file__).resolve().parents[2]
PYTHON = ROOT / ".torch" / "bin" / "python"
STUBS = Path(__file__).parent / "torch_stubs"
needs_torch = pytest.mark.skipif(
    not PYTHON.exists(), reason="needs .torch, which `make test` builds where torch can be had"
)
BODY = (
    '<body pos="{0} 0 0"><joint name="{1}" axis="0 1 0" damping="{2}" armature="0.01"/>'
    '<geom size="0.05" pos="0 0 -0.2"/></body>'
)
ACTUATORS = (
    '<position joint="hip" kp="60" kv="2" forcerange="-1 20" ctrlrange="-0.4 0.5" gear="2"/>'
    '<position joint="knee" kp="40" kv="1" forcerange="-9 9"/>'
)


def model_of(damping="0", actuators=ACTUATORS):
    bodies = "".join(BODY.format(i, name, damping) for i, name in enumerate(("hip", "knee")))
    return f"<mujoco><worldbody>{bodies}</worldbody><actuator>{actuators}</actuator></mujoco>"


@pytest.fixture
def model(tmp_path):
    file = tmp_path / "legs.xml"
    file.write_text(model_of())
    return file


def moved(text):
    """Positions of the model under controls that reach every limit, by MuJoCo."""
    compiled = mujoco.MjModel.from_xml_string(text)
    data, found = mujoco.MjData(compiled), []
    scale = np.abs(compiled.actuator_gear[:, 0])
    for step in range(400):
        data.ctrl = scale * np.sin(0.05 * step + np.array([0.0, 1.0]))
        mujoco.mj_step(compiled, data)
        found.append(data.qpos.copy())
    return np.array(found)


def section(text):
    return text[text.index("<actuator>") + 10 : text.index("</actuator>")]


def test_mjcf_carries_both_ranges(model):
    """The written servos, at the joints, move the model as its own do; also from there again."""
    text = jx.export(model, "mjcf").text
    expected = moved(model_of())
    np.testing.assert_allclose(moved(model_of(actuators=section(text))), expected, atol=1e-9)
    bare = section(text).replace('forcerange="-2.0 40.0"', 'forcerange="-40 40"')
    assert np.abs(moved(model_of(actuators=bare)) - expected).max() > 0.01
    again = model.with_name("again.xml")
    again.write_text(text)
    found = jx.export(again, "mjcf")
    assert 'forcerange="-2.0 40.0"' in found.text and found.joints.force_limit == (math.inf, 9.0)
    assert "limits of its setpoints (ctrlrange) are not taken" in found.lost[0]
    robot = robots.read(jx.robot(model, gains=again).kind.plant)
    assert [(one.force_low, one.force_high) for one in robot.joints] == [(-2, 40), (-9, 9)]


@pytest.mark.parametrize("to", ("toml", "deploy-yaml", "rl-gym", "legged-gym"))
def test_other_formats_say_what_is_lost(model, to):
    found = jx.export(model, to)
    words = ("force limits that differ by direction, hip -2 to 40", "setpoint limits, hip -0.2 to")
    for one in words:
        assert one in found.text and any(one in line for line in found.lost)
    assert "drive behind" not in found.text


def test_the_command_line_says_it_too(model):
    done = jaxact("export", model.name, "--to", "toml", cwd=model.parent)
    assert "hip -2 to 40" in done.stderr and "hip -0.2 to 0.25" in done.stderr


@pytest.mark.parametrize("to", ("isaaclab", "mjlab"))
def test_a_limit_by_direction_is_a_drive_in_torch(model, to):
    found = jx.export(model, to)
    rows = ("lowest_force=-2.0", "highest_force=40.0", "lowest_setpoint=-0.2")
    assert all(row in found.text for row in rows) and not found.lost
    alike = model.with_name("alike.xml")
    alike.write_text(model_of(actuators=ACTUATORS.replace("-1 20", "-20 20")))
    plain = jx.export(alike, to)
    assert "torch" not in plain.text and "setpoint limits, hip -0.2 to 0.25" in plain.lost[0]


# In torch: ideal drives, whose forces are those of a PD law, clamped; then what is refused.
RUN = """
import importlib.util, json, sys, torch
spec = importlib.util.spec_from_file_location("drive", sys.argv[1])
drive = sys.modules["drive"] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(drive)
forces = []
for cfg in drive.ACTUATORS:
    one = drive.Drive(cfg.drive, 0.001, 1, 1, "cpu")
    rows = []
    for setpoint in (0.0, 1.0, -1.0, 0.1):
        numbers = cfg.stiffness, cfg.damping, cfg.effort_limit or torch.inf, setpoint, 0, 0, 0.05, 2
        force, _ = one.step(*(torch.full((1, 1), float(one)) for one in numbers))
        rows.append(float(force))
    forces.append(rows)
said = {}
for bad in json.loads(sys.argv[2]):
    given = eval(bad)
    try:
        made = drive.DriveParameters(**given)
    except ValueError as error:
        said[bad] = str(error)
late = drive.DriveParameters()
late.delay = -1.0
try:
    drive.Drive(late, 0.001, 1, 1, "cpu")
except ValueError as error:
    said["late"] = str(error)
made = drive.Drive(drive.DriveParameters(), 0.001, 3, 2, "cpu")
try:
    made.step(*[torch.zeros(3, 2)] * 6, torch.zeros(2), torch.zeros(3, 2))
except ValueError as error:
    said["shape"] = str(error)
good = [eval(one) for one in json.loads(sys.argv[3])]
[drive.Drive(drive.DriveParameters(**one), 0.001, 2, 2, "cpu") for one in good]
print(json.dumps([forces, said]))
"""
BAD = {
    "{'delay': -0.01}": "delay = -0.01 is out of range; give at least 0",
    "{'delay': float('nan')}": "delay = nan; give a number",
    "{'delay': float('inf')}": "delay = inf is infinite",
    "{'delay': 11}": "delay = 11 is out of range; give at most 10 [s]",
    "{'setpoint_delay': (0.0, 8.0e2)}": "setpoint_delay = (0.0, 800.0) is out of range; give at",
    "{'delay': (0.008, 0.002)}": "ends below where it begins",
    "{'delay': (0.001, 0.002, 0.003)}": "give a number, or a range",
    "{'delay': (0.001,)}": "give a number, or a range",
    "{'delay': '2ms'}": "delay = '2ms'; give a number",
    "{'delay': True}": "delay = True; give a number",
    "{'control_rate': 0}": "control_rate = 0 is out of range; give above 0",
    "{'control_rate': (500.0, 1000.0)}": "cannot have a range",
    "{'wn': 0.0}": "wn = 0.0 is out of range",
    "{'wn': (100.0, float('inf'))}": "is infinite",
    "{'zeta': -1}": "zeta = -1 is out of range",
    "{'position_noise': -1e-3}": "give at least 0",
    "{'stall_force': 5.0}": "needs both",
    "{'lowest_force': 3.0, 'highest_force': 2.0}": "is above",
    "{'velocity': 'foo'}": "velocity = 'foo'; allowed: sampled, differenced",
    "{'each_joint': 'yes'}": "each_joint = 'yes'",
}
GOOD = (
    "{}", "{'delay': (0.0, 0.01), 'wn': 100, 'feedforward': -3.0}", "{'delay': [0.0, 0.01]}",
    "{'stall_force': 5.0, 'no_load_speed': 9.0}",
)  # fmt: skip


@pytest.mark.exhaustive
@needs_torch
def test_torch_clamps_as_the_model_does_and_refuses_what_no_drive_has(model):
    import json

    file = model.with_name("drive.py")
    jx.export(model, "mjlab", file)
    ran = subprocess.run(
        [PYTHON, "-c", RUN, file, json.dumps([*BAD]), json.dumps(GOOD)],
        capture_output=True, text=True,
        env=os.environ | {"PYTHONPATH": str(STUBS), "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    forces, said = json.loads(ran.stdout)
    asked = np.array([0.0, 1.0, -1.0, 0.1])
    hip = 240 * (np.clip(asked, -0.2, 0.25) - 0.05) - 8 * 2  # of the joint: gear 2
    knee = 40 * (asked - 0.05) - 2
    expected = [np.clip(hip, -2, 40), np.clip(knee, -9, 9)]
    np.testing.assert_allclose(forces, expected, rtol=1e-5)
    assert (np.abs(expected[0]) == 2).any() and expected[0].max() == 32.0
    assert {*BAD, "late", "shape"} == said.keys()
    assert said["shape"].startswith("position has shape (2,); that of this drive is (3, 2), env")
    for bad, words in BAD.items():
        assert words in said[bad] and "\n" not in said[bad]


def test_every_parameter_that_a_file_can_have_is_known_in_torch():
    source = ROOT / "jaxact" / "environments" / "torch_sources" / "parameters.py"
    assert all(f"    {name}: Number" in source.read_text() for name in RANGED)


@pytest.mark.parametrize("name", ("kp", "kd"))
def test_gains_that_no_file_may_have_are_not_written(model, name):
    with pytest.raises(UserError, match=f"`{name}` = -5: gains in files are not negative"):
        jx.export(model, "mjcf", parameters={name: -5.0})


@pytest.mark.parametrize("to", ("mjlab", "isaaclab", "toml"))
def test_half_a_torque_speed_line_of_a_joint_is_not_written(model, to):
    line = {"stall_force": {"hip": 20.0, "knee": 10.0}, "no_load_speed": {"knee": 9.0}}
    with pytest.raises(UserError, match="^no_load_speed of hip: a torque-speed line needs"):
        jx.export(model, to, parameters=line)


def test_damping_is_spoken_of_where_there_is_some(tmp_path):
    for damping, words in (("0", ()), ("0.3", ("take that out of the simulated model",))):
        file = tmp_path / "legs.xml"
        file.write_text(model_of(damping))
        lost = jx.export(jx.robot(file, damping="drive", kd=1.0), "mjcf").lost
        assert len(lost) == len(words) and all(one in lost[0] for one in words)


def test_what_smooths_setpoints_is_left_out_aloud(tmp_path):
    file = tmp_path / "legs.xml"
    file.write_text(model_of(actuators=ACTUATORS.replace('kv="1"', 'kv="1" timeconst="0.05"')))
    for to in ("mjcf", "isaaclab"):
        found = jx.export(file, to)
        assert found.lost == ("Left out: what smooths the setpoint of actuator 1",)
        assert found.lost[0] in found.text


def test_options_of_a_model_are_refused_beside_a_specification(model):
    file = model.with_name("sweep.toml")
    file.write_text(f'[plant]\nmodel = "{model.name}"\n[axes]\nkd = [2.0]\n')
    assert len(jx.export(file, "toml", keyframe=None).joints.names) == 2
    done = jaxact("export", file.name, "--to", "toml", "--joints", "hip", cwd=model.parent)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == (
        "jaxact: --joints: is for a model, and sweep.toml is a specification: write it there\n"
    )


def test_a_file_may_have_one_gain_of_a_joint(model):
    file = model.with_name("gains.toml")
    for text, words in (
        ("[kp]\nhip = 7\n", "gains of 1 joint; no kd of hip, which stays as the model has it"),
        ("[kd]\nhip = 7\n", "gains of 1 joint; no kp of hip, which stays as the model has it"),
        ("[kp]\nhip = 7\nknee = 8\n[kd]\nknee = 1\n", "gains of 2 joints; no kd of hip, which"),
    ):
        file.write_text(text)
        robot = robots.read(jx.robot(model, gains=file).kind.plant)
        assert words in robot.findings[-1].advice
        own = robot.joints[0]
        assert (own.kp, own.kd) == ((240.0, 7.0) if "[kp]" not in text else (7.0, 8.0))
    file.write_text("[force_limit]\nhip = 7\n")
    with pytest.raises(UserError, match=r"has no table \[kp\] or \[kd\] of joint = number"):
        robots.read(jx.robot(model, gains=file).kind.plant)


def test_a_misspelt_joint_is_said_once_on_the_command_line(model):
    file = model.with_name("gains.toml")
    file.write_text("[kp]\nhp = 7\nknee = 8\n[kd]\nhip = 1\nknee = 1\n")
    with pytest.warns(jx.GainsWarning, match=r"gains\.toml: of none of the robot's joints: hp"):
        assert jx.margins(jx.robot(model, gains=file)) is not None
    for words in (("margins", "--model"), ("check",), ("export", "--to", "toml")):
        done = jaxact(*words, model.name, "--gains", file.name, cwd=model.parent)
        assert done.stderr.count("robot's joints: hp") == 1
