"""Loops of different control rates in one sweep: each is simulated for the duration, no longer."""

import numpy as np
import pytest

from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops.samples import expand, explicit
from jaxact.simulation import execute, plans, single
from jaxact.simulation.metrics import SETTLED
from jaxact.status import Verdict

_TEXT = """
engine = "mass"
duration = 0.5
precision = "float64"
[parameters]
{parameters}
[axes]
kp = [200, 400]
control_rate = {rates}
"""
# Half a second of 88.8 Hz is 44.4 periods, and 48 in whole segments.
_RATES = np.array([88.8, 100, 128, 160, 200, 256, 320, 400, 500, 640, 800, 1000])


def _asked(rates, parameters='actuator = "hyq"'):
    return reading.parse(_TEXT.format(rates=rates, parameters=parameters))


def _groups(rates, **how):
    asked = _asked(rates)
    return plans.groups(asked, expand(asked), **how)


@pytest.mark.parametrize(
    ("rates", "refined"),
    [
        ("[100, 1000]", False),
        (_RATES.tolist(), False),
        ("{ min = 100, max = 1000, num = 3 }", True),  # not all known beforehand
    ],
)
def test_control_rates_share_a_kernel(rates, refined):
    (plan,) = _groups(rates, refined=refined)
    assert plan.rates is None and plan.case.rollout.ticks == 500 and plan.case.rollout.several


def test_one_control_rate_has_a_kernel_without_ticks_of_its_own():
    (plan,) = _groups("[100]")
    # 0.5 s are 50 control periods, which are rounded up to four equal parts
    assert plan.case.rollout.ticks == 52 and not plan.case.rollout.several


def test_trajectories_of_different_control_rates_are_apart():
    groups = _groups("[100, 400, 1000]", alone=True)
    assert [plan.case.rollout.ticks for plan in groups] == [52, 200, 500]
    assert [plan.rates.tolist() for plan in groups] == [[100.0], [400.0], [1000.0]]
    assert not any(plan.case.rollout.several for plan in groups)


def test_rates_whose_loops_have_other_physics_steps_are_not_refined():
    limited = 'actuator = "hyq"\nforce_limit = 20'
    asked = _asked("{ min = 100, max = 1000, num = 3 }", limited)
    with pytest.raises(UserError, match="give `control_rate` as a list"):
        plans.groups(asked, expand(asked), refined=True)


def _by_hand(kp, kd, rate, mass, duration):
    """Metrics of a step of a mass whose force is the command, and held for a control period."""
    period, ticks = 1.0 / rate, 4 * int(np.ceil(duration * rate / 4 - 1e-9))
    q = v = 0.0
    positions, forces = [q], []
    for _ in range(ticks):
        force = kp * (1.0 - q) - kd * v
        q += v * period + 0.5 * force / mass * period**2
        v += force / mass * period
        positions.append(q)
        forces.append(force)
    y, forces = np.array(positions), np.array(forces)
    outside = np.flatnonzero(np.abs(y[1:] - 1.0) > SETTLED)
    counted = int(np.ceil(duration * rate - 1e-4))
    error = np.abs(y - 1.0)
    return {
        "overshoot": max(y.max() - 1.0, 0.0),
        "settling_time": (outside[-1] + 2.0) * period if outside[-1] + 1 < ticks else np.nan,
        "peak_force": np.abs(forces).max(),
        "control_effort": period * np.sum(np.square(forces[:counted])),
        "integrated_absolute_error": period * np.sum(0.5 * (error[:-1] + error[1:])[:counted]),
    }


def test_metrics_of_many_control_rates_are_those_of_the_duration():
    mass, duration, rates = 2.0, 0.5, np.repeat(_RATES, 4)
    kp = np.tile([100.0, 400.0, 900.0, 1600.0], _RATES.size)
    kd = np.tile([25.0, 20.0, 60.0, 420.0], _RATES.size)
    asked = _asked("[100]", f'actuator = "ideal"\nmass = {mass}\nsetpoint = 1.0')
    samples = explicit(asked, {"kp": kp, "kd": kd, "control_rate": rates})
    (plan,) = plans.groups(asked, samples)
    assert plan.case.rollout.several
    found = execute.run(asked, samples)
    stable = found["verdict"] == Verdict.STABLE
    assert 20 < stable.sum() < stable.size
    for number in range(rates.size):
        want = _by_hand(kp[number], kd[number], rates[number], mass, duration)
        for name, value in want.items():
            got = found[name][number]
            if name == "settling_time" and np.isnan(got) and stable[number]:
                # within the band at the end, but on its way through it, or not settled at all
                assert np.isnan(value) or value > 0.6 * duration
                continue
            np.testing.assert_allclose(got, value, rtol=1e-9, atol=1e-12, err_msg=name)


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    "parameters",
    [
        "position_resolution = 0.001\nvelocity_resolution = 0.0001",
        "position_noise = 0.001\ndelay = 0.0113",
        "force_limit = 20.0",
    ],
)
def test_a_loop_has_the_verdict_and_metrics_that_it_has_alone(parameters):
    rng = np.random.default_rng(0)
    rates = np.repeat(_RATES, 5)
    kp = np.exp(rng.uniform(np.log(50.0), np.log(3e4), rates.size))
    columns = {"kp": kp, "kd": rng.uniform(5.0, 60.0, rates.size), "control_rate": rates}
    asked = _asked("[100]", f'actuator = "hyq"\n{parameters}')
    together = execute.run(asked, explicit(asked, columns))
    assert np.unique(together["verdict"]).size > 1
    for number in range(0, rates.size, 13):
        own = {name: column[number : number + 1] for name, column in columns.items()}
        alone = execute.run(asked, explicit(asked, own, first=number))
        for name, (value,) in alone.items():
            np.testing.assert_allclose(together[name][number], value, rtol=1e-9, err_msg=name)


@pytest.mark.exhaustive
def test_trajectories_of_different_control_rates_have_the_metrics_of_a_sweep():
    asked = _asked("[100]")
    columns = {"kp": np.full(3, 300.0), "control_rate": _RATES[:3]}
    samples = explicit(asked, columns)
    found = single.simulate_all(asked, samples)
    swept = execute.run(asked, samples)
    for number, one in enumerate(found):
        assert one.trajectory.time[-1] < 0.5 + 4.0 / columns["control_rate"][number]
        for name in ("overshoot", "peak_force", "verdict"):
            np.testing.assert_allclose(one.results[name], swept[name][number], rtol=1e-9)


def test_what_moves_on_has_no_metrics_of_a_step():
    rows = {name: np.ones(2, np.float32) for name in ("overshoot", "rise_time", "settling_time")}
    got = execute.without_step({**rows, "peak_force": np.ones(2)})
    assert all(np.isnan(got[name]).all() and got[name].dtype == np.float32 for name in rows)
    np.testing.assert_array_equal(got["peak_force"], 1.0)
