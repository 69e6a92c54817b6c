"""`jaxact margins --model`, as a user types it."""

import json
import math
from pathlib import Path

import pytest
from quickly import compiled_quickly as compiled_quickly

from jaxact.cli.main import main

ROOT = Path(__file__).resolve().parent.parent
ARM = """<mujoco><option timestep="0.001"/><worldbody>
<body><joint name="shoulder" axis="0 1 0"/><geom size="0.05" pos="0 0 -0.35" mass="1.2"/>
<body pos="0 0 -0.35"><joint name="elbow" axis="0 1 0"/>
<geom size="0.04" pos="0 0 -0.3" mass="0.8"/></body></body></worldbody>
<actuator>{actuators}</actuator>
<keyframe><key name="bent" qpos="0.3 0.5" ctrl="0.3 0.5"/></keyframe></mujoco>"""
SERVOS = (
    '<position name="a" joint="shoulder" kp="150" kv="9"/>'
    '<position name="b" joint="elbow" kp="40" kv="2"/>'
)
OF_ALL = {
    "gain_margin", "gain_margin_frequency", "gain_reduction_margin", "gain_reduction_frequency",
    "delay_margin", "delay_margin_frequency", "sensitivity_peak", "sensitivity_peak_frequency",
    "complementary_peak", "complementary_peak_frequency", "modulus_margin", "disk_margin",
    "disk_margin_frequency", "unscaled_disk_margin",
}  # fmt: skip
OF_JOINT = {
    "name", "kp", "kd", "gain_margin", "gain_reduction_margin", "phase_crossover", "phase_margin",
    "gain_crossover", "delay_margin", "sensitivity_peak", "sensitivity_peak_frequency",
    "complementary_peak", "complementary_peak_frequency", "modulus_margin", "disk_margin",
}  # fmt: skip


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("arm.xml").write_text(ARM.format(actuators=SERVOS))
    Path("motors.xml").write_text(
        ARM.format(actuators='<motor joint="shoulder"/><motor joint="elbow"/>')
    )
    return tmp_path


def _said(capsys, *arguments):
    assert main(["margins", *arguments]) == 0
    return capsys.readouterr().out


