"""Loops of different control rates in one sweep: none is measured over more than the duration."""

import numpy as np
import pytest

from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.simulation import execute, longer_runs, plans
from jaxact.status import Verdict

_TEXT = """
engine = "mass"
duration = 0.5
[parameters]
actuator = "hyq"
[axes]
kp = [200, 400]
control_rate = {rates}
"""


def _groups(rates, **how):
    asked = reading.parse(_TEXT.format(rates=rates))
    return plans.groups(asked, expand(asked), **how)


def test_each_of_a_few_control_rates_runs_for_the_duration():
    groups = _groups("[100, 400, 1000]")
    # 0.5 s are 50, 200 and 500 control periods; 50 are rounded up to four equal parts
    assert [plan.case.rollout.ticks for plan in groups] == [52, 200, 500]
    assert [plan.rates.tolist() for plan in groups] == [[100.0], [400.0], [1000.0]]


@pytest.mark.parametrize(
    ("rates", "refined"),
    [
        (list(range(100, 1100, 100)), False),  # too many to compile a kernel for each
        ("{ min = 100, max = 1000, num = 3 }", True),  # not all known beforehand
    ],
)
def test_many_control_rates_share_a_kernel(rates, refined):
    (plan,) = _groups(rates, refined=refined)
    assert plan.rates is None and plan.case.rollout.ticks == 500


def test_which_samples_run_longer():
    rates = np.array([100.0, 992.0, 993.0, 1000.0])
    # 0.5 s: 50 and 496 periods; 496.5 are rounded up to 500, as 500 are
    longer = longer_runs.ran_longer(rates, 0.5, 500)
    assert longer.tolist() == [True, True, False, False]
    assert not longer_runs.ran_longer(rates[3:], 0.5, 500).any()


def test_what_a_longer_run_tells_of_the_duration():
    rows = {
        "settling_time": np.array([0.4, 3.9, np.nan, 0.4, 0.4]),
        "rise_time": np.array([0.1, 2.2, 0.1, 0.1, 0.1]),
        "overshoot": np.array([0.3, 0.0, 3e9, 0.01, 0.3]),
        "peak_force": np.array([5.0, 6.0, 7.0, 8.0, 9.0]),
        "rms_force": np.ones(5),
        "verdict": np.full(5, Verdict.STABLE),
    }
    longer = np.array([True, True, True, True, False])
    got = longer_runs.within(rows, longer, 0.5, calm=True)
    nan = np.nan
    np.testing.assert_array_equal(got["settling_time"], [0.4, nan, nan, 0.4, 0.4])
    np.testing.assert_array_equal(got["rise_time"], [0.1, nan, nan, 0.1, 0.1])
    np.testing.assert_array_equal(got["overshoot"], [0.3, 0.0, nan, nan, 0.3])
    np.testing.assert_array_equal(got["peak_force"], [5.0, nan, nan, 8.0, 9.0])
    np.testing.assert_array_equal(got["rms_force"], rows["rms_force"])
    pushed = longer_runs.within(rows, longer, 0.5, calm=False)["peak_force"]
    np.testing.assert_array_equal(pushed, [nan, nan, nan, nan, 9.0])


def test_what_moves_on_has_no_metrics_of_a_step():
    rows = {name: np.ones(2, np.float32) for name in ("overshoot", "rise_time", "settling_time")}
    got = execute.without_step({**rows, "peak_force": np.ones(2)})
    assert all(np.isnan(got[name]).all() and got[name].dtype == np.float32 for name in rows)
    np.testing.assert_array_equal(got["peak_force"], 1.0)
