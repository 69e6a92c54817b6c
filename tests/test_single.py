"""A single loop with its trajectory: against scipy, and against the figures of the same rollout."""

import dataclasses

import numpy as np
import pytest
from quickly import compiled_quickly as compiled_quickly
from synthetic_store import radius

from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.simulation import execute, single

BASE = """
precision = "float64"
duration = 0.4
[parameters]
actuator = "starleth"
delay = 0.0042
control_rate = 500
[axes]
feedforward = [0.0]
"""


def _specification(text=BASE):
    return reading.parse(text)


@pytest.mark.exhaustive
def test_trajectory_agrees_with_its_figures():
    run = single.simulate(_specification())
    path = run.trajectory
    assert path.time.shape == (200,) and path.position.shape == (200, 1)
    assert run.rotary == (False,)
    error = np.trapezoid(np.abs(path.setpoint - path.position)[:, 0], dx=1.0 / 500.0)
    assert error == pytest.approx(run.results["integrated_absolute_error"], rel=1e-2)
    assert path.position.max() / 0.1 - 1.0 == pytest.approx(run.results["overshoot"], rel=1e-9)
    effort = (path.command**2).sum() / 500.0
    assert effort == pytest.approx(run.results["control_effort"], rel=1e-9)


SWEPT = {
    "noise at rates of which one takes longer": (
        BASE.replace("delay", "position_noise = 1e-4\ndelay"),
        "feedforward = [0.0]",
        "control_rate = [500, 310]",
    ),
    "a mass whose gains are too high": (BASE, "feedforward = [0.0]", "kp = [300, 9000]"),
}


@pytest.mark.exhaustive
@pytest.mark.parametrize("case", SWEPT)
def test_figures_are_those_of_a_sweep(case):
    """Kept rows, taken in at the end, against what a sweep takes in on the way."""
    text, old, new = SWEPT[case]
    asked = dataclasses.replace(_specification(text.replace(old, new)), engine="mass")
    samples = expand(asked)
    want = execute.run(asked, samples)
    for number, run in enumerate(single.simulate_all(asked, samples)):
        for name, array in want.items():
            np.testing.assert_allclose(run.results[name], array[number], rtol=1e-7, err_msg=name)
    assert len({float(rate) for rate in want["growth_rate"]}) == 2


@pytest.mark.exhaustive
def test_growth_rate_is_that_of_the_exact_matrix():
    specification = _specification()
    values = {name: np.array([value]) for name, value in specification.nominal.items()}
    run = single.simulate(specification)
    assert run.results["growth_rate"] == pytest.approx(np.log(radius(values, 0)) * 500.0, rel=1e-4)


@pytest.mark.exhaustive
def test_command_is_delayed_by_the_delay():
    path = single.simulate(_specification()).trajectory
    command, delayed = path.command[:, 0], path.delayed_command[:, 0]
    # 4.2 ms are two periods of 2 ms and a tenth: a tenth of the mean over a step is older
    np.testing.assert_allclose(delayed[3:], 0.9 * command[1:-2] + 0.1 * command[:-3], rtol=1e-9)


@pytest.mark.exhaustive
def test_several_loops_are_what_each_of_them_is_alone():
    text = BASE.replace("feedforward = [0.0]", "kp = [200.0, 400.0]\nkd = [10.0, 20.0]")
    specification = _specification(text)
    runs = single.simulate_all(specification, expand(specification))
    alone = single.simulate(_specification())
    np.testing.assert_allclose(
        runs[3].trajectory.position, alone.trajectory.position, rtol=1e-9, atol=1e-12
    )
    assert [run.values["kp"] for run in runs] == [200.0, 200.0, 400.0, 400.0]


@pytest.mark.exhaustive
def test_noise_depends_on_the_seed_only():
    noisy = BASE.replace("delay", "position_noise = 1e-3\ndelay")
    first, again = (single.simulate(_specification(noisy)) for _ in range(2))
    other = single.simulate(_specification("seed = 1\n" + noisy))
    np.testing.assert_array_equal(first.trajectory.command, again.trajectory.command)
    assert not np.array_equal(first.trajectory.command, other.trajectory.command)


def test_too_long_to_keep():
    with pytest.raises(UserError, match="can be kept"):
        single.simulate(_specification(BASE.replace("0.4", "20000.0")))
