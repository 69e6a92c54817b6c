"""`--base` and `--damping`, as a user types them: the same for every verb, no file is edited."""

import json
from pathlib import Path

import mujoco
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.cli.main import main

# Stands on four feet; a leg is driven, with damping of its own.
STOOL = """<mujoco><option timestep="0.002"/><worldbody><geom type="plane" size="1 1 1"/>
<body name="seat" pos="0 0 .3"><freejoint/><geom type="box" size=".2 .2 .02" mass="4"/>
<geom size=".03" pos=".2 .2 -.28"/><geom size=".03" pos="-.2 .2 -.28"/>
<geom size=".03" pos=".2 -.2 -.28"/><geom size=".03" pos="-.2 -.2 -.28"/>
<body><joint name="swing" axis="0 1 0" damping="{damping}" armature=".02"/>
<geom type="capsule" fromto="0 0 0 0 0 -.15" size=".02" mass=".5"/></body></body></worldbody>
<actuator><position name="servo" joint="swing" kp="60"/></actuator>
<keyframe><key name="stands" qpos="1 0 .31 1 0 0 0 .2"/></keyframe></mujoco>"""
WHICH = ("--model", "stool.xml", "--keyframe", "stands")
SHAKES = ("--delay", "0.01", "--control-rate", "500")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("stool.xml").write_text(STOOL.format(damping=4.0))
    return tmp_path


def _margins(capsys, *options):
    assert main(["margins", *WHICH, *SHAKES, "--json", *options]) == 0
    return json.loads(capsys.readouterr().out)


def _rollout(steps=4000):
    """Growth rate of the joint on a stand, kp and kd computed every 2 ms, 10 ms late: plain C."""
    text = STOOL.format(damping=0).replace("<freejoint/>", "").replace("1 0 .31 1 0 0 0 ", "")
    text = text.replace("<geom", '<geom contype="0" conaffinity="0"')
    text = text.replace('<position name="servo" joint="swing" kp="60"/>', '<motor joint="swing"/>')
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    data.qpos[0] = 0.2
    mujoco.mj_inverse(model, data)
    held, late, path = data.qfrc_inverse[0], [0.0] * 5, []
    data.qvel[0] = 1e-9
    for _ in range(steps):
        late.append(60.0 * (0.2 - data.qpos[0]) - 4.0 * data.qvel[0])
        data.ctrl[0] = held + late.pop(0)
        mujoco.mj_step(model, data)
        path.append(data.qvel[0])
        if abs(path[-1]) > 1e-2:
            break
    size = np.abs(path)
    peaks = np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] > size[2:]))[5:] + 1
    return np.polyfit(0.002 * peaks, np.log(size[peaks]), 1)[0]


def test_damping_in_the_drive_is_what_the_hardware_does(capsys):
    joint = _margins(capsys, "--base", "fixed", "--damping", "joint")
    drive = _margins(capsys, "--base", "fixed", "--damping", "drive")
    assert joint["stable"] and not drive["stable"]
    assert (joint["joints"][0]["kd"], drive["joints"][0]["kd"]) == (0.0, 4.0)
    assert (drive["base"], drive["damping"]) == ("fixed", "drive")
    assert drive["growth_rate"] == pytest.approx(_rollout(), rel=0.01)


def test_a_gain_that_is_given_replaces_the_damping_that_was_moved(capsys):
    given = _margins(capsys, "--base", "fixed", "--damping", "drive", "--kd", "4")
    moved = _margins(capsys, "--base", "fixed", "--damping", "drive")
    assert given["growth_rate"] == moved["growth_rate"]
    assert _margins(capsys, "--base", "held")["joints"][0]["kd"] == 0.0


def test_a_motor_takes_the_damping_of_its_joint_for_its_kd(capsys):
    text = STOOL.format(damping=4.0)
    servo = '<position name="servo" joint="swing" kp="60"/>'
    Path("stool.xml").write_text(text.replace(servo, '<motor name="servo" joint="swing"/>'))
    motor = _margins(capsys, "--base", "fixed", "--damping", "drive", "--kp", "60")
    Path("stool.xml").write_text(text)
    assert motor["joints"][0]["kd"] == 4.0
    servo = _margins(capsys, "--base", "fixed", "--damping", "drive")
    assert motor["growth_rate"] == servo["growth_rate"]


