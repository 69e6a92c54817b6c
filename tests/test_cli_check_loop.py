"""What `jaxact check` says first: the delay that the model's gains bear, and what hides in them."""

import json
from pathlib import Path

import mujoco
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.cli.main import main

# A seat on four feet; a leg with a servo, whose D gain is the joint's damping.
STOOL = """<mujoco><option timestep="0.001"/><worldbody>{floor}
<body name="seat" pos="0 0 .31"><freejoint/><geom type="box" size=".2 .2 .02" mass="4"/>
<geom size=".03" pos=".2 .2 -.28"/><geom size=".03" pos="-.2 .2 -.28"/>
<geom size=".03" pos=".2 -.2 -.28"/><geom size=".03" pos="-.2 -.2 -.28"/>
<body><joint name="swing" axis="0 1 0" damping="{damping}" armature=".02" frictionloss="{loss}"/>
<geom type="capsule" fromto="0 0 0 0 0 -.15" size=".02" mass=".5"/></body></body></worldbody>
<actuator><position name="servo" joint="swing" kp="60"/></actuator></mujoco>"""
FLOOR = '<geom type="plane" size="1 1 1"/>'


def _check(capsys, text, *options):
    Path("stool.xml").write_text(text)
    assert main(["check", "stool.xml", *options]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    return said.out


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def _shakes(delay, damping, rate, seconds=4.0, fine=1e-4):
    """Whether the joint shakes on a stand with kp and kd late by seconds, in plain C MuJoCo."""
    text = STOOL.format(floor="", damping=0, loss=0).replace("<freejoint/>", "")
    text = text.replace('<position name="servo" joint="swing" kp="60"/>', '<motor joint="swing"/>')
    model = mujoco.MjModel.from_xml_string(text.replace("<geom", '<geom contype="0"'))
    model.opt.timestep = fine
    data = mujoco.MjData(model)
    data.qvel[0], late = 1e-6, [0.0] * round(delay / fine)
    for step in range(round(seconds / fine)):
        if step % round(1.0 / rate / fine) == 0:
            command = -60.0 * data.qpos[0] - damping * data.qvel[0]
        late.append(command)
        data.ctrl[0] = late.pop(0)
        mujoco.mj_step(model, data)
        if abs(data.qvel[0]) > 1e-5:
            return True
    return abs(data.qvel[0]) > 1e-6


@pytest.mark.exhaustive
@pytest.mark.parametrize("rate", [1000.0, 200.0])
def test_delays_are_those_of_plain_mujoco_at_a_fine_step(capsys, rate):
    text = STOOL.format(floor=FLOOR, damping=2.0, loss=0.3)
    options = ("--json", "--control-rate", f"{rate:g}")
    found = json.loads(_check(capsys, text, *options))["on_stand"]
    assert found["hidden_gains"] == ["swing"] and found["control_rate"] == rate
    borne = found["in_drive"]["delay"]
    assert not _shakes(0.98 * borne, 2.0, rate) and _shakes(1.02 * borne, 2.0, rate)
    assert found["in_drive"]["participation"] == {"swing": pytest.approx(1.0, abs=1e-12)}
    assert found["in_drive"]["delay"] < found["as_it_is"]["delay"] < found["stuck"]["delay"]
    assert found["friction"] == 0.3 and found["free"]["stable"] and found["falls"] is None


# A leg whose knee has to bend: at the default posture it is straight, outside of its range.
LEG = """<mujoco><worldbody><body pos="0 0 1"><joint name="hip" axis="0 1 0" damping="1"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5"/>
<body pos="0 0 -.2"><joint name="knee" axis="0 1 0" damping="1" range="-120 -40"/>
<geom type="capsule" fromto="0 0 0 0 0 -.2" size=".02" mass=".5"/></body></body></worldbody>
<actuator><position joint="hip" kp="60"/><position joint="knee" kp="60"/></actuator>
{keys}</mujoco>"""
BENT = '<keyframe><key name="straight" qpos="0 0"/><key name="bent" qpos=".7 -1.4"/></keyframe>'


@pytest.mark.exhaustive
def test_what_limits_hold_is_no_answer(capsys):
    text = LEG.format(keys=BENT)
    found = json.loads(_check(capsys, text, "--json"))
    why = found["on_stand_not_known"]
    assert found["on_stand"] is None and why.startswith("knee (") and "--keyframe bent" in why
    assert "straight" not in why.rpartition("--keyframe")[2]
    assert "is not known: knee (" in _check(capsys, text, "--keyframe", "straight")
    assert "range" not in (said := _check(capsys, text, "--keyframe", "bent").split("joint ")[0])
    assert "the gains bear " in said
    # Nothing else to propose: the answer comes with what is wrong with it.
    said = " ".join(_check(capsys, LEG.format(keys="")).split())
    assert "held there by its limit" in said and "On a stand, at 1000 Hz" in said
    assert main(["margins", "--model", "stool.xml"]) == 0
    assert "knee (" in capsys.readouterr().err


@pytest.mark.exhaustive
def test_it_is_said_in_sentences(capsys):
    said = " ".join(_check(capsys, STOOL.format(floor=FLOOR, damping=2.0, loss=0.3)).split())
    for words in (
        "On a stand, at 1000 Hz, with the joints' damping in the drives, the gains bear ",
        "1 of 1 driven joints have kp, no kd, and", "; then swing shakes at",
        "As the model has it, in the joint and at once, the gains would bear ",
        "Dry friction of up to 0.3 N m is left out",
        "With its base free, at this posture, the gains",
    ):  # fmt: skip
        assert words in said, words
    both = ("--base", "fixed", "--damping", "drive")
    said = " ".join(_check(capsys, STOOL.format(floor=FLOOR, damping=140.0, loss=0), *both).split())
    assert "On a stand, at 1000 Hz, the gains shake even without more delay: swing at" in said
    assert "have kp, no kd" not in said and "Dry friction" not in said and "base free" not in said


def test_dry_friction_is_named_without_gains_too(capsys):
    for loss, said in ((0.3, True), (0, False)):
        text = STOOL.format(floor="", damping=0, loss=loss)
        text = text.replace(
            '<position name="servo" joint="swing" kp="60"/>', '<motor joint="swing"/>'
        )
        words = " ".join(_check(capsys, text).split())
        assert ("Dry friction of up to 0.3 N m is left out, as it damps no" in words) == said


@pytest.mark.exhaustive
def test_a_free_base_that_topples_or_falls_is_proposed_a_stand(capsys):
    text = STOOL.format(floor="", damping=2.0, loss=0)
    said = " ".join(_check(capsys, text).split())
    assert "falls from its keyframe" in said and "or --base fixed to put it on a stand" in said
    assert "--posture keyframe to start from it as it is" in said
    said = " ".join(_check(capsys, text, "--posture", "keyframe").split())
    assert "falls" not in said and "With its base free" in said
    # One foot under the middle: upright, and held up by nothing.
    text = STOOL.format(floor=FLOOR, damping=2.0, loss=0)
    feet = text[text.index('<geom size=".03"') : text.index("<body><joint")]
    text = text.replace(feet, '<geom size=".03" pos="0 0 -.28"/>')
    said = " ".join(_check(capsys, text).split())
    assert "With its base free the robot topples, by" in said and "--base fixed leaves" in said
    free = json.loads(_check(capsys, text, "--json"))["on_stand"]["free"]
    assert free["topples"] and not free["shakes"] and free["growth_rate"] > 1e-3


def test_motors_bring_no_gains_to_speak_of(capsys):
    text = STOOL.format(floor=FLOOR, damping=2.0, loss=0).replace(
        '<position name="servo" joint="swing" kp="60"/>', '<motor joint="swing"/>'
    )
    assert json.loads(_check(capsys, text, "--json"))["on_stand"] is None
    assert "On a stand" not in (said := _check(capsys, text)) and "No gains in the model" in said
