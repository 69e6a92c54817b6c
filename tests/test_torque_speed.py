"""Half a torque-speed line is refused, of every loop and joint; a whole one or none is not."""

import numpy as np
import pytest
from robots import PENDULUM

import jaxact as jx
from jaxact.errors import UserError
from jaxact.loops import torque_speed
from jaxact.loops.reading import parse

INF = np.inf
NEEDS = ": a torque-speed line needs stall_force and no_load_speed, both finite"


def said_of(stall_force, no_load_speed, joints=()):
    with pytest.raises(UserError) as raised:
        torque_speed.check((stall_force, no_load_speed), joints)
    assert "\n" not in str(raised.value)
    return str(raised.value).partition(NEEDS)[0]


def test_whole_lines_and_none_are_taken():
    torque_speed.check((INF, INF))
    torque_speed.check((20.0, 3.0))
    torque_speed.check(([[20.0], [30.0]], [[3.0, 4.0]]))
    torque_speed.check(([20.0, INF], [3.0, INF]))
    torque_speed.check(([[20.0, INF]], [[3.0, INF], [5.0, INF]]), ("a", "b"))


def test_the_half_that_is_missing_is_named():
    assert said_of(20.0, INF) == "no_load_speed"
    assert said_of(INF, 3.0) == "stall_force"
    assert said_of([20.0, 30.0], INF) == "no_load_speed"
    assert said_of([20.0, INF], [3.0, 3.0]) == "stall_force of some loops"
    both = "no_load_speed of some loops, stall_force of some loops"
    assert said_of([20.0, INF], [INF, 3.0]) == both
    assert said_of([[20.0], [INF]], [[3.0, INF]]) == both


def test_the_joints_that_lack_it_are_named():
    assert said_of([20.0, INF], [INF, 3.0], ("a", "b")) == "no_load_speed of a, stall_force of b"
    assert said_of(20.0, [[3.0, 3.0], [3.0, INF]], ("a", "b")) == "no_load_speed of b"
    names = tuple("abcdef")
    assert said_of(20.0, np.full(6, INF), names) == "no_load_speed of a, b, c, d and 2 more"


def test_a_large_grid_is_not_written_out():
    many = np.linspace(1.0, 2.0, 1_000_000)
    torque_speed.check((many[:, None], many))
    assert said_of(many[:, None], np.append(many, INF)) == "no_load_speed of some loops"


@pytest.mark.parametrize(
    "text, taken",
    [
        ("[parameters]\nno_load_speed = 3\n[axes]\nstall_force = [10, 20]", True),
        ("[parameters]\nno_load_speed = 3\n[axes]\nstall_force = [10, inf]", False),
        ("[axes]\nstall_force = [inf]\nno_load_speed = [3, inf]", False),
        ("[axes]\nstall_force = [10, inf]", False),
        ("[axes]\nstall_force = [inf]", True),
    ],
)
def test_an_axis_may_have_what_makes_lines_with_all_of_the_other(text, taken):
    if taken:
        parse(text)
        return
    with pytest.raises(UserError, match=NEEDS):
        parse(text)


def test_loops_of_a_batch_are_looked_at_in_pairs():
    whole = jx.joint(kp=100.0, kd=5.0, stall_force=[20.0, INF], no_load_speed=[3.0, INF])
    assert jx.simulate(whole, duration=0.02).sizes["loop"] == 2
    halves = whole.replace(no_load_speed=[INF, 3.0])
    with pytest.raises(UserError, match=f"stall_force of some loops{NEEDS}"):
        jx.simulate(halves, duration=0.02)


def test_a_sweep_meets_each_value_with_each(tmp_path):
    axes = {"stall_force": [20.0, INF], "no_load_speed": [3.0, INF]}
    with pytest.raises(UserError, match=f"no_load_speed of some loops.*{NEEDS}"):
        jx.sweep(jx.joint(), out=tmp_path / "results", duration=0.02, progress=False, **axes)
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize(
    "line, said",
    [
        ({"stall_force": {"shoulder": 1e3}, "no_load_speed": {"elbow": 0.5}},
         "no_load_speed of shoulder, stall_force of elbow"),
        ({"stall_force": 20.0, "no_load_speed": {"elbow": 0.5}}, "no_load_speed of shoulder"),
        ({"stall_force": {"elbow": [20.0, INF]}, "no_load_speed": {"elbow": 0.5}},
         "stall_force of elbow"),
        ({"stall_force": 20.0}, "no_load_speed"),
    ],
)  # fmt: skip
def test_each_joint_of_a_robot_has_both_or_none(tmp_path, line, said):
    (tmp_path / "arm.xml").write_text(PENDULUM)
    loop = jx.robot(tmp_path / "arm.xml", keyframe="home", **line)
    for ask in (lambda: jx.simulate(loop, duration=0.02), lambda: jx.margins(loop)):
        with pytest.raises(UserError, match=f"^{said}{NEEDS}"):
            ask()


@pytest.mark.parametrize(
    "line",
    [
        {"stall_force": {"elbow": 20.0}, "no_load_speed": {"elbow": 3.0}},
        {"stall_force": {".*": 20.0}, "no_load_speed": 3.0},
    ],
)
def test_joints_of_a_robot_may_have_lines_and_others_none(tmp_path, line):
    (tmp_path / "arm.xml").write_text(PENDULUM)
    loop = jx.robot(tmp_path / "arm.xml", keyframe="home", **line)
    assert jx.simulate(loop, duration=0.02, engine="mujoco").sizes["joint"] == 2
