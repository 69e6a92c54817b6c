"""Identified drives as parts of loops: joints, robots, specifications, gains."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.cli._loops import identified
from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.identification.log import Log
from jaxact.identification.result import Identified
from jaxact.loops import reading
from jaxact.tuning.box import read_box
from jaxact.tuning.joint.ensemble import FIELDS
from jaxact.verbs.tune import intervals

NO_UNKNOWNS = SimpleNamespace(unknowns=())
ROOT = Path(__file__).resolve().parents[2]
BENCH = """
model = "second order with delay"
plant = "none"
unit = "rad"
[[loop]]
wn = 110.0
zeta = 0.9
delay = 0.002
gain_scale = 0.8
control_rate = 500.0
[verdict]
level = "good"
[estimates]
gain = { value = 0.8, low = 0.76, high = 0.84 }
wn = { value = 110.0, low = 99.0, high = 121.0 }
zeta = { value = 0.9, low = 0.81, high = 0.99 }
delay = { value = 0.002, low = 0.0018, high = 0.0023 }
[numbers]
gain = 0.8
wn = 110.0
zeta = 0.9
delay = 0.002
[covariance]
names = ["gain", "wn", "zeta", "delay"]
logarithms = [false, true, true, false]
low = [0.1, 10.0, 0.02, 0.0]
high = [10.0, 3e4, 50.0, 0.012]
rows = [[4e-4, 0.0, 0.0, 0.0], [0.0, 0.0025, 0.002, 0.0], [0.0, 0.002, 0.0025, 0.0],
        [0.0, 0.0, 0.0, 1e-8]]
"""
SERVO = """
model = "delay, viscous and dry"
left_out = ["the gains of other logs than the first"]
plant = "pendulum"
unit = "rad"
[[loop]]
name = "identified"
delay = 0.004
mass = 0.03
joint_damping = 0.2
joint_stiffness = 0.5
kp = 12.0
kd = 0.5
position_resolution = 0.0015
control_rate = 200.0
[verdict]
level = "not good enough"
[estimates]
lag = { value = 0.01, low = 0.008, high = 0.0125, number = "wn" }
inertia = { value = 0.03, low = 0.027, high = 0.033 }
[numbers]
inertia = 0.03
viscous = 0.2
coulomb = 0.1
loaded = 0.2
gravity = 0.5
delay = 0.004
wn = 20000.0
zeta = 100.0
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    (tmp_path / "bench.toml").write_text(BENCH)
    (tmp_path / "servo.toml").write_text(SERVO)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_joint_takes_what_it_does_not_say_itself():
    loop = jx.joint(drive="bench.toml", inertia=0.05, kp=20, kd=0.6, delay=0.005)
    told = jx.joint(inertia=0.05, kp=16, kd=0.48, wn=110, zeta=0.9, delay=0.005, control_rate=500)
    assert loop.kind.unit == "rad" and loop.delay == 0.005
    assert float(jx.margins(loop).sensitivity_peak) == pytest.approx(
        float(jx.margins(told).sensitivity_peak), rel=1e-12
    )
    other = jx.joint(drive="bench.toml", actuator="hyq")
    assert (other.wn, other.zeta, other.delay) == (800.0, 0.45, 0.002)


def test_a_robot_takes_dynamics_and_friction_and_keeps_its_bodies():
    model = ROOT / "experiments" / "quadruped" / "quadruped.xml"
    loop = jx.robot(model, drive="servo.toml", delay={".*_knee": 0.01})
    assert loop.values == {
        "delay": 0.004, "joint_damping": 0.2, "joint_friction": 0.1, "position_resolution": 0.0015,
        "control_rate": 200.0, "delay@.*_knee": 0.01,
    }  # fmt: skip
    left_out = jx.load_drive("servo.toml").left_out(robot=True)
    assert "its joint's inertia" in left_out and "the gains of its log" in left_out


