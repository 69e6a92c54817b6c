"""`jaxact tune --model`, as a user types it."""

import csv
import json
import re
import tomllib
from pathlib import Path

import mujoco
import pytest
import robots
from quickly import compiled_quickly as compiled_quickly

from jaxact.cli.main import main

ROOT = Path(__file__).resolve().parent.parent
ASKED = ("--model", "arm.xml", "--keyframe", "home", "--actuator", "hyq", "--delay", "0.002",
         "--max-peak", "1.8")  # fmt: skip
FEW = ("--starts", "1", "--steps", "20")
QUICK = (*FEW, "--ensemble", "2")
PUSHED = """
duration = 4.0
[plant]
model = "arm.xml"
keyframe = "home"
[parameters]
delay = 0.002
[push]
body = "lower"
impulse = [0.0, 0.0, 0.03]
time = 0.25
duration = 0.05
[axes]
feedforward = [0.0]
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    keys = '<key name="straight" qpos="0 0" ctrl="0 0"/></keyframe>'
    arm = robots.PENDULUM.replace("</keyframe>", keys)
    Path("arm.xml").write_text(arm)
    motors = arm.replace('<position name="shoulder_servo" joint="shoulder" kp="80" kv="4"/>',
                         '<motor joint="shoulder"/>')  # fmt: skip
    Path("motors.xml").write_text(motors)
    Path("pushed.toml").write_text(PUSHED)
    Path("bare.xml").write_text("<mujoco><worldbody/></mujoco>")
    return tmp_path


def _mistake(capsys, *arguments):
    there = sorted(Path().iterdir())
    assert main(["tune", *arguments]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.startswith("jaxact: ") and said.err.count("\n") == 1
    assert sorted(Path().iterdir()) == there
    return said.err


def _has_a_report(kept):
    """The rollout that goes worst is drawn with the tuned gains and with those of the start."""
    assert main(["report", "tuned", "--out", "tuned.html"]) == 0
    text = Path("tuned.html").read_text(encoding="utf-8")
    parts = json.loads(re.search(r'id="data">(.*?)</script>', text)[1])
    assert parts["tuned_robot"]["sentence"] == kept["guaranteed"]["verdict"]
    assert [one["name"] for one in parts["tuned_robot"]["gains"]] == ["shoulder", "elbow"]
    assert len(parts["tuned_robot"]["front"]["points"]) == 3
    run = parts["run"]
    assert [one["name"] for one in run["loops"]] == ["tuned", "before"] and run["beside"] == 1
    assert run["loops"][0]["verdict"] == "stable" and kept["motion"]["member"] in run["head"]
    with Path("tuned/motion.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["gains"] == "tuned"]
    farthest = max(abs(float(row["position"]) - float(row["setpoint"])) for row in rows)
    said = float(run["loops"][0]["says"].rsplit(" ", 1)[1])
    assert farthest == pytest.approx(said, rel=0.05)
    Path("tuned/motion.csv").write_text("gains,time\n1,2\n")
    assert main(["report", "tuned", "--out", "damaged.html"]) == 2


def test_a_robot_is_tuned_and_certified(capsys):
    asked = ("--groups", "shoulder,elbow", "--uncertainty", "delay=0.001..0.003", "--validate", "0")
    assert main(["tune", *ASKED, *QUICK, *asked, "--out", "tuned", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["certified"] and found["feasible"] and found["corners"] == 2
    (peak,) = (side["sensitivity_peak"] for side in found["margins"]["after"].values())
    assert peak <= 1.8 * (1 + 1e-9)
    kept = tomllib.loads(Path("tuned/gains.toml").read_text())
    assert kept["guaranteed"]["certified"] and list(kept["kp"]) == ["shoulder", "elbow"]
    assert main(["report", "tuned", "--out", "tuned.html"]) == 0
    assert kept["guaranteed"]["verdict"] in Path("tuned.html").read_text(encoding="utf-8")


@pytest.mark.exhaustive
def test_a_robot_is_tuned_certified_simulated_and_written(capsys):
    asked = ("--groups", "shoulder,elbow", "--uncertainty", "delay=0.001..0.003,payload=0..0.3",
             "--set", "plant.payload_body=lower", "--pareto", "3", "--validate", "2")  # fmt: skip
    assert main(["tune", *ASKED, *QUICK, *asked, "--out", "tuned", "--json"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    found = json.loads(line)
    assert found["certified"] and found["feasible"] and found["situations"] == ["home"]
    assert [row["name"] for row in found["groups"]] == ["shoulder", "elbow"]
    assert found["corners"] == 4 and found["loops"] >= 6
    assert found["assumed"]["payload"] == [0.0, 0.3] and found["assumed"]["payload_body"] == "lower"
    front = found["pareto"]
    assert [row["certified"] for row in front] == [True] * 3
    assert [row["name"] for row in front[0]["groups"]] == ["shoulder", "elbow"]
    assert front[0]["objective"] < found["objective"] < front[2]["objective"]
    for side in found["margins"]["after"].values():
        assert side["sensitivity_peak"] <= 1.8 * (1 + 1e-9) and side["unstable_members"] == 0
    for row in found["rollouts"]["after"].values():
        assert row["rollouts"] >= 4 and row["stable"] == row["rollouts"]
    files = {"gains.toml", "gains.xml", "sensitivity.png", "convergence.png", "gains.png",
             "front.csv", "front.png", "motion.csv"}  # fmt: skip
    assert {path.name for path in Path("tuned").iterdir()} == files
    head, *rows = Path("tuned/front.csv").read_text().splitlines()
    assert head == "max_peak,kp_shoulder,kp_elbow,kd_shoulder,kd_elbow,objective,certified"
    assert [float(row.split(",")[5]) for row in rows] == [row["objective"] for row in front]
    kept = tomllib.loads(Path("tuned/gains.toml").read_text())
    gains = {row["name"]: row["kp"] for row in found["joints"]}
    assert kept["kp"] == gains and kept["guaranteed"]["certified"]
    assert kept["before"]["kp"]["shoulder"] == 80.0 and all(one["met"] for one in kept["checks"])
    _has_a_report(kept)
    assert {"jaxact", "jax", "mujoco"} == set(kept["versions"])
    assert kept["assumed"]["setpoint_and_feedforward"] == "of the nominal robot"
    # The snippet takes the place of the model's own actuators.
    text = Path("arm.xml").read_text()
    snippet = Path("tuned/gains.xml").read_text()
    own = snippet[snippet.index("<actuator>") : snippet.index("</actuator>")]
    model = mujoco.MjModel.from_xml_string(
        text[: text.index("<actuator>")] + own + text[text.index("</actuator>") :]
    )
    assert model.actuator_gainprm[:, 0].tolist() == list(gains.values())


@pytest.mark.exhaustive
def test_tables_say_what_is_guaranteed_and_what_cannot_be_met(capsys):
    two = (*ASKED, "--keyframe", "home", "straight")
    assert main(["tune", *two, *FEW, "--validate", "0", "--pareto", "2"]) == 0
    said = capsys.readouterr().out
    assert "certified: every constraint holds" in said and "N m/rad" in said and "kp before" in said
    assert "2 members" in said and "straight" in said
    assert "kp shoulder [N m/rad]" in said and "   3.0000 " in said
    # With as many loops, so that nothing is compiled anew.
    two = (*two[: two.index("1.8")], "1.05", *two[two.index("1.8") + 1 :])
    with pytest.raises(SystemExit) as left:
        main(["tune", *two, "--min-kp", "200", *FEW, "--validate", "0"])
    said = capsys.readouterr().out
    assert left.value.code == 1 and "does not prove" in said
    assert "NOT certified" in said and "infeasible" in said and "max_peak" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([*ASKED, "--groups", "hip"], "matches no driven joint; they are shoulder, elbow"),
        ([*ASKED, "--groups", "shoulder"], "'elbow' is in no group"),
        ([*ASKED, "--groups", "shoulder,o"], "matches both"),
        ([*ASKED, "--groups", "shoulder,,elbow"], "empty"),
        ([*ASKED, "--mass", "2"], "--mass"),
        ([*ASKED, "--pareto", "1"], "--pareto 1: give between 2 and 200 points"),
        (
            [*ASKED, "--pareto", "5", "--tracking-weight", "1"],
            "--pareto: cannot be combined with --tracking-weight",
        ),
        ([*ASKED, "--joint", "elbow"], "--joint: is for a single joint"),
        ([*ASKED, "--objective", "settling"], "stiffness or disk-margin"),
        ([*ASKED, "--objective", "disk-margin"], "--min-kp"),
        ([*ASKED, "--min-delay-margin", "0.01"], "is for a single joint"),
        ([*ASKED, "--uncertainty", "mass=1..2"], "vary payload or inertia_scale"),
        ([*ASKED, "--uncertainty", "joint_friction=0..1"], "sweep it instead"),
        ([*ASKED, "--uncertainty", "wn=1..x"], "not a number"),
        ([*ASKED, "--validate", "-1"], "--validate"),
        ([*ASKED, "--ensemble", "4"], "--ensemble 4: nothing is uncertain"),
        (
            ["--spec", "pushed.toml", "--validate", "1"],
            "must end within the first quarter of the 1",
        ),
        (
            ["--spec", "pushed.toml", "--tracking-weight", "1"],
            "must end within the first quarter of the 0.4 s",
        ),
        ([*ASKED, "--keyframe", "home", "home"], "twice"),
        ([*ASKED, "--keyframe", "jump"], "jump"),
        ([*ASKED, "--spec", "missing.toml"], "is in the specifications"),
        ([*ASKED, "--kp", "-5"], "must be positive"),
        (["--model", "missing.xml"], "missing.xml"),
        (["--model", "bare.xml"], "actuator"),
        (["--model", "motors.xml", "--keyframe", "home", "--kp", "50"], "--kp and --kd"),
        (["--spec", "missing.toml"], "missing.toml"),
        (["--groups", "hip"], "--groups: is for a robot"),
        (["--keyframe", "home"], "--keyframe: is for a robot"),
        (["--mass", "0.7", "--validate", "1"], "--validate: is for a robot"),
        (["--mass", "0.7", "--tracking-weight", "1"], "--tracking-weight: is for a robot"),
        ([*ASKED, "--tracking-weight", "-1"], "--tracking-weight -1: give a positive number"),
        (
            [*ASKED, "--tracking-weight", "1", "--derivative", "back"],
            "--derivative 'back'; allowed: auto",
        ),
    ],
)
def test_mistakes_are_one_line(capsys, arguments, said):
    assert said in _mistake(capsys, *arguments)


def test_brute_force_needs_few_groups(capsys):
    path = Path("three.xml")
    geom = '<geom size="0.02" mass="0.2"/>'
    third = f'<body pos="0.25 0 0"><joint name="wrist" axis="0 1 0"/>{geom}</body>'
    text = Path("arm.xml").read_text()
    text = text.replace('qpos="0.4 -0.7" ctrl="0.4 -0.7"', 'qpos="0.4 -0.7 0"').replace(
        'qpos="0 0" ctrl="0 0"', 'qpos="0 0 0"'
    )
    end = text.index("</body>")
    text = text[:end] + third + text[end:]
    text = text.replace("</actuator>", '<motor joint="wrist"/></actuator>')
    path.write_text(text)
    said = _mistake(
        capsys, "--model", "three.xml", "--keyframe", "home", "--actuator", "hyq", "--verify"
    )
    assert "--verify" in said
