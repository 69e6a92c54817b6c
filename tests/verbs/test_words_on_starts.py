"""What `simulate` says of a loop's starts."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import robots
from quickly import compiled_quickly as compiled_quickly

from jaxact.loops import reading
from jaxact.simulation import single
from jaxact.simulation.single import Joint, Single, Start
from jaxact.simulation.starts import of_joints
from jaxact.simulation.verdicts import Judgement
from jaxact.status import Verdict
from jaxact.verbs import starts

ARM = """
engine = "mujoco"
duration = 0.2
[plant]
model = '{path}'
keyframe = "home"
[parameters]
delay = 0.03
[axes]
feedforward = [0.0]
"""


def _run(verdict, growth_rate, *starts, duration=2.0, moved=0.0, limited=False, **values):
    made = tuple(Start(name, end, moving, not moving, 0.0, 0.0) for name, end, moving in starts)
    results = {"verdict": float(verdict), "growth_rate": growth_rate}
    of_robot = SimpleNamespace(
        configuration=np.zeros((1, 1)),
        time=np.array([0.0, duration]),
        position=np.array([[0.0], [moved]]),
    )
    return Single(of_robot, results, values, (Joint("hip", True),), made, limited)


@pytest.mark.parametrize(
    ("verdict", "growth_rate", "slide", "moving", "said"),
    [
        (Verdict.STABLE, -1.0, Verdict.STABLE, False, Verdict.STABLE.advice),
        (Verdict.UNSTABLE, 1.0, Verdict.UNSTABLE, True, Verdict.UNSTABLE.advice),
        (Verdict.UNSTABLE, 1.0, Verdict.UNSTABLE, False, "dry friction ended the motion"),
        (Verdict.UNSTABLE, -1.0, Verdict.UNSTABLE, True, "Small perturbations decay, but"),
    ],
)
def test_advice_is_that_of_what_happened(verdict, growth_rate, slide, moving, said):
    own = Verdict.STABLE if growth_rate < 0.0 else Verdict.UNSTABLE
    run = _run(verdict, growth_rate, ("", own, False), ("slide", slide, moving))
    assert said in starts.advice(run)


def test_a_growth_rate_of_the_posture_is_not_said_to_be_that_of_the_setpoint():
    own = ("", Verdict.UNSTABLE, False)
    said = starts.advice(_run(Verdict.UNSTABLE, 1.0, own, moved=0.287))
    assert "the posture. The robot came to rest 0.29 rad from it" in said
    assert "came to rest" not in starts.advice(_run(Verdict.UNSTABLE, 1.0, own, moved=1e-3))
    came_back = _run(Verdict.UNSTABLE, 1.0, own, moved=-0.3, initial_position=0.3)
    assert "came to rest" not in starts.advice(came_back)
    going_on = ("", Verdict.UNSTABLE, True)
    assert "came to rest" not in starts.advice(_run(Verdict.UNSTABLE, 1.0, going_on, moved=0.3))


@pytest.mark.parametrize(
    ("values", "slides", "said"),
    [
        ({}, False, "keeps going at this amplitude, of a robot far from its posture; lower gains"),
        ({"force_limit": np.inf, "position_resolution": 0.0}, False, "far from its posture"),
        ({"force_limit": np.nan}, False, "far from its posture"),
        (
            {"force_limit": np.nan, "limited": True},
            False,
            "goes on, as the limits of its force can",
        ),
        ({"force_limit@hip": 9.0}, True, "as the limits of its force and dry friction can make it"),
        ({"command_resolution": 0.1}, False, "shorten the delay or make the counts finer."),
        ({}, True, "as dry friction can make it; lower the gains or shorten the delay."),
    ],
)
def test_of_a_limit_cycle_only_causes_that_the_loop_has_are_said(values, slides, said):
    own = [("", Verdict.LIMIT_CYCLE, True)]
    own += [("slide", Verdict.LIMIT_CYCLE, True)] * slides
    found = starts.advice(_run(Verdict.LIMIT_CYCLE, 1.0, *own, **values))
    assert said in found
    assert ("friction" in found) == slides
    assert ("counts" in found) == ("command_resolution" in values)


@pytest.mark.parametrize(("slides", "ends"), [(False, "small."), (True, "small, and whether")])
def test_a_cycle_that_still_got_smaller_is_said_to(slides, ends):
    names = ["", "slide"] if slides else [""]
    run = _run(Verdict.LIMIT_CYCLE, 1.0, *((name, Verdict.LIMIT_CYCLE, True) for name in names))
    assert "smaller" not in starts.advice(run)
    run = replace(run, starts=tuple(replace(start, narrowing=True) for start in run.starts))
    assert f"still getting smaller when the duration was over: a longer one tells how {ends}" in (
        starts.advice(run)
    )
    assert ("still getting smaller, after" in " ".join(starts.lines(run))) == slides


@pytest.mark.parametrize("limits", ["", ' forcerange="-9 9"'])
def test_of_a_robot_limits_are_a_cause_where_its_model_has_some(tmp_path, limits):
    """Its verdict is set: which limits there are is what the simulation tells."""
    text = robots.PENDULUM.replace(' kp="80"', f' kp="80"{limits}')
    (tmp_path / "arm.xml").write_text(text)
    run = single.simulate(reading.parse(ARM.format(path=tmp_path / "arm.xml")))
    assert run.limited == bool(limits) and not np.isposinf(run.values["force_limit"])
    run = replace(run, results=run.results | {"verdict": float(Verdict.LIMIT_CYCLE)})
    said = "as the limits of its force can make it" if limits else "far from its posture"
    assert said in starts.advice(run) and "friction" not in starts.advice(run)


def test_a_run_that_was_too_short_to_tell_is_said_to_be():
    lost = ("", Verdict.UNSTABLE, True)
    assert "too short" not in starts.advice(_run(Verdict.UNSTABLE, -1.0, lost))
    said = starts.advice(_run(Verdict.UNSTABLE, -1.0, lost, duration=0.1))
    assert "Or 0.1 s are too short to tell" in said and "decays by 10% in them" in said


def test_what_is_still_under_way_at_the_end_is_said():
    for frequency, said in ((float("nan"), True), (3.0, False)):
        own = (Start("", Verdict.STABLE, False, False, 0.1, frequency),)
        run = Single(None, {"verdict": 0.0}, {}, (Joint("joint", False),), own)
        assert ("a longer one tells" in " ".join(starts.lines(run))) == said


def test_a_limit_cycle_has_the_unit_and_the_name_of_the_joint_that_moves():
    """The one that moves most of a slide at rest and a hinge that goes on."""
    shape = (2, 2)  # starts, joints
    rows = Judgement(
        verdict=np.array([[0, 0], [0, int(Verdict.LIMIT_CYCLE)]]),
        moving=np.array([[False, False], [False, True]]),
        resting=np.array([[True, True], [True, False]]),
        narrowing=np.zeros(shape, bool),
        widening=np.zeros(shape, bool),
        amplitude=np.array([[0.0, 0.0], [0.3, 0.05]]),
        frequency=np.full(shape, 8.0),
    )
    found = of_joints(rows)
    assert found.joint.tolist()[1] == 1
    kick = Start("kick", Verdict.LIMIT_CYCLE, True, False, float(found.amplitude[1]), 8.0, joint=1)
    run = _run(Verdict.LIMIT_CYCLE, -1.0, ("", Verdict.STABLE, False))
    joints = (Joint("rail", False), Joint("hinge", True))
    run = replace(run, joints=joints, starts=(*run.starts, kick))
    (line,) = starts.lines(run)
    assert "limit cycle of 0.05 rad (hinge) at 8 rad/s after a small kick" in line
    assert starts.document(run)[1]["joint"] == "hinge"