def _mistake(capsys, *arguments):
    there = sorted(Path().iterdir())
    assert main(["margins", *arguments]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("jaxact: ") and said.err.count("\n") == 1
    assert sorted(Path().iterdir()) == there
    return said.err


def test_the_gains_of_the_model_are_taken_and_everything_is_said(capsys):
    asked = ("--model", "arm.xml", "--keyframe", "bent", "--actuator", "hyq", "--delay", "0.001")
    (line,) = _said(capsys, *asked, "--json").splitlines()
    row = json.loads(line)
    assert row["stable"] is True and row["unstable_roots"] == 0 and row["engine"] == "mujoco"
    assert row["keyframe"] == "bent" and row["posture"] == "settled"
    assert row["control_period"] == 0.001 and row["neutral_directions"] == 0
    assert 0.0 <= row["residual"] < 1e-2
    assert set(row["all"]) == OF_ALL
    assert [set(joint) for joint in row["joints"]] == [OF_JOINT] * 2
    gains = [(joint["name"], joint["kp"], joint["kd"]) for joint in row["joints"]]
    assert gains == [("shoulder", 150.0, 9.0), ("elbow", 40.0, 2.0)]
    assert set(row["ranking"]) == {"shoulder", "elbow"}
    for mode in ("critical_mode", "slowest_mode", "response_at_peak"):
        assert set(row[mode]["participation"]) == {"shoulder", "elbow"}
        assert math.isclose(sum(row[mode]["participation"].values()), 1.0)
    assert 0.0 < row["all"]["disk_margin"] <= min(joint["disk_margin"] for joint in row["joints"])
    assert all(10.0 < joint["phase_margin"] < 180.0 for joint in row["joints"])  # degrees


@pytest.mark.exhaustive
def test_derivatives_of_mjx_give_the_margins_of_differences_in_c(capsys):
    asked = ("--model", "arm.xml", "--keyframe", "bent", "--actuator", "hyq", "--json", "--engine")
    one, other = (json.loads(_said(capsys, *asked, engine)) for engine in ("mujoco", "mjx"))
    assert (one["engine"], other["engine"]) == ("mujoco", "mjx")
    assert one["growth_rate"] != other["growth_rate"]
    for name in ("growth_rate", "gain_margin", "sensitivity_peak", "disk_margin"):
        found = (row.get(name, row["all"].get(name)) for row in (one, other))
        assert next(found) == pytest.approx(next(found), rel=1e-4), name


def test_the_table_ranks_joints_and_names_the_mode(capsys):
    said = _said(capsys, "--model", "arm.xml", "--actuator", "hyq", "--delay", "0.001")
    assert "2 driven joints, control 1000 Hz, physics step 1 ms, mujoco, posture settled" in said
    for words in ("all joints at once", "stable", "gain margin", "delay margin", "Ms",
                  "disk margin", "least damped mode", "begins to shake",
                  "share in what shakes first", "kp in N m/rad, kd in N m s/rad"):  # fmt: skip
        assert words in said
    assert "warning" not in said


def test_values_for_some_joints_win_and_several_values_are_combined(capsys):
    said = _said(
        capsys, "--model", "motors.xml", "--kp", "100", "--kd", "5", "--delay", "0", "0.002",
        "--set", "kp@elb.*=40", "--set", "kd@elb.*=2", "--json",
    )  # fmt: skip
    rows = [json.loads(line) for line in said.splitlines()]
    assert [row["loop"] for row in rows] == ["delay 0 ms", "delay 2 ms"]
    for row in rows:
        assert [(joint["kp"], joint["kd"]) for joint in row["joints"]] == [
            (100.0, 5.0),
            (40.0, 2.0),
        ]
    early, late = (row["all"]["delay_margin"] for row in rows)
    assert math.isclose(early - late, 0.002, rel_tol=1e-6)


def test_an_unstable_robot_has_null_margins(capsys):
    arguments = ("--model", "arm.xml", "--set", "gain_scale=100", "--actuator", "starleth")
    row = json.loads(_said(capsys, *arguments, "--json"))
    assert row["stable"] is False and row["unstable_roots"] > 0 and row["growth_rate"] > 0.0
    assert row["all"] is None and row["response_at_peak"] is None and row["verdict"] == "shakes"
    shares = [row["critical_mode"]["participation"][name] for name in row["ranking"]]
    assert len(shares) == 2 and shares == sorted(shares, reverse=True)
    assert row["changes"]["less_gain"]["value"] < 1.0 and row["changes"]["more_delay"] is None
    for joint in row["joints"]:
        assert joint["kp"] > 0 and joint["disk_margin"] is None and joint["gain_margin"] is None
    assert 0.0 < row["gain_to_boundary"] < 1.0 and row["log_gain_to_boundary"] < 0.0
    said = _said(capsys, *arguments)
    assert "fastest growing mode" in said and f"{row['gain_to_boundary']:.4g}" in said


def test_a_specification_is_a_start(capsys):
    Path("robot.toml").write_text(
        '[plant]\nmodel = "motors.xml"\nkeyframe = "bent"\n[parameters]\nkp = 80.0\nkd = 4.0\n'
        '"kp@elbow" = 30.0\n[axes]\ngain_scale = [0.5, 5.0]\n'
    )
    row = json.loads(_said(capsys, "--spec", "robot.toml", "--kd", "3", "--json"))
    gains = [(joint["name"], joint["kp"], joint["kd"]) for joint in row["joints"]]
    assert gains == [("shoulder", 80.0, 3.0), ("elbow", 30.0, 3.0)]
    assert row["keyframe"] == "bent"


def test_a_posture_that_is_no_equilibrium_is_warned_of(capsys):
    Path("falling.xml").write_text(
        """<mujoco><worldbody><geom type="plane" size="5 5 .1"/>
        <body pos="0 0 1"><freejoint/><geom size="0.1" mass="2"/>
        <body><joint name="arm" axis="0 1 0"/><geom type="capsule" size="0.03"
        fromto="0 0 0 .3 0 0" mass="1" contype="0" conaffinity="0"/></body></body></worldbody>
        <actuator><position joint="arm" kp="50" kv="3"/></actuator></mujoco>"""
    )
    said = _said(capsys, "--model", "falling.xml", "--posture", "keyframe")
    assert "warning: the posture is not an equilibrium" in said and "rigid-body mode" in said


def test_a_picture_is_drawn(capsys):
    said = _said(capsys, "--model", "arm.xml", "--actuator", "hyq", "--out", "margins.svg")
    assert said.rstrip().endswith("wrote margins.svg")
    text = Path("margins.svg").read_text()
    assert all(word in text for word in ("shoulder", "elbow", "σmax", "arm.xml", "Ms"))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--model", "motors.xml"), "shoulder.*needs one.*motor"),
        (("--model", "nowhere.xml"), "nowhere.xml"),
        (("--model", "arm.xml", "--keyframe", "bend"), "bent"),
        (("--model", "arm.xml", "--engine", "mass"), "--engine.*mujoco"),
        (("--model", "arm.xml", "--posture", "lying"), "--posture"),
        (("--model", "arm.xml", "--mass", "2"), "--mass"),
        (("--model", "arm.xml", "--joints", "wrist"), "wrist"),
        (("--model", "arm.xml", "--set", "kp@wrist=3"), "wrist"),
        (("--model", "arm.xml", "--set", "kp@[=3"),
         r"--set kp@\[: what follows the @ is not a regular expression; write e\.g\. kp@"),
        (("--model", "arm.xml", "--set", "gain_scale@arm=3"), "one number for all joints"),
        (("--model", "arm.xml", "--set", "kq=3"), "kq"),
        (("--model", "arm.xml", "--delay", "-1"), "--delay"),
        (("--model", "arm.xml", "--csv", "a.csv"), "--csv.*--json"),
        (("--model", "arm.xml", "--out", "a.txt"), "picture format"),
        (("--model", "arm.xml", "--delay", "0", "0.001", "--out", "a.png"), "--out"),
        (("--keyframe", "bent"), "--keyframe.*--model"),
        (("--set", "kp=3"), "--set.*--model"),
    ],
)  # fmt: skip
def test_mistakes_are_told_in_one_line(capsys, arguments, words):
    import re

    assert re.search(words, _mistake(capsys, *arguments))


