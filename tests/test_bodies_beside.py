"""Bodies beside a robot that nothing drives: what they do is not its joints'."""

import json
import math

import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.cli.main import main

# An arm, and a pendulum that no actuator reaches: it stands on its end, or hangs and is damped.
LENGTH, GRAVITY = 0.3, 9.81
TEXT = """<mujoco><option timestep=".001"/><worldbody>
  <body><joint name="a1" axis="0 1 0" damping=".05"/>
  <geom type="capsule" size=".03" fromto="0 0 0 .3 0 0" mass="1"/>
  <body pos=".3 0 0"><joint name="a2" axis="0 1 0" damping=".02"/>
  <geom type="capsule" size=".02" fromto="0 0 0 .25 0 0" mass=".5"/></body></body>
  {beside}</worldbody>
  <actuator><position joint="a1" kp="60" kv="4"/><position joint="a2" kp="20" kv="1"/></actuator>
  </mujoco>"""
PENDULUM = """<body pos="0 1 1"><joint axis="0 1 0" damping="{damping}"/>
  <geom type="box" size=".001 .001 .15" pos="0 0 {place}" mass="1"/></body>"""
# A thin rod about its end: 3 g / (2 l) is the square of its rate.
RATE = math.sqrt(1.5 * GRAVITY / LENGTH)


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    folder = tmp_path_factory.mktemp("beside")
    beside = {"alone": "", "standing": PENDULUM.format(damping=0.0, place=0.15),
              "hanging": PENDULUM.format(damping=1e-3, place=-0.15)}  # fmt: skip
    for name, body in beside.items():
        (folder / f"{name}.xml").write_text(TEXT.format(beside=body))
    return folder


def said(capsys, *options):
    assert main(list(options)) == 0
    return capsys.readouterr().out


def test_a_pendulum_that_falls_beside_an_arm_is_not_its_joints(models, capsys):
    which = ("margins", "--model", str(models / "standing.xml"), "--joints", "a[12]")
    found = json.loads(said(capsys, *which, "--json"))
    assert found["growth_rate"] == pytest.approx(RATE, rel=5e-3)
    assert set(found["critical_mode"]["participation"].values()) == {0.0}
    text = " ".join(said(capsys, *which).split())
    assert "no driven joint" in text and "that no driven joint moves, whatever the gains" in text
    assert "do not hold it" not in text and "a1 99 %" not in text


def test_a_pendulum_that_hangs_beside_an_arm_changes_none_of_its_margins(models, capsys):
    found = {}
    for name in ("alone", "hanging"):
        which = ("--model", str(models / f"{name}.xml"), "--joints", "a[12]")
        found[name] = json.loads(said(capsys, "margins", *which, "--json"))
    alone, beside = (found[name]["all"] for name in ("alone", "hanging"))
    for metric in ("gain_margin", "delay_margin", "sensitivity_peak", "disk_margin"):
        assert beside[metric] == pytest.approx(alone[metric], rel=1e-4)
    slowest = found["hanging"]["slowest_mode"]
    assert slowest["frequency"] == pytest.approx(RATE, rel=5e-3)
    assert set(slowest["participation"].values()) == {0.0}


# Two feet in a line, one behind the other, and a leg that swings along that line.
SIDEWAYS = """<mujoco><option timestep=".001"/><worldbody><geom type="plane" size="9 9 .1"/>
  <body pos="0 0 .3"><freejoint/><geom type="box" size=".2 .05 .02" mass="4"/>
  <geom size=".02" pos=".2 0 -.28"/><geom size=".02" pos="-.2 0 -.28"/>
  <body><joint name="swing" axis="0 1 0" armature=".02"/>
  <geom type="capsule" size=".02" fromto="0 0 0 0 0 -.15" mass=".5"/></body></body></worldbody>
  <actuator><position joint="swing" kp="60" kv="4"/></actuator></mujoco>"""


def test_a_robot_that_topples_over_joints_that_do_not_move_topples_itself(tmp_path, capsys):
    path = tmp_path / "sideways.xml"
    path.write_text(SIDEWAYS)
    text = " ".join(said(capsys, "margins", "--model", str(path)).split())
    assert "NO, it topples" in text and "no driven joint" in text
    assert "a balance controller" in text and "--base fixed is it on a stand" in text
    assert "whatever the gains" not in text
