"""`jaxact.tune`: certified gains of a joint, an ensemble and a robot by the same call."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from robots import QUADRUPED

import jaxact as jx
from jaxact.errors import UserError

OPTIMA = json.loads((Path(__file__).parents[1] / "data" / "tuner_optima.json").read_text())


@pytest.fixture(scope="module")
def loop():
    return jx.joint(mass=0.7, kp=400, kd=20, actuator="starleth", delay=1e-3)


@pytest.fixture(scope="module")
def tuned(loop):
    return jx.tune(loop, max_peak=1.6)


def test_the_tuned_loop_meets_its_bound_and_no_more(tuned):
    found = jx.margins(tuned.loop)
    assert tuned.certified and found.sensitivity_peak == pytest.approx(1.6, rel=1e-6)
    assert found.complementary_peak <= 1.6 * (1.0 + 1e-9)
    assert tuned.loop.kp == tuned.kp and tuned.loop.wn == 110.0
    assert tuned.verdict.endswith("computed exactly in continuous time")
    assert "sampled controllers have other margins" in repr(tuned)
    # No neighbour is stiffer: along the bound kp is at its largest.
    for factor in np.geomspace(0.9, 1.1, 7):
        near = jx.margins(tuned.loop.replace(kp=1.002 * tuned.kp, kd=factor * tuned.kd))
        assert near.sensitivity_peak > 1.6


@pytest.mark.exhaustive
def test_a_front_trades_stiffness_for_robustness(loop):
    tuned = jx.tune(loop, max_peak=1.6, front=3)
    kp = [one.kp for one in tuned.front]
    assert len(kp) == 3 and kp == sorted(kp)
    assert "front of 3 points" in repr(tuned)


@pytest.mark.exhaustive
def test_what_is_certified_of_a_sampled_loop_does_not_speak_of_continuous_time(loop):
    tuned = jx.tune(loop, max_peak=1.6, sampled=True)
    found = jx.margins(tuned.loop, sampled=True)
    assert tuned.certified and float(found.sensitivity_peak) == pytest.approx(1.6, rel=1e-6)
    assert tuned.verdict.endswith("computed exactly")


@pytest.mark.exhaustive
def test_gains_under_uncertainty_hold_all_over_the_box(loop):
    best = jx.tune(loop, max_peak=1.6, uncertainty={"wn": (0.8, 1.2), "delay": (0.0, 5e-3)})
    assert best.certified
    rng = np.random.default_rng(0)
    wn, delay = 110.0 * rng.uniform(0.8, 1.2, 500), rng.uniform(0.0, 5e-3, 500)
    found = jx.margins(best.loop.replace(wn=wn, delay=delay))
    assert found.sensitivity_peak.max() <= 1.6 * (1.0 + 1e-6)
    assert jx.margins(best.loop.replace(wn=88.0, delay=5e-3)).sensitivity_peak > 1.59


def test_what_cannot_be_met_is_not_certified(loop):
    best = jx.tune(loop.replace(delay=5e-3), max_peak=1.6, min_kp=400.0)
    assert not best.certified and repr(best).splitlines()[1].startswith("NOT certified")


@pytest.mark.exhaustive
def test_a_robot_is_tuned_by_the_same_call():
    loop = jx.robot(QUADRUPED / "quadruped.xml", keyframe="stand", kp=700, kd=20, actuator="hyq",
                    delay=1e-3)  # fmt: skip
    best = jx.tune(loop, max_peak=4.0, groups=("HAA", "HFE", "KFE"), steps=30)
    assert best.certified and best.kp.shape == (12,)
    assert jx.margins(best.loop).sensitivity_peak == pytest.approx(4.0, rel=1e-3)
    assert len(np.unique(best.kp)) == 3


@pytest.mark.parametrize(
    "given, said",
    [
        ({"max_peek": 2.0}, "unknown bound of a goal; did you mean 'max_peak'"),
        ({"goal": "stif"}, "did you mean 'stiffness'"),
        ({"uncertainty": {"wm": (0.8, 1.2)}}, "did you mean 'wn'"),
        ({"uncertainty": {"wn": 3.0}}, r"give \(low, high\)"),
        ({"uncertainty": {"mass": (0.8, 1.2)}}, "leaves out the loop's own 0.7 kg.*0.8x..1.2x"),
        ({"uncertainty": {"delay": (0.0, 0.9e-3)}}, "leaves out the loop's own 0.001 s"),
        ({"uncertainty": {"wn": (1.1, 1.2)}}, "a factor of 1.1 to 1.2 leaves out 1"),
        ({"uncertainty": {"mass": (0.5, 1.2)}, "samples": -1}, "`samples` -1: give a whole number"),
        ({"risk": "mean"}, "`risk` mean: is over loops, and this is one"),
        ({"uncertainty": {"delay": (0.0, 5e-3)}, "samples": 1, "risk": "cvar:0.5"}, "single draw"),
        ({"groups": ("hip",)}, "is for a robot"),
        ({"max_peak": 0.5}, "max_peak|peak"),
        ({"objective": "disk-margin"}, "objective: is given as the goal"),
        ({"max_peek": 2.0}, "allowed: max_peak, min_gain_margin, .* max_kp, risk$"),
        ({"reference": (0.0, 1.0)}, 'reference: is of the goal "tracking"'),
        ({"reference_period": 1.0}, 'reference_period: is of the goal "tracking"'),
        ({"goal": 3}, "`goal` 3; allowed: stiffness"),
        ({"sampled": "x"}, "`sampled` 'x'; allowed: True, False, None"),
        ({"seed": "a"}, "`seed` 'a': give a whole number from 0"),
        ({"derivative": "foo"}, "`derivative` 'foo'; allowed: auto, forward, reverse"),
        ({"uncertainty": {"inertia": (0.5, 1.0)}}, "inertia: is that of a rotary joint"),
    ],
)
def test_what_makes_no_sense_is_refused(loop, given, said):
    with pytest.raises(UserError, match=said):
        jx.tune(loop, **given)


def test_a_range_of_inertia_is_said_to_be_one():
    joint = jx.joint(inertia=0.05, actuator="hyq", delay=2e-3)
    said = "`uncertainty` inertia: 0.8 to 1.2 kg m.* 0.05 kg m.*; give a value of inertia within"
    with pytest.raises(UserError, match=said):
        jx.tune(joint, max_peak=1.6, uncertainty={"inertia": (0.8, 1.2)})


@pytest.mark.exhaustive
def test_a_tuned_joint_is_among_those_certified():
    box = {"mass": (2.0, 3.0), "delay": (1e-3, 3e-3)}
    best = jx.tune(jx.joint(actuator="starleth"), max_peak=1.6, uncertainty=box, samples=2,
                   starts=2, steps=30)  # fmt: skip
    assert best.certified and (best.loop.mass, best.loop.delay) == (2.5, 2e-3)
    corners = best.loop.replace(mass=[2.0, 2.5, 3.0], delay=[[1e-3], [2e-3], [3e-3]])
    assert jx.margins(corners).sensitivity_peak.max() <= 1.6 * (1.0 + 1e-6)


def test_ranges_without_a_width_leave_the_loop_alone(tuned):
    """What they give applies to a joint that was given none of it."""
    known = {"mass": (0.7, 0.7), "delay": (1e-3, 1e-3)}
    bare = jx.joint(kp=400, kd=20, actuator="starleth")
    best = jx.tune(bare, max_peak=1.6, uncertainty=known)
    assert (best.loop.mass, best.loop.delay) == (0.7, 1e-3)
    assert best.verdict == tuned.verdict and best.certificate == tuned.certificate
    assert (best.kp, best.kd) == (tuned.kp, tuned.kd)
    assert best.members.names == tuned.members.names
    with pytest.raises(UserError, match="`risk` mean: is over loops, and this is one"):
        jx.tune(bare, max_peak=1.6, uncertainty=known, risk="mean")


def test_tuning_cannot_be_traced(loop):
    with pytest.raises(TypeError, match="cannot be traced"):
        jax.grad(lambda mass: jx.tune(loop.replace(mass=mass)).kp)(0.7)