def test_a_specification_names_its_drive_beside_it(folder):
    inner = folder / "inner"
    inner.mkdir()
    text = 'drive = "../servo.toml"\n[parameters]\ndelay = 0.001\n[axes]\nkp = [1.0, 20.0]\n'
    (inner / "sweep.toml").write_text(text)
    found = reading.load(inner / "sweep.toml")
    assert found.unit == "rad" and found.nominal["kp"] == 12.0
    assert found.parameters["delay"] == 0.001 and found.parameters["mass"] == 0.03
    assert reading.parse(found.text) == found  # a store needs the drive's file no more
    other = reading.load(inner / "sweep.toml", drive=folder / "bench.toml")
    assert other.parameters["wn"] == 110.0 and "mass" not in other.parameters
    again = reading.load(inner / "sweep.toml", ['drive="../bench.toml"', "wn=90"])
    assert again.parameters["wn"] == 90.0 and again.parameters["zeta"] == 0.9


def test_listed_loops_have_drives_of_their_own(folder):
    text = '[[loop]]\ndrive = "bench.toml"\n[[loop]]\ndrive = "servo.toml"\ndelay = 0.0\n'
    (folder / "loops.toml").write_text(text)
    loops = jx.loop_of("loops.toml", kp=5.0)
    assert loops.kind.unit == "rad"
    np.testing.assert_array_equal(loops.delay, [0.002, 0.0])
    np.testing.assert_array_equal(loops.kp, [5.0, 5.0])
    np.testing.assert_array_equal(loops.mass, [0.7, 0.03])


def _differenced(folder, ticks=1):
    """The servo, whose controller differences its positions, as `identify` writes it."""
    text = SERVO.replace('plant = "pend', f'difference_ticks = {ticks}\nplant = "pend')
    text = text.replace('name = "identified"', 'name = "identified"\nvelocity = "differenced"')
    (folder / "differenced.toml").write_text(text)
    return "differenced.toml"


@pytest.mark.exhaustive
def test_a_controller_that_differenced_positions_goes_on_doing_so(folder):
    file = _differenced(folder)
    loop = jx.joint(drive=file)
    assert loop.kind.velocity == "differenced"
    assert jx.joint(drive=file, velocity="sampled").kind.velocity == "sampled"
    assert jx.joint(drive="servo.toml").kind.velocity == "sampled"
    told = jx.joint(drive="servo.toml", velocity="differenced")
    sampled = [float(jx.margins(one, sampled=True).gain_margin) for one in (loop, told)]
    assert sampled[0] == pytest.approx(sampled[1], rel=1e-12)
    assert sampled[0] < float(jx.margins(jx.joint(drive="servo.toml"), sampled=True).gain_margin)
    model = ROOT / "experiments" / "quadruped" / "quadruped.xml"
    assert jx.robot(model, drive=file).kind.velocity == "differenced"


def test_files_that_name_such_a_drive_have_its_velocity(folder):
    file = _differenced(folder)
    (folder / "sweep.toml").write_text(f'drive = "{file}"\n[axes]\nkp = [1.0, 20.0]\n')
    assert jx.loop_of("sweep.toml").kind.velocity == "differenced"
    assert jx.loop_of("sweep.toml", velocity="sampled").kind.velocity == "sampled"
    told = reading.load(folder / "sweep.toml", ["velocity=sampled"])
    assert told.velocity == "sampled"
    (folder / "loops.toml").write_text(f'[[loop]]\ndrive = "{file}"\n')
    assert jx.loop_of("loops.toml").kind.velocity == "differenced"
    assert jx.loop_of(file).kind.velocity == "differenced"  # as a list of one
    (folder / "loops.toml").write_text(f'[[loop]]\ndrive = "{file}"\n[[loop]]\nkp = 3.0\n')
    with pytest.raises(UserError, match="of some loops difference positions, of others not"):
        jx.loop_of("loops.toml")
    assert jx.loop_of("loops.toml", velocity="sampled").kind.velocity == "sampled"


@pytest.mark.exhaustive
def test_commands_take_the_velocity_of_the_drive(folder, capsys):
    file, found = _differenced(folder), {}
    for how in ((), ("--velocity", "differenced"), ("--velocity", "sampled")):
        assert main(["margins", "--drive", file, "--json", *how]) == 0
        found[how] = json.loads(capsys.readouterr().out)
    unsaid, differenced, sampled = found.values()
    assert unsaid == differenced != sampled


def test_a_difference_over_several_rows_is_over_one_in_a_loop_and_said(folder, capsys):
    file = _differenced(folder, ticks=3)
    assert jx.joint(drive=file).kind.velocity == "differenced"
    for robot in (False, True):
        identified(Path(file), (), robot=robot)
        said = capsys.readouterr().err
        assert "that its positions were differenced over 3 rows, here over one" in said