@pytest.mark.exhaustive
def test_the_lead_of_the_integrator_is_said_and_can_be_taken_back(capsys):
    def margin(*settings):
        options = [part for item in settings for part in ("--set", item)]
        row = json.loads(_said(capsys, "--model", "arm.xml", "--json", *options))
        return row["all"]["delay_margin"]

    said = " ".join(_said(capsys, "--model", "arm.xml").split())
    assert "positions 0.5 ms ahead" in said
    assert "--set integrator_correction=true takes it back" in said
    finest = margin("physics_step=2e-5")
    assert margin("integrator_correction=true") == pytest.approx(finest, rel=0.003)
    assert 0.005 * finest < abs(margin() - finest) < 0.5e-3
    corrected = ("--model", "arm.xml", "--set", "integrator_correction=true")
    assert "ahead" not in _said(capsys, *corrected)


def test_joints_that_give_way_on_a_stand_want_no_balance_controller(capsys):
    weak = SERVOS.replace('kp="40"', 'kp="1"')
    up = ARM.replace('name="bent" qpos="0.3 0.5"', 'name="bent" qpos="3.14159265 0"')
    Path("arm.xml").write_text(up.format(actuators=weak))
    said = " ".join(_said(capsys, "--model", "arm.xml", "--keyframe", "bent").split())
    assert "NO, it topples" in said and "the gains do not hold it there" in said
    assert "balance controller" not in said
