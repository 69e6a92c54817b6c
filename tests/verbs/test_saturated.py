"""Joints on a limit: of their force at the end of a run, of it or of their range in a check."""

import json
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.cli.main import main
from jaxact.verbs import saturated

# A horizontal arm of which gravity asks more than its servo has.
ARM = """<mujoco><compiler angle="radian"/><option timestep="0.001"/><worldbody><body pos="0 0 1">
<joint name="elbow" axis="0 1 0" damping="1"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0.4 0 0" mass="1"/></body></worldbody>
<actuator><position joint="elbow" kp="100" kv="5" forcerange="-1 {most}"/></actuator></mujoco>"""
# A joint that a spring has pressed a little beyond the end of its range.
PRESSED = """<mujoco><compiler angle="radian"/><option timestep="0.001" gravity="0 0 0"/>
<worldbody><body>
<joint name="thumb" axis="0 1 0" range="0 1.7" limited="true"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0" mass="0.2"/>
<body pos="0.2 0 0"><joint name="tip" axis="0 1 0" stiffness="0.5" springref="-0.4" damping="0.05"/>
<geom type="capsule" size="0.02" fromto="0 0 0 0.1 0 0" mass="0.1"/></body></body></worldbody>
<actuator><position joint="thumb" kp="1" kv="0.05"/></actuator></mujoco>"""


def _hangs(path, duration):
    """Where the arm is in plain MuJoCo [rad]."""
    plain = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(plain)
    while data.time < duration:
        mujoco.mj_step(plain, data)
    return abs(float(data.qpos[0]))


@pytest.mark.exhaustive
def test_a_run_says_which_joints_give_all_they_have(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, most in (("weak", 1), ("strong", 9)):
        (tmp_path / f"{name}.xml").write_text(ARM.format(most=most).replace("-1 ", f"-{most} "))
    asked = ("--duration", "3", "--out", "run.png", "--overwrite")
    assert main(["simulate", "--model", "weak.xml", *asked]) == 0
    said = capsys.readouterr().out
    off = float(said.partition("In the last quarter elbow is up to ")[2].split()[0])
    assert off == pytest.approx(_hangs("weak.xml", 3.0), rel=0.02) and off > 0.9
    assert "with 1 N m, the most that it can exert" in said
    assert main(["simulate", "--model", "strong.xml", *asked, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["saturated"] == []


def test_a_drive_that_lags_behind_a_command_that_grows_is_on_no_limit():
    time = np.linspace(0.0, 2.0, 400)
    asked = np.exp(5.0 * time)[:, None] * [1.0, 1.0]
    given = np.stack([0.9 * asked[:, 0], np.minimum(asked[:, 1], 9.0)], axis=1)
    path = SimpleNamespace(time=time, command=asked, force=given, configuration=given)
    assert saturated.joints(SimpleNamespace(trajectory=path)) == [1]


def test_a_check_names_joints_that_are_too_weak_and_those_at_the_end_of_their_range(tmp_path):
    weak, pressed = tmp_path / "weak.xml", tmp_path / "pressed.xml"
    weak.write_text(ARM.format(most=1))
    pressed.write_text(PRESSED)
    found = jx.check(jx.robot(weak))
    assert "elbow holds the posture with 1.962 of 1 N m" in " ".join(repr(found).split())
    assert json.loads(found.to_json())["on_stand"]["overloaded"]
    found = jx.check(jx.robot(pressed))
    said = " ".join(repr(found).split())
    assert "thumb (" in said and "is at the end of the range" in said
    assert said.index("end of the range") < said.index("the gains bear")
    (edge,) = json.loads(found.to_json())["on_stand"]["edges"]
    assert edge.startswith("thumb (-")
