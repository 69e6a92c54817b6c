"""Searches that ended at a crease of the sum of squares go on beyond it."""

from pathlib import Path

import driven_joint
import jax
import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.signal import lfilter

import jaxact as jx
from jaxact.identification import motion, uncertainty
from jaxact.identification.fitting import Fit, at_a_tick, solve
from jaxact.identification.log import Log
from jaxact.identification.model import of_rung
from jaxact.identification.problem import Problem, Unknown
from jaxact.identification.settling import promised, settled

ROOT = Path(__file__).resolve().parents[2]
TRUTH = {"offset": 0.05, "inertia": 0.7, "viscous": 1.5, "coulomb": 0.8, "delay": 3.1e-3,
         "initial_position": 0.0, "initial_velocity": 0.0}  # fmt: skip
RATE, ROWS = 500.0, 2000


@pytest.fixture(scope="module")
def creased():
    """A log whose joint begins at rest: friction stops in a delay's time what noise makes of it."""
    generator = np.random.default_rng(2)
    setpoint = 0.1 * np.repeat(generator.choice([-1.0, 1.0], ROWS // 60 + 1), 60)[:ROWS]
    signals = {"setpoint": setpoint, "position": 0.0 * setpoint}
    time = np.arange(ROWS) / RATE
    clean = Log("synthetic", time, signals, unit="m", gains=(400.0, 20.0))
    with jax.enable_x64(True):
        family = motion.family([clean], "mass")
        moved = jax.jit(family.simulate)({**family.neutral, **TRUTH}, family.inputs(clean))
    noise = 1e-4 * lfilter([0.6], [1.0, -0.8], generator.normal(size=ROWS + 200))[200:]
    signals = {"setpoint": setpoint, "position": np.asarray(moved)[:ROWS] + noise}
    log = Log("synthetic", time, signals, unit="m", gains=(400.0, 20.0))
    with jax.enable_x64(True):
        family = motion.family([log], "mass")
        rung = next(r for r in family.rungs if r.name == "delay, viscous and dry")
        return of_rung(family, rung, [log])


@pytest.mark.exhaustive
def test_a_search_that_ended_at_a_crease_is_settled_to_where_no_slope_leads_down(creased):
    # What the noise leaves at the truth is an upper bound of the least sum of squares.
    fit = solve(creased)
    better = settled(fit)
    truth = {**TRUTH, **{f"{name}[0]": TRUTH[name] for name in TRUTH if "initial" in name}}
    point = np.array([u.inner(truth[u.name]) for u in creased.unknowns])
    assert promised(fit, uncertainty.robust(fit)) > 1.0
    assert promised(better, uncertainty.robust(better)) < 0.1
    rest, _ = creased.evaluate(point)
    assert better.square_sum < min(fit.square_sum, float(rest @ rest))


@pytest.mark.exhaustive
def test_a_search_that_arrived_is_left_as_it_is(creased):
    better = settled(solve(creased))
    assert settled(better) is better


@pytest.mark.exhaustive
def test_a_search_crosses_all_the_ticks_between_a_mere_delay_and_a_loop_with_less():
    """Lines between setpoints 20 ms apart: a mere delay of 10 ms, lag and all, is begun from."""
    rows = np.arange(4000)
    coarse = rows[::20]
    told = driven_joint.prbs(1, 60, len(rows))
    log = driven_joint.log(1, np.interp(rows, coarse, told[coarse]))
    with jax.enable_x64(True):
        family = motion.family([log], "mass")
        rungs = {rung.name: rung for rung in family.rungs}
        mere = solve(of_rung(family, rungs["delay, viscous"], [log]))
        assert mere.values["delay"] > 9e-3
        found = solve(of_rung(family, rungs["second order with delay, viscous"], [log]), near=mere)
    assert found.values["delay"] == pytest.approx(driven_joint.DELAY, abs=5e-5)
    assert found.values["wn"] == pytest.approx(driven_joint.WN, rel=0.01)
    assert found.values["zeta"] == pytest.approx(driven_joint.ZETA, abs=2e-3)


@pytest.mark.exhaustive
def test_a_delay_at_a_control_tick_is_not_a_crease():
    logs = ROOT / "experiments" / "identification"
    found = jx.identify(
        logs / "logs" / "ak80_fit.npz", validate=logs / "logs" / "ak80_validate.npz",
        columns=logs / "ak80.toml", joint="elbow",
    )  # fmt: skip
    fit = found.chosen.fit
    # One period of 500 Hz, a kink on either side of which the sum rises.
    assert at_a_tick(fit) and fit.values["delay"] == pytest.approx(2e-3, rel=1e-3)
    assert settled(fit) is fit


def _solved(slopes, residuals, most):
    """A fit in the middle of its unknowns' ranges, which reach `most` to either side."""
    unknowns = tuple(
        Unknown(f"x{at}", "1", -size, size, (0.0,)) for at, size in enumerate(most.tolist())
    )
    numbers = {unknown.name: 0.0 for unknown in unknowns}
    problem = Problem(unknowns, numbers, frozenset(), lambda values, rows: rows, (residuals,),
                      (residuals,), 1.0, None)  # fmt: skip
    return Fit(problem, np.zeros(len(most)), residuals, slopes, (), 1)


@pytest.mark.parametrize("seed", range(4))
def test_slopes_promise_what_a_linear_least_squares_within_the_ranges_reaches(seed):
    """Also where two unknowns do the same, and where one does next to nothing."""
    generator = np.random.default_rng(seed)
    slopes = generator.normal(size=(300, 5))
    slopes[:, 3] = -2.0 * slopes[:, 2]
    slopes[:, 4] *= 1e-12
    most = np.full(5, 100.0)
    rest = generator.normal(size=300)
    independent = slopes[:, [0, 1, 2, 4]]
    arrived = rest - independent @ np.linalg.lstsq(independent, rest, rcond=1e-9)[0]
    for residuals in (rest, arrived):
        fit = _solved(slopes, residuals, most)
        best = lsq_linear(independent, -residuals, (-most[:4], most[:4]))
        variance = fit.square_sum / (300 - 5)
        expected = (fit.square_sum - 2.0 * best.cost) / variance
        assert promised(fit, uncertainty.naive(fit)) == pytest.approx(expected, rel=1e-6, abs=1e-6)
    assert expected < 1e-6
