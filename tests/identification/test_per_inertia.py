"""Drives known per unit of an inertia that is not: in front of a joint whose inertia is given."""

import numpy as np
import pytest

import jaxact as jx
from jaxact.cli.main import main
from jaxact.errors import UserError
from jaxact.identification.log import Log
from jaxact.loops import reading
from jaxact.tuning.box import read_box
from jaxact.tuning.joint.ensemble import FIELDS
from jaxact.verbs.tune import intervals

INERTIA, OTHER = 0.05, 0.2
DRIVE = """
plant = "mass"
unit = "rad"
[[loop]]
delay = 0.004
mass = 1.0
joint_damping = 2.0
kp = 400.0
kd = 16.0
control_rate = 500.0
[estimates]
viscous = { value = 2.0, low = 1.5, high = 2.5 }
[numbers]
inertia = 1.0
viscous = 2.0
kp = 400.0
kd = 16.0
delay = 0.004
[covariance]
names = ["kp", "kd"]
logarithms = [true, false]
low = [1.0, 0.0]
high = [1e7, 1e5]
rows = [[0.0025, 0.0], [0.0, 0.09]]
"""
WHOLE = {"kp": 20.0, "kd": 0.8, "joint_damping": 0.1}  # of a joint of `INERTIA`


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    (tmp_path / "servo.toml").write_text(DRIVE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_forces_are_in_proportion_to_the_inertia_that_is_given():
    loop = jx.joint(drive="servo.toml", inertia=INERTIA)
    assert {name: loop.values[name] for name in WHOLE} == pytest.approx(WHOLE)
    assert (loop.mass, loop.delay) == (INERTIA, 0.004)
    other = jx.joint(drive="servo.toml", inertia=INERTIA, kp=10.0)
    assert (other.kp, other.joint_damping) == (10.0, pytest.approx(0.1))
    both = jx.joint(drive="servo.toml", inertia=[INERTIA, OTHER])
    np.testing.assert_allclose(both.kp, [20.0, 80.0])
    assert jx.joint(drive="servo.toml").kp == 400.0  # of one kg m^2


def test_files_of_loops_and_specifications_do_the_same(folder):
    (folder / "loops.toml").write_text('[[loop]]\ndrive = "servo.toml"\ninertia = 0.05\n')
    listed = jx.loop_of("loops.toml")
    text = 'drive = "servo.toml"\n[parameters]\nmass = 0.05\n[axes]\nkp = [1.0, 20.0]\n'
    found = reading.parse(text, folder)
    for name in ("kd", "joint_damping"):
        assert float(listed.values[name][0]) == pytest.approx(WHOLE[name])
        assert found.parameters[name] == pytest.approx(WHOLE[name])
    assert float(listed.kp[0]) == found.nominal["kp"] == pytest.approx(20.0)
    with pytest.raises(UserError, match="axes: servo.toml says gains and friction per unit"):
        reading.parse('drive = "servo.toml"\n[axes]\nmass = [0.05, 0.2]\n', folder)


def test_gains_of_an_inertia_that_is_not_given_are_refused(capsys):
    for name in ("kp", "kd", "joint_damping", "force_limit"):
        with pytest.raises(UserError, match=f"per unit of an inertia .* `{name}` is not"):
            jx.joint(drive="servo.toml", **{name: 1.0})
    assert main(["margins", "--drive", "servo.toml", "--kp", "20"]) == 2
    assert "and --kp is not; give the --inertia as well" in capsys.readouterr().err


def test_a_drive_is_simulated_per_unit_of_inertia_and_in_front_of_one(capsys):
    """Of the same motion: forces and inertia have the same factor."""
    found = []
    for options in ([], ["--inertia", "0.05"]):
        assert main(["simulate", "--drive", "servo.toml", *options, "--duration", "0.2"]) == 0
        found.append(capsys.readouterr().out)
    rates = [text.split("growth rate")[1].split()[0] for text in found]
    assert rates[0] == rates[1] and float(rates[0]) < 0.0


def test_draws_are_of_the_gains_that_were_identified():
    many = jx.joint(drive="servo.toml", inertia=INERTIA, samples=4000, seed=1)
    np.testing.assert_array_equal(many.mass, INERTIA)
    assert np.std(np.log(many.kp)) == pytest.approx(0.05, rel=0.05)
    assert np.std(many.kd) == pytest.approx(0.3 * INERTIA, rel=0.05)
    assert np.mean(many.kd) == pytest.approx(WHOLE["kd"], rel=0.01)


def test_intervals_are_those_of_the_joint():
    loop = jx.joint(drive="servo.toml", inertia=INERTIA)
    (damping,) = read_box(intervals(jx.load_drive("servo.toml"), loop), FIELDS).ranges
    assert (damping.name, damping.low, damping.high) == (
        "joint_damping", pytest.approx(0.075), pytest.approx(0.125),
    )  # fmt: skip


def test_an_export_has_the_gains_that_are_given_or_none():
    with pytest.raises(UserError, match="per unit of an inertia .* give `kp` and `kd`"):
        jx.export("servo.toml", to="mjlab")
    found = jx.export("servo.toml", to="mjlab", parameters={"kp": 20.0, "kd": 0.8})
    assert "stiffness=20.0" in found.text and "damping=0.8" in found.text
    assert "400" not in found.text and "joint_damping" not in found.text


def test_a_robot_takes_no_force_from_it():
    known = jx.load_drive("servo.toml")
    assert known.parameters(robot=True) == {"delay": 0.004, "control_rate": 500.0}
    assert "friction, which is known per unit of inertia only" in known.left_out(robot=True)


@pytest.mark.parametrize("name", ["kp", "kd", "mass", "joint_damping", "force_limit"])
def test_a_replay_refuses_forces(name):
    time = np.arange(300) * 2e-3
    log = Log("log", time, {"setpoint": np.sin(9.0 * time), "position": np.sin(8.0 * time)})
    with pytest.raises(UserError, match=f"`{name}`: changes nothing in this replay"):
        jx.replay("servo.toml", log, **{name: 1.0})