def test_draws_have_the_covariance_of_the_file():
    many = jx.joint(drive="bench.toml", samples=4000, seed=3)
    logs = np.log(np.stack([many.wn, many.zeta]))
    np.testing.assert_allclose(np.cov(logs), [[0.0025, 0.002], [0.002, 0.0025]], atol=2e-4)
    assert np.std(many.delay) == pytest.approx(1e-4, rel=0.05)
    assert np.mean(many.gain_scale) == pytest.approx(0.8, rel=1e-2)
    assert np.std(many.gain_scale) == pytest.approx(0.02, rel=0.05)


def test_intervals_are_of_what_the_loop_has_from_its_drive():
    drive = jx.load_drive("bench.toml")
    loop = jx.joint(drive=drive, inertia=0.05, delay=0.001)
    box = read_box(intervals(drive, loop), FIELDS)
    ends = {one.name: (one.low, one.high) for one in box.ranges}
    assert ends == {
        "mass": pytest.approx((0.8 / 0.84, 0.8 / 0.76)),  # a stronger drive moves a lighter joint
        "wn": pytest.approx((0.9, 1.1)),
        "zeta": pytest.approx((0.9, 1.1)),
    }
    assert "mass=0.5x..2x" in intervals(drive, loop, "mass=0.5x..2x")
    servo = jx.load_drive("servo.toml")
    # A time constant's interval is its frequency's turned round.
    assert servo.uncertainty["wn"] == (pytest.approx(0.8), pytest.approx(1.25))


def test_a_box_of_too_many_numbers_is_refused(folder):
    keys = [f"delay@joint_{at}" for at in range(9)]
    open_numbers = "".join(f'"{key}" = [0.0, 0.01]\n' for key in keys)
    values = "".join(f'"{key}" = 0.002\n' for key in keys)
    (folder / "robot.toml").write_text(
        f'plant = "robot"\nunit = "rad"\n[robot]\n{values}[uncertainty]\n{open_numbers}'
        "[estimates]\n[joints]\n"
    )
    model = ROOT / "experiments" / "quadruped" / "quadruped.xml"
    loop = jx.robot(model, drive="robot.toml")
    with pytest.raises(UserError, match=r"robot\.toml leaves 9 numbers open"):
        jx.tune(loop, uncertainty=jx.load_drive("robot.toml"))


