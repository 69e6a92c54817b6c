"""`jaxact check` as a person meets it."""

import json
import math

import mujoco
import numpy as np
import pytest
from command_line import jaxact
from quickly import compiled_quickly as compiled_quickly

from jaxact.robots import inertia
from jaxact.robots import model as models

ROBOT = """<mujoco><worldbody><body name="base" pos="0 0 1"><freejoint/><geom size="0.2" mass="9"/>
  <body pos="0.2 0 0"><joint name="hip" axis="0 1 0" damping="0.3"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1"/>
  <body pos="0.3 0 0"><joint name="knee" axis="0 1 0" armature="0.01"/>
  <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.5"/></body></body></body>
  </worldbody>
  <actuator><position name="hip" joint="hip" kp="40" kv="2" forcerange="-30 30"/>{more}</actuator>
  <keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.3 -0.6" {ctrl}/></keyframe></mujoco>"""
KNEE = '<motor name="m" joint="knee" gear="2" ctrlrange="-1 3" delay="0.004" nsample="3"/>'
DCMOTOR = '<dcmotor name="dc" joint="knee" motorconst="0.1" resistance="1"/>'


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text(ROBOT.format(more=KNEE, ctrl='ctrl="0.3 0"'))
    return path


def test_json_says_what_is_driven_and_how(robot):
    before = robot.read_text()
    ran = jaxact("check", robot, "--keyframe", "home", "--json")
    assert ran.returncode == 0 and ran.stderr == ""
    report = json.loads(ran.stdout)
    assert report["engines"][:2] == ["mjx", "mujoco"] and report["degrees_of_freedom"] == 8
    hip, knee = report["joints"]
    assert (hip["kind"], hip["kp"], hip["kd"], hip["setpoint"]) == ("position", 40.0, 2.0, 0.3)
    assert hip["force_limits"] == [-30.0, 30.0] and hip["setpoint_limits"] == [None, None]
    assert (knee["kind"], knee["kp"], knee["bandwidth"]) == ("motor", None, None)
    assert knee["force_limits"] == [-2.0, 6.0] and knee["delay"] == pytest.approx(0.004)
    assert hip["joint_damping"] == 0.3 and knee["armature"] == 0.01
    (delay,) = report["findings"]
    assert delay["where"] == "actuator 'm'" and delay["action"] == "lifted"
    assert set(delay) == {"where", "field", "value", "mjx", "action", "advice", "engines"}
    assert robot.read_text() == before
    # the gain of the PD loop on this inertia is 1 at the bandwidth
    s = 1j * hip["bandwidth"]
    assert abs((40.0 + 2.0 * s) / (hip["inertia"] * s**2)) == pytest.approx(1.0)


def test_inertia_is_what_a_force_at_the_joint_feels(robot):
    """Acceleration for a unit force without gravity; and with all other joints welded."""
    read = models.read(robot, keyframe="home")
    free, held = inertia.inertias(read)
    model = mujoco.MjModel.from_xml_path(str(robot))
    model.opt.gravity[:] = 0.0
    model.dof_damping[:] = 0.0
    data = mujoco.MjData(model)
    for row, joint in enumerate(read.joints):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        data.ctrl[:] = 0.0
        data.qfrc_applied[:] = 0.0
        data.qfrc_applied[joint.dof] = 1.0
        model.actuator_gainprm[:] = model.actuator_biasprm[:] = 0.0
        mujoco.mj_forward(model, data)
        assert 1.0 / data.qacc[joint.dof] == pytest.approx(free[row])
        accelerated = np.zeros(model.nv)
        accelerated[joint.dof] = 1.0
        data.qacc[:] = accelerated
        mujoco.mj_inverse(model, data)
        assert data.qfrc_inverse[joint.dof] == pytest.approx(held[row])
    assert np.all(free < held)


def test_bandwidth_without_gains_is_not_a_number():
    assert math.isnan(inertia.bandwidth(math.nan, math.nan, 1.0))
    assert inertia.bandwidth(4.0, 0.0, 1.0) == pytest.approx(2.0)
    assert inertia.bandwidth(0.0, 3.0, 0.5) == pytest.approx(6.0)


def test_the_table_fits_and_names_everything(robot):
    ran = jaxact("check", robot)
    assert ran.returncode == 0 and ran.stderr == ""
    assert max(map(len, ran.stdout.splitlines())) <= 100
    for word in ("hip", "position", "±30", "-2..6", "4 ms", "lifted", "engines: mjx, mujoco",
                 "--keyframe takes home"):  # fmt: skip
        assert word in ran.stdout
    assert "\x1b" not in ran.stdout


def test_what_is_refused_gives_exit_code_1_and_a_way_out(robot):
    robot.write_text(ROBOT.format(more=DCMOTOR, ctrl=""))
    ran = jaxact("check", robot)
    assert ran.returncode == 1 and ran.stderr == ""
    assert "refused by mjx, mujoco" in ran.stdout and "dcmotor" in ran.stdout
    assert "none can simulate it" in ran.stdout
    pattern = ran.stdout.split("--joints ")[1].splitlines()[0].strip("'")
    again = jaxact("check", robot, "--joints", pattern, "--json")
    report = json.loads(again.stdout)
    assert [joint["name"] for joint in report["joints"]] == ["hip"]
    assert again.returncode == 1 and report["engines"] == ["mujoco"]


def test_geoms_that_mjx_cannot_bring_into_contact_are_refused(robot):
    cylinder = '<geom name="c" type="cylinder" size="0.1 0.1" pos="0 0 -1"/>'
    text = robot.read_text().replace('<geom size="0.2" mass="9"/>', '<geom size="0.2" mass="9"/>'
                                     + cylinder)  # fmt: skip
    box = '<worldbody><geom name="step" type="box" size="1 1 0.1"/>'
    robot.write_text(text.replace("<worldbody>", box))
    ran = jaxact("check", robot)
    assert ran.returncode == 1
    assert "cylinder and box" in ran.stdout and "engines: mujoco" in ran.stdout


@pytest.mark.parametrize(
    ("arguments", "part"),
    [
        (["absent.xml"], "absent.xml: no such model file"),
        (["robot.xml", "--keyframe", "hime"], "did you mean 'home'"),
        (["robot.xml", "--joints", "ankle"], "no joint matches 'ankle'"),
        (["broken.xml"], "cannot read this model"),
    ],
)
def test_unusable_input_is_one_line_and_exit_code_2(robot, arguments, part):
    (robot.parent / "broken.xml").write_text("<mujoco>")
    ran = jaxact("check", *arguments, cwd=robot.parent)
    assert ran.returncode == 2 and ran.stdout == ""
    assert ran.stderr.startswith("jaxact: ") and ran.stderr.count("\n") == 1
    assert part in ran.stderr
    assert {item.name for item in robot.parent.iterdir()} == {"robot.xml", "broken.xml"}
