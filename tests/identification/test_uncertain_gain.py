"""An identified drive's gain: in its loop, in draws of it, and in what is certified against it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import jaxact as jx
from jaxact.identification.log import Log
from jaxact.identification.replay import _with_gains
from jaxact.identification.result import Identified
from jaxact.loops import drives
from jaxact.tuning.box import read_box
from jaxact.tuning.joint.ensemble import FIELDS
from jaxact.verbs.plants import drawn_of, nominal_of
from jaxact.verbs.tune import intervals

NUMBERS = {"inertia": 0.02, "wn": 300.0, "zeta": 0.7, "delay": 1e-3, "gain": 0.9}
ROWS = np.arange(20)
LOG = Log("log", 1e-3 * ROWS, {n: 0.1 * ROWS for n in ("setpoint", "position", "command")})
HINGE = """<mujoco><worldbody><body><joint name="j" axis="0 1 0"/>
<geom type="capsule" size=".02" fromto="0 0 0 0 0 -.3" mass="1"/></body></worldbody>
<actuator><position joint="j" kp="30" kv="1"/></actuator></mujoco>"""


def _loop(log):
    """The loop that is written of a drive with these numbers, identified on this log."""
    own = SimpleNamespace(
        ladder=SimpleNamespace(fitted=[log]), _numbers=lambda: NUMBERS, plant="mass",
        inspections=[SimpleNamespace(quanta={})], control_rate=None, _command_limit=lambda: None,
    )  # fmt: skip
    return Identified._loop_values(own)


def _drive(loop, **estimates):
    covariance = {"names": ["gain"], "logarithms": [False], "low": [0.1], "high": [5.0],
                  "rows": [[0.01]]}  # fmt: skip
    document = {
        "plant": "mass", "unit": "rad", "loop": [loop], "numbers": NUMBERS,
        "covariance": covariance, "verdict": {"level": "good"},
        "estimates": {n: {"value": NUMBERS[n], "low": a, "high": b}
                      for n, (a, b) in estimates.items()},
    }  # fmt: skip
    return drives.of_document("drive.toml", document)


STATED = replace(LOG, gains=(80.0, 1.5))
UNRECORDED = replace(STATED, signals={n: 0.1 * ROWS for n in ("setpoint", "position")})


def test_gains_that_a_log_states_are_told_and_the_drives_gain_stays_apart():
    found = _loop(STATED)
    assert (found["kp"], found["kd"], found["gain_scale"]) == (80.0, 1.5, 0.9)
    drive = _drive(found)
    for own in ({}, {"kp": 80.0, "kd": 1.5}):
        loop = jx.joint(drive=drive, **own)
        assert (loop.kp * loop.gain_scale, loop.kd * loop.gain_scale) == (72.0, 1.35)
    assert drive.parameters(robot=True)["gain_scale"] == 0.9
    assert jx.joint(drive=_drive(_loop(LOG)), kp=80.0, kd=1.5).gain_scale == 0.9


def test_gains_whose_command_was_not_recorded_are_those_at_the_joint():
    found = _loop(UNRECORDED)
    assert (found["kp"], found["kd"]) == (72.0, 1.35) and "gain_scale" not in found


@pytest.mark.parametrize("log", [STATED, UNRECORDED])
def test_a_replay_has_the_gains_that_the_log_had(log):
    unsaid = replace(log, gains=(None, None))
    assert _with_gains(_drive(_loop(log)), unsaid, {}).gains == pytest.approx((80.0, 1.5))


@pytest.mark.parametrize("log", [STATED, UNRECORDED, LOG])
def test_drawn_gains_are_those_of_lighter_and_heavier_joints(log):
    drive = _drive(_loop(log))
    drawn, loop = jx.joint(drive=drive, samples=50, seed=2), jx.joint(drive=drive)
    masses = drawn_of(drawn, loop, nominal_of(loop, True).sampling, timed=False).mass
    gains = drive.spread.draw(NUMBERS, 50, 2)["gain"]
    assert np.std(gains) > 0.05
    np.testing.assert_allclose(masses, 0.02 * 0.9 / gains)
    np.testing.assert_allclose(drawn.gain_scale * drawn.kp, loop.gain_scale * loop.kp * gains / 0.9)


def test_an_uncertain_gain_stays_so_in_front_of_another_inertia():
    drive = _drive(_loop(LOG), gain=(0.6, 1.2), inertia=(0.016, 0.024), delay=(8e-4, 1.2e-3))

    def mass(loop):
        ends = {one.name: (one.low, one.high) for one in read_box(intervals(drive, loop), FIELDS).
                ranges}  # fmt: skip
        return ends["mass"]

    assert mass(jx.joint(drive=drive)) == pytest.approx((0.8 * 0.75, 1.2 * 1.5))
    assert mass(jx.joint(drive=drive, inertia=0.05)) == pytest.approx((0.75, 1.5))
    assert intervals(drive, jx.joint(drive=drive, inertia=0.05, delay=2e-3), "mass=1..2") == (
        "mass=1..2"
    )
    known = _drive(_loop(LOG), inertia=(0.016, 0.024))
    assert intervals(known, jx.joint(drive=known, inertia=0.05)) == ""


def test_a_robots_box_says_that_it_leaves_an_uncertain_gain_out(tmp_path):
    (tmp_path / "hinge.xml").write_text(HINGE)
    drive = _drive(_loop(LOG), gain=(0.6, 1.2), delay=(8e-4, 1.2e-3))
    loop = jx.robot(tmp_path / "hinge.xml", drive=drive)
    with pytest.warns(jx.InexactWarning, match=r"of its gain, 0\.667 to 1\.33 times"):
        assert intervals(drive, loop) == "delay=0.0008..0.0012"


def test_a_gain_that_may_be_none_is_not_taken_for_known(tmp_path):
    (tmp_path / "hinge.xml").write_text(HINGE)
    for ends in ((-0.1, 1.2), (0.0, 1.2)):
        drive = _drive(_loop(LOG), gain=ends, delay=(8e-4, 1.2e-3))
        for loop in (jx.joint(drive=drive), jx.joint(drive=drive, inertia=0.05)):
            with pytest.raises(jx.UserError, match="gain of drive.toml holds 0"):
                intervals(drive, loop)
            assert "mass=1..2" in intervals(drive, loop, "mass=1..2")
        with pytest.warns(jx.InexactWarning, match=r"of its gain, 0 to 1\.33 times"):
            intervals(drive, jx.robot(tmp_path / "hinge.xml", drive=drive))


def test_what_a_robot_says_itself_is_known(tmp_path):
    (tmp_path / "hinge.xml").write_text(HINGE)
    document = {
        "plant": "robot", "unit": "rad", "estimates": {},
        "robot": {"wn@j": 300.0, "zeta@j": 0.7, "delay@j": 1e-3, "control_rate": 1000.0},
        "uncertainty": {"delay@j": [8e-4, 1.2e-3], "wn@j": [0.9, 1.1]},
    }  # fmt: skip
    drive = drives.of_document("robot.toml", document)
    loop = jx.robot(tmp_path / "hinge.xml", drive=drive)
    assert intervals(drive, loop) == "delay@j=0.0008..0.0012,wn@j=0.9..1.1"
    loop = jx.robot(tmp_path / "hinge.xml", drive=drive, delay=2e-3)
    assert intervals(drive, loop) == "wn@j=0.9..1.1"