@pytest.mark.exhaustive
def test_gains_are_robust_over_the_drawn_drives(folder, capsys):
    (folder / "still.toml").write_text(BENCH.replace("control_rate = 500.0\n", ""))
    given = ["--drive", "still.toml", "--inertia", "0.05", "--max-peak", "2"]
    words = ["--uncertainty", "samples", "--ensemble", "8", "--starts", "2", "--steps", "60"]
    assert main(["tune", *given, *words, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["drive_gain"] == 0.8
    # The gains are those at the joint: a draw's is in proportion to the drive's.
    drawn = jx.joint(drive="still.toml", inertia=0.05, samples=8)
    share = np.asarray(drawn.gain_scale) / 0.8
    drawn = drawn.replace(kp=found["kp"], kd=found["kd"], gain_scale=share)
    margins = jx.margins(drawn)
    worst = max(np.max(margins.sensitivity_peak), np.max(margins.complementary_peak))
    assert worst == pytest.approx(2.0, rel=1e-3)


def test_a_limit_of_the_command_is_the_forces_or_said(folder):
    text = SERVO.replace('unit = "rad"', 'unit = "rad"\ncommand_limit = 3.0')
    (folder / "clipped.toml").write_text(text.replace("mass =", "force_limit = 2.4\nmass ="))
    clipped = jx.load_drive("clipped.toml")
    assert jx.joint(drive=clipped).force_limit == 2.4
    assert not any("limit" in words for words in clipped.left_out())
    (folder / "slow.toml").write_text(text.replace("mass =", "wn = 90.0\nzeta = 1.0\nmass ="))
    said = "a limit of its command of 3 N m"
    assert all(said in jx.load_drive("slow.toml").left_out(robot=own) for own in (False, True))


def _found(wn, *logs):
    """What was identified of these logs with a gain of -0.8, as far as its loop needs it."""
    numbers = {"gain": -0.8, "inertia": 0.7, "wn": wn, "zeta": 1.0, "command_limit": 1e12}
    chosen = SimpleNamespace(numbers=numbers, fit=SimpleNamespace(problem=NO_UNKNOWNS))
    ladder = SimpleNamespace(
        fitted=logs, chosen=chosen, family=SimpleNamespace(neutral={"wn": np.inf})
    )
    return Identified("mass", ladder, (SimpleNamespace(quanta={}),), None)


def test_commands_within_a_limit_are_forces_within_it_but_for_dynamics():
    time = np.arange(300) * 2e-3
    signals = {"setpoint": np.sin(time), "position": np.sin(time)}
    log = Log("log", time, signals, gains=(20.0, 1.0), details={"command_limit": 3.0})
    assert _found(np.inf, log)._loop_values()["force_limit"] == pytest.approx(0.8 * 3.0)
    assert _found(np.inf, log)._command_limit() == 3.0
    assert "force_limit" not in _found(90.0, log)._loop_values()
    excited = Log("log", time, {"command": np.clip(np.sin(30 * time), -0.4, 0.4)} | signals)
    assert _found(np.inf, excited)._command_limit() == pytest.approx(0.4)
    del excited.signals["setpoint"]  # then it may be how the joint was excited
    assert _found(np.inf, excited)._command_limit() is None


def test_other_logs_have_other_loads():
    time = np.arange(300) * 2e-3
    logs = [Log("log", time, {}, details={"inertia": inertia}) for inertia in (0.05, 0.15)]
    assert _found(np.inf, *logs)._left_out() == ["the inertia of other logs than the first"]
    assert _found(np.inf, logs[0])._left_out() == []


def test_what_is_left_out_or_assumed_is_said(capsys):
    assert identified(Path("servo.toml"), ()) is not None
    said = capsys.readouterr().err
    assert "left out here: dry friction of 0.1 N m, friction that grows" in said
    assert "the gains of other logs than the first" in said
    assert "call it not good enough" in said
    identified(Path("bench.toml"), ("kp",))
    assert "does not say what the joint moves; taken: 0.7 kg m^2" in capsys.readouterr().err
    identified(Path("bench.toml"), ("inertia",))
    identified(Path("bench.toml"), (), robot=True)
    assert capsys.readouterr().err == ""
    identified(Path("servo.toml"), (), robot=True)
    said = capsys.readouterr().err
    assert "joint_damping and joint_friction are added to every driven joint's own" in said


def _broken(folder, old, new):
    (folder / "broken.toml").write_text(BENCH.replace(old, new))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[estimates]", "[other]", "is not a drive; give a file that jaxact identify wrote"),
        ("wn = 110.0\nzeta", 'wn = "fast"\nzeta', "wn = 'fast' is not a number"),
        ("low = 0.76, ", "", "is damaged (KeyError: 'low')"),
        ('unit = "rad"', 'unit = "deg"', "unit = 'deg'; allowed: m, rad"),
        ("[verdict]", "[[loop]]\n[verdict]", "has 2 loops; a drive has one"),
        ("[numbers]", "[numbers", "is not valid TOML"),
    ],
)
def test_a_broken_file_is_one_line(folder, capsys, old, new, said):
    _broken(folder, old, new)
    assert main(["margins", "--drive", "broken.toml"]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (["margins", "--drive", "none.toml"], "none.toml: cannot be read"),
        (["tune", "--drive", "bench.toml", "--uncertainty", "sample"], "did you mean 'samples'?"),
        (["tune", "--uncertainty", "samples"], "is of an identified drive; give one with --drive"),
        (
            ["tune", "--drive", "bench.toml", "--uncertainty", "samples,mass=1..2"],
            "leave the ranges",
        ),
        (
            ["tune", "--drive", "servo.toml", "--uncertainty", "samples"],
            "no covariance to draw from",
        ),
    ],
)
def test_what_does_not_fit_is_said(capsys, command, said):
    assert main(command) == 2
    assert said in capsys.readouterr().err


def test_samples_need_a_drive():
    with pytest.raises(UserError, match="are those of a `drive`"):
        jx.joint(samples=3)