def test_a_specification_says_the_same(capsys):
    Path("stool.toml").write_text(
        '[plant]\nmodel = "stool.xml"\nkeyframe = "stands"\nbase = "fixed"\ndamping = "drive"\n'
        "[parameters]\ndelay = 0.01\ncontrol_rate = 500\n[axes]\ngain_scale = [1.0]\n"
    )
    assert main(["margins", "--spec", "stool.toml", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    typed = _margins(capsys, "--base", "fixed", "--damping", "drive")
    assert told["growth_rate"] == typed["growth_rate"]
    other = ("--set", "plant.base=held", "--set", "plant.damping=joint", "--json")
    assert main(["margins", "--spec", "stool.toml", *other]) == 0
    row = json.loads(capsys.readouterr().out)
    assert (row["base"], row["damping"], row["joints"][0]["kd"]) == ("held", "joint", 0.0)


def test_check_says_what_was_done(capsys):
    assert main(["check", *WHICH[1:], "--base", "fixed", "--damping", "drive", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["degrees_of_freedom"] == 1 and found["joints"][0]["kd"] == 4.0
    said = {item["field"]: item for item in found["findings"]}
    assert said["base"]["action"] == said["damping"]["action"] == "as asked"
    assert "moved into the drive's kd" in said["damping"]["advice"]


@pytest.mark.exhaustive
def test_a_motion_is_simulated_on_the_stand(capsys):
    files = ("--out", "run.png", "--npz", "run.npz")
    asked = ("--base", "fixed", "--damping", "drive", "--duration", "0.1", "--engine", "mujoco")
    assert main(["simulate", *WHICH, *SHAKES, *asked, *files]) == 0
    assert np.load("run.npz")["qpos"].shape[1] == 1


@pytest.mark.parametrize(
    ("verb", "options", "message"),
    [
        ("margins", ("--base", "fixed"), "--base: is for a robot; give one with --model"),
        ("tune", ("--damping", "drive"), "--damping: is for a robot; give one with --model"),
        ("simulate", ("--base", "held"), "--base: is for a robot; give one with --model"),
        ("render", ("--base", "held"), "--base: is for a robot; give one with --model"),
        ("margins", (*WHICH, "--base", "table"), "--base 'table'; allowed: free, fixed, held"),
        ("simulate", (*WHICH, "--damping", "drives"), "--damping 'drives'; did you mean 'drive'?"),
        ("simulate", (*WHICH, "--set", "damping=drive"), "--set 'damping=drive': of a robot, "),
        ("simulate", (*WHICH, "--set", "plant.base=up"), "plant.base = 'up'; allowed: free, "),
    ],
)
def test_a_mistake_is_one_line(capsys, verb, options, message):
    assert main([verb, *options]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"jaxact: {message}") and said.count("\n") == 1


@pytest.mark.exhaustive
def test_a_sweep_is_told_what_its_option_for_changes_takes(capsys):
    floor = '<geom type="plane" size="1 1 1"/>'
    Path("stool.xml").write_text(STOOL.format(damping=4.0).replace(floor, ""))
    Path("s.toml").write_text(
        'engine = "mujoco"\nduration = 0.02\n[plant]\nmodel = "stool.xml"\nkeyframe = "stands"\n'
        "[axes]\nkp = [50, 60]\n"
    )
    assert main(["sweep", "s.toml", "--out", "out"]) == 2
    said = capsys.readouterr().err
    change = "--set plant.posture=keyframe"
    assert f"{change} to start from it as it is, or --set plant.base=fixed to put it" in said
    assert main(["sweep", "s.toml", "--out", "out", *change.split()]) == 0


def test_margins_of_a_robot_that_topples_propose_the_stand(capsys):
    text = STOOL.format(damping=0.8)
    feet = text[text.index('<geom size=".03"') : text.index("<body><joint")]
    text = text.replace(feet, '<geom size=".03" pos="0 0 -.28"/>').replace(' qpos="1 0 .31', "")
    text = text[: text.index("<keyframe>")].replace('pos="0 0 .3"', 'pos="0 0 .31"') + "</mujoco>"
    Path("pole.xml").write_text(text)
    assert main(["margins", "--model", "pole.xml", "--kd", "0.8"]) == 0
    said = capsys.readouterr().out
    assert "NO" in said and "topples on its free base; --base fixed is it on a stand" in said
    assert main(["margins", "--model", "pole.xml", "--kd", "0.8", "--base", "fixed"]) == 0
    assert "topples" not in capsys.readouterr().out


@pytest.mark.exhaustive
def test_tuned_gains_say_that_they_hold_the_damping(capsys):
    quick = ("--starts", "1", "--steps", "20", "--validate", "0")
    asked = (
        "--base",
        "fixed",
        "--actuator",
        "hyq",
        "--delay",
        "0.002",
        "--max-peak",
        "1.8",
        *quick,
    )
    assert main(["tune", *WHICH, *asked]) == 2
    assert "swing: kd is 0, and there is no start from it; give --kd, or --damping drive" in (
        capsys.readouterr().err
    )
    for damping, says, given in (("joint", False, ("--kd", "4")), ("drive", True, ())):
        where = ("--damping", damping, "--out", damping)
        assert main(["tune", *WHICH, *asked, *where, *given]) == 0
        written = (Path(damping) / "gains.xml").read_text()
        assert ("give them damping 0" in written) is says and "<position" in written
    capsys.readouterr()


def test_margins_with_the_base_held_say_that_the_feet_never_slip(capsys):
    assert main(["margins", *WHICH, *SHAKES, "--base", "held"]) == 0
    assert "feet that never slip" in capsys.readouterr().out
    assert main(["margins", *WHICH, *SHAKES, "--base", "fixed"]) == 0
    assert "feet that never slip" not in capsys.readouterr().out


# Hangs from a trunk of 4 kg that rests on it: too soft for that weight, on a foot that sticks.
LEG = """<mujoco><option timestep="0.002" impratio="{impratio}" cone="elliptic"/><worldbody>
<geom type="plane" size="1 1 1"/><body pos="0 0 .5"><joint type="slide" axis="0 0 1"/>
<geom type="box" size=".1 .1 .02" mass="4"/><body><joint name="hip" axis="0 1 0" armature=".01"/>
<geom type="capsule" fromto="0 0 0 0 0 -.45" size=".02" mass=".2" contype="0" conaffinity="0"/>
<geom size=".03" pos="0 0 -.47" mass=".1"/></body></body></worldbody>
<actuator><position joint="hip" kp="10" kv="1"/></actuator></mujoco>"""


def test_a_foot_that_only_creeps_is_not_said_to_topple(capsys):
    rates = []
    for impratio in (1, 10):
        Path("leg.xml").write_text(LEG.format(impratio=impratio))
        assert main(["margins", "--model", "leg.xml", "--base", "held", "--json"]) == 0
        rates.append(json.loads(capsys.readouterr().out)["toppling_rate"])
    assert 0.0 < rates[0] < 0.05 and rates[1] == pytest.approx(rates[0] / 10.0, rel=0.05)
    Path("leg.xml").write_text(LEG.format(impratio=1))
    assert main(["margins", "--model", "leg.xml", "--base", "held"]) == 0
    text = capsys.readouterr().out
    assert "NO, it creeps" in text and f"a factor of e in {1.0 / rates[0]:.3g} s" in text


@pytest.mark.exhaustive
def test_figures_of_a_hinge_have_the_units_of_a_hinge(capsys):
    loop = ("simulate", *WHICH, "--base", "fixed", "--duration", "0.2", "--out", "one.png")
    assert main([*loop]) == 0
    text = capsys.readouterr().out
    assert "rad s" in text and "(N m)^2 s" in text and " m s" not in text
    assert main([*loop, "--json"]) == 0
    units = json.loads(capsys.readouterr().out)["units"]
    assert units["peak_force"] == "N m" and units["integrated_squared_error"] == "rad^2 s"
