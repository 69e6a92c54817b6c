"""What is reported, or refused, of the loop itself beside what is not known of it."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import jaxact
from quickly import compiled_quickly as compiled_quickly
from robots import PENDULUM

import jaxact as jx
from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.tuning.box import inside, read_box
from jaxact.tuning.joint.ensemble import FIELDS
from jaxact.tuning.robot.amid import amid
from jaxact.tuning.robot.loops import VARIED
from jaxact.verbs import tuning_tables


def reported(*options, cwd):
    done = jaxact(
        "tune", "--actuator", "starleth", "--max-peak", "1.6", "--json", *options, cwd=cwd
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_nominal_loop_lies_within_the_box(tmp_path):
    found = reported("--uncertainty", "delay=2e-3..4e-3", cwd=tmp_path)
    loop = jx.joint(kp=found["kp"], kd=found["kd"], actuator="starleth", delay=3e-3)
    expected, own = jx.margins(loop), found["margins"]["after"]
    for name in ("gain_margin", "delay_margin", "sensitivity_peak"):
        assert own[name] == pytest.approx(float(getattr(expected, name)), rel=1e-9)


def test_gains_with_a_factor_are_reported_as_they_arrive():
    loop = jx.joint(kp=100, kd=8, actuator="starleth", delay=1e-3, gain_scale=0.5)
    tuned = jx.tune(loop, max_peak=1.6)
    document = tuning_tables.Joint(tuned, tuned.loop, "joint").report()
    plain = jx.joint(actuator="starleth", delay=1e-3)
    for side, kp, kd in (("after", tuned.kp, tuned.kd), ("before", 50.0, 4.0)):
        expected = jx.margins(plain.replace(kp=kp, kd=kd))
        found = document["margins"][side]["gain_margin"]
        assert found == pytest.approx(float(expected.gain_margin), rel=1e-9)
    assert document["margins"]["after"]["complementary_peak"] <= 1.6 * (1.0 + 1e-9)


@pytest.mark.parametrize(
    "change, name",
    (
        ({"control_rate": [1000.0, 200.0]}, "control_rate"),
        ({"velocity_filter": [300.0, 500.0], "velocity": "differenced"}, "velocity_filter"),
        ({"velocity": "differenced"}, "velocity"),
    ),
)
def test_draws_are_sampled_as_the_loop_itself(change, name):
    loop = jx.joint(actuator="starleth", delay=1e-3, control_rate=1000)
    with pytest.raises(UserError, match=f"loops whose {name} is not that of the loop itself"):
        jx.tune(loop, uncertainty=loop.replace(**change))


def test_draws_may_differ_in_anything_else():
    """A batch over two axes, whose values broadcast."""
    loop = jx.joint(actuator="starleth", delay=1e-3)
    draws = loop.replace(mass=np.array([[0.6], [0.7]]), delay=np.array([1e-3, 2e-3, 3e-3]))
    tuned = jx.tune(loop, max_peak=1.6, uncertainty=draws)
    found = jx.margins(draws.replace(kp=tuned.kp, kd=tuned.kd))
    peaks = np.maximum(found.sensitivity_peak, found.complementary_peak)
    assert tuned.certified and len(tuned.members) == 7
    assert float(np.max(peaks)) == pytest.approx(1.6, rel=1e-6)


@pytest.mark.parametrize("goal", ("settling", "tracking"))
def test_a_late_setpoint_is_no_part_of_simulated_time(goal, tmp_path):
    if goal == "tracking":
        (tmp_path / "path.csv").write_text("# time, setpoint\n0,0\n0.1,0.1\n0.2,0\n")
        goal = f"tracking:{tmp_path / 'path.csv'}"
    loop = jx.joint(actuator="starleth", delay=1e-3)
    late = loop.replace(setpoint_delay=0.03)
    for one, draws in ((late, ""), (loop, late.replace(mass=[0.6, 0.8]))):
        with pytest.raises(UserError, match="`setpoint_delay`: settling and tracking are of"):
            jx.tune(one, goal, max_peak=1.6, uncertainty=draws)


@pytest.mark.parametrize("ends", ((1.3, 1.3), (1.2, 1.6), (0.5, 0.9)))
def test_a_factor_that_leaves_out_a_default_is_on_the_middle(ends):
    """The loop is the middle of the box, and the box is as it was written."""
    low, high = ends
    box = read_box(f"mass={low}x..{high}x", FIELDS)
    (one,) = box.ranges
    loop = jx.joint(actuator="starleth", delay=1e-3)
    found, moved = inside(box, loop.values, loop.parameters)
    middle = 0.5 * 0.7 * (low + high)
    assert found == {"mass": pytest.approx(middle)}
    expected = pytest.approx((0.7 * low, 0.7 * high))
    (after,) = moved.ranges
    assert one.ends({"mass": 0.7})["mass"] == expected == after.ends(found)["mass"]
    with pytest.raises(UserError, match="leaves out 1, the loop's own mass"):
        inside(box, {"mass": 0.7}, loop.parameters)


@pytest.mark.exhaustive
def test_the_loop_with_new_gains_is_one_of_those_that_are_certified():
    loop = jx.joint(actuator="starleth", delay=1e-3)
    best = jx.tune(loop, uncertainty="mass=1.3x..1.3x", max_peak=1.6, starts=2, steps=30)
    assert best.certified and best.loop.mass == pytest.approx(0.91)
    np.testing.assert_allclose(best.members.mass, 0.91)
    found = jx.margins(best.loop)
    peak = max(float(found.sensitivity_peak), float(found.complementary_peak))
    assert peak == pytest.approx(1.6, rel=1e-6)


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(PENDULUM)
    return path


@pytest.mark.parametrize(
    "given, ranges, expected",
    (
        ("delay = 0.008", "delay=0..2e-3", None),
        ("delay = 0.008", "delay@elbow=0..2e-3", None),
        ('"delay@.*" = 0.008', "delay@elbow=0..2e-3", None),
        ('"delay@shoulder" = 0.008', "delay=0..2e-3", None),
        ('"delay@shoulder" = 0.008', "delay@elbow=1e-3..3e-3", {"delay@elbow": 2e-3}),
        ("", "delay=4e-3..6e-3", {"delay": 5e-3}),
        ("", "delay=4e-3..4e-3", {"delay": 4e-3}),
        ("", "payload=1..3,delay=0..1e-3", {"payload": 2.0}),
        ("", "inertia_scale=1.4..1.6,delay=0..1e-3", {"inertia_scale": 1.5}),
        ("", "inertia_scale=0.9..1.6", {}),
        ("inertia_scale = 1.5", "inertia_scale=1.4..1.6", None),
        ("delay = 0.001", "delay@elbow=0..2e-3,wn=0.8..1.2", {}),
    ),
)
def test_a_robot_is_among_those_that_its_box_holds(arm, given, ranges, expected):
    text = f"""
engine = "mujoco"
[plant]
model = '{arm}'
keyframe = "home"
[parameters]
actuator = "hyq"
{given}
[axes]
feedforward = [0.0]
"""
    specification, box = reading.parse(text), read_box(ranges, VARIED, patterns=True)
    if expected is None:
        with pytest.raises(UserError, match="leaves out (1, )?the loop's own"):
            amid(specification, box)
    else:
        assert amid(specification, box)[0] == pytest.approx(expected)


@pytest.mark.exhaustive
def test_what_is_certified_of_a_robot_is_of_the_loop_with_its_gains(arm):
    loop = jx.robot(arm, keyframe="home", actuator="hyq", control_rate=500)
    tuned = jx.tune(
        loop, max_peak=2.5, uncertainty={"delay": (4e-3, 6e-3)}, samples=2, steps=20, starts=1
    )
    found = jx.margins(tuned.loop)
    assert tuned.certified and tuned.loop.values["delay"] == 5e-3
    assert max(found.sensitivity_peak, found.complementary_peak) <= 2.5 * (1.0 + 1e-6)
