"""Settling and tracking, against simulations of our own by SciPy's matrix exponentials."""

from dataclasses import replace

import jax
import numpy as np
import pytest
import scipy.linalg
from quickly import compiled_quickly as compiled_quickly

import jaxact as jx
from jaxact.errors import UserError
from jaxact.tuning.certificate import Metrics, certify, sentence
from jaxact.tuning.goal import Goal
from jaxact.tuning.joint import standstill
from jaxact.tuning.joint.ensemble import PLANT, Sampling, ensemble
from jaxact.tuning.joint.problem import Case, log_bounds
from jaxact.tuning.joint.response import step_responses, timed
from jaxact.tuning.joint.search import front, tune
from jaxact.tuning.polish import Polished

SETTLING = Goal(objective="settling")
# Overshoots, and comes back out of the band by very little: settles late.
GRAZING = (184.56038035911513, 17.122111838433533)


def _held(kp, kd, plant, period, setpoints, start=0.0, closely=1):
    """Positions of a loop under held commands, so many in a period.

    plant: m, wn, zeta, delay, c, k
    """
    m, wn, zeta, delay, c, k = plant
    rate = np.zeros((5, 5))
    rate[0, 1], rate[2, 3] = 1.0, 1.0
    rate[1, :3] = -k / m, -c / m, 1.0 / m
    rate[3, 2:] = -(wn**2), -2.0 * zeta * wn, wn**2
    whole = int(np.floor(delay / period + 1e-9))
    part = delay - whole * period
    looked = [period * place / closely for place in range(1, closely)]
    stops = sorted({part, period, *looked})
    steps = [scipy.linalg.expm(rate * t) for t in np.diff([0.0, *stops])]
    x, commands, path = np.zeros(4), [0.0] * (whole + 2), []
    x[0] = start
    for setpoint in setpoints:
        path.append(x[0])
        commands = [kp * (setpoint - x[0]) - kd * x[1], *commands[:-1]]
        for stop, step in zip(stops, steps, strict=True):
            x = step[:4, :4] @ x + step[:4, 4] * commands[whole + (stop <= part)]
            path += [x[0]] if stop in looked else []
    return np.array(path)


def _settled(kp, kd, plant, period, duration, closely=1):
    """When a step response comes within 2 % for good [s]."""
    setpoints = np.ones(int(duration / period))
    off = np.abs(_held(kp, kd, plant, period, setpoints, closely=closely) - 1.0)
    last = np.flatnonzero(off > 0.02)[-1]
    assert last < 0.9 * len(off)
    return period / closely * (last + (off[last] - 0.02) / (off[last] - off[last + 1]))


def _time(members, kp, kd, goal=SETTLING, use="report"):
    how = timed(goal, [members], use=use)
    with jax.enable_x64(True):
        plant = np.stack([getattr(members, name) for name in PLANT])
        found = jax.jit(how.of_loops)(np.full(1, kp), np.full(1, kd), plant)
    return float(found[0])


@pytest.mark.parametrize("joint", [(0.0, 0.0), (2.0, 3.0)])
def test_the_continuous_time_is_that_of_ever_shorter_periods(joint):
    """A hold at 1 kHz would make it 0.179 s."""
    plant = (0.7, 110.0, 0.9, 1e-3, *joint)
    expected = _settled(*GRAZING, plant, 5e-5, 0.6)
    assert _time(ensemble(*plant), *GRAZING) == pytest.approx(expected, rel=2e-3)
    assert joint[0] or expected == pytest.approx(0.2436, abs=3e-4)


@pytest.mark.parametrize("use", ["polish", "report"])
def test_of_a_loop_without_delay_it_is_the_matrix_exponential(use):
    kp, kd, mass, wn, zeta, cutoff = 0.06, 0.31, 0.7, 2.0, 1.0, 30.0
    members = ensemble(mass, wn, zeta, 0.0, sampling=Sampling(velocity_filter=cutoff))
    rate = np.zeros((6, 6))
    rate[0, 1], rate[1, 2], rate[2, 3] = 1.0, 1.0 / mass, 1.0
    rate[3] = wn**2 * np.array([-kp, 0.0, -1.0, -2.0 * zeta / wn, -kd, kp])
    rate[4, 1], rate[4, 4] = cutoff, -cutoff
    step, x, path = scipy.linalg.expm(rate * 0.005), np.eye(6)[5], []
    for _ in range(12_000):
        path.append(x[0] - 1.0)
        x = step @ x
    band = timed(SETTLING, [members], use=use).band
    last = np.flatnonzero(np.abs(path) > band)[-1]
    assert _time(members, kp, kd, use=use) == pytest.approx(0.005 * last, rel=2e-3)


def test_of_many_control_periods_the_search_sees_the_loop_in_continuous_time():
    plant = (0.7, 110.0, 0.9, 1e-3, 0.0, 0.0)
    expected = _settled(100.0, 12.0, plant, 4e-4, 1.2, closely=4)
    members = ensemble(*plant, sampling=Sampling(4e-4))
    assert timed(SETTLING, [members]).options is not None
    assert timed(SETTLING, [members], use="descent").options is None
    assert _time(members, 100.0, 12.0) == pytest.approx(expected, rel=1e-7)
    assert expected < _time(members, 100.0, 12.0, use="polish") < 1.005 * expected


def test_a_response_that_leaves_the_band_between_the_ticks_has_not_settled():
    """At the ticks it overshoots by 1.99 %, between them by 2.04 %."""
    plant, period = (0.7, 800.0, 0.45, 2e-3, 0.0, 0.0), 2e-3
    gains = 6108.25, 97.356
    expected = _settled(*gains, plant, period, 0.3, closely=60)
    assert expected > 1.2 * _settled(*gains, plant, period, 0.3)
    found = _time(ensemble(*plant, sampling=Sampling(period)), *gains)
    assert found == pytest.approx(expected, rel=1e-3)


def test_a_loop_that_does_not_settle_has_no_time_and_no_certificate():
    members = ensemble(0.7, 2.0, 1.0, 0.0)
    how = timed(SETTLING, [members])
    # It takes a thousand seconds.
    assert np.isnan(_time(members, 4.19e-4, 0.112))
    log = dict.fromkeys(("sensitivity_peak", "complementary_peak"), np.zeros(1))
    known = Metrics(np.ones(1, bool), log | {how.metric: np.full(1, np.nan)})
    certificate = certify(SETTLING, members, known, 4.19e-4)
    assert not certificate.met and certificate.stable
    assert sentence(certificate, SETTLING).startswith("found infeasible: no gains that keep the")


@pytest.mark.exhaustive
def test_what_is_left_at_the_end_leads_to_gains_that_settle():
    how = timed(SETTLING, [ensemble(0.7, 2.0, 1.0, 0.0)], use="descent")
    plant = np.array([0.7, 2.0, 1.0, 0.0], np.float32)

    def smooth(x):
        return how.smooth(jax.numpy.exp(x), 0.3, plant, 50.0)

    for kp in (1e-5, 1e-4, 1e-3):
        assert jax.grad(smooth)(jax.numpy.log(kp)) < -1e-3


def test_the_whole_file_is_tracked(tmp_path):
    """Of two seconds, at first at rest, with an actuator of which 4000 steps were 0.4 s."""
    plant = (0.7, 800.0, 0.45, 0.0, 0.0, 0.0)
    period = 2e-3
    reference = 0.1 * np.sin(2 * np.pi * np.maximum(period * np.arange(1001) - 1.0, 0.0))
    goal = Goal(objective="tracking", reference=tuple(reference), reference_period=period)
    fine = np.interp(1e-4 * np.arange(20_000), period * np.arange(1001), reference)
    path = _held(20_000.0, 134.0, plant, 1e-4, fine)
    expected = np.sqrt(np.mean((path - fine) ** 2))
    for use in ("descent", "report"):
        found = _time(ensemble(*plant), 20_000.0, 134.0, goal, use)
        # Of a hold at 10 kHz itself some is left.
        assert found == pytest.approx(expected, rel=0.01)


def test_what_cannot_be_simulated_is_said_in_one_line():
    fast = ensemble(0.7, 110.0, 0.9, 1e-3, sampling=Sampling(1e-6))
    with pytest.raises(UserError, match="s have to be simulated, .* periods, and 200,000 can"):
        timed(SETTLING, [fast])
    long = Goal(objective="tracking", reference=(0.0, 1.0, 0.0), reference_period=1000.0)
    assert timed(long, [ensemble(0.7, 110.0, 0.9, 1e-3)]).ticks >= 6
    goal = Goal(objective="tracking", reference=(0.0, 1.0) * 50_000, reference_period=0.1)
    with pytest.raises(UserError, match="of setpoints are .* lags of the loop, and 13,333 can"):
        timed(goal, [ensemble(0.7, 800.0, 0.45, 0.0)])


def test_step_responses_in_continuous_time_begin_with_the_step():
    plant = (0.7, 110.0, 0.9, 1e-2, 0.0, 0.0)
    time, rows = step_responses(ensemble(*plant), 60.0, 9.0, 0.5)
    expected = _held(60.0, 9.0, (0.7, 110.0, 0.9, 1e-2 - 5e-5, 0.0, 0.0), 1e-4, np.ones(5000))
    own = np.interp(time, 1e-4 * np.arange(5000), expected)
    assert time[0] == 0.0 and np.abs(rows[0] - own).max() < 2e-3


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("plant", "sampling", "bounds", "most", "kd"),
    [
        ((0.7, 2.0, 1.0, 0.0), Sampling(), {}, 9.97, (0.2, 0.4)),
        ((0.7, 110.0, 0.9, 0.0), Sampling(5e-5), {"max_kp": 30.0}, 0.582, (6.0, 9.0)),
    ],
)
def test_settling_is_the_shortest_of_a_grid(plant, sampling, bounds, most, kd):
    """The best of a brute grid with code of its own: 9.96 s and 0.581 s."""
    tuned = tune(ensemble(*plant, sampling=sampling), Goal(objective="settling", **bounds))
    assert tuned.certified and tuned.value <= most and kd[0] < tuned.kd < kd[1]
    period = sampling.control_period or 0.002
    own = _settled(tuned.kp, tuned.kd, (*plant, 0.0, 0.0), period, 3.0 * tuned.value)
    assert tuned.value == pytest.approx(own, rel=0.01)


@pytest.mark.exhaustive
def test_of_a_spring_that_holds_back_it_is_said_that_nothing_settles():
    loop = jx.joint(
        mass=0.7, actuator="starleth", delay=1e-3, joint_stiffness=2000.0, joint_damping=5.0
    )
    best = jx.tune(loop, "settling", max_peak=1.3, max_kp=100.0)
    assert not best.certified and "settles within 2 %" in best.verdict


@pytest.mark.parametrize(
    ("risk", "said"),
    [
        ("worst", "holds for all 8 members, computed"),
        ("mean", "holds for the mean of the 8 members, which are all stable, computed"),
        ("cvar:0.75", "for the mean of the worst 25 % of the 8 members, which are all stable,"),
    ],
)
def test_it_is_said_of_which_members_a_constraint_holds(risk, said):
    goal = Goal(max_peak=1.6, risk=risk)
    members = ensemble(np.full(8, 0.7), 110.0, 0.9, 1e-3)
    log = dict.fromkeys(("sensitivity_peak", "complementary_peak"), np.log(np.full(8, 1.5)))
    certificate = certify(goal, members, Metrics(np.ones(8, bool), log), 100.0)
    assert certificate.met and said in sentence(certificate, goal)


@pytest.mark.parametrize(
    ("text", "said"),
    [("", "write at least two lines of time"), ("0,1\n1,1\n2,1\n", "the setpoint never moves")],
)
def test_a_file_that_says_nothing_is_refused_in_one_line(tmp_path, text, said):
    path = tmp_path / "setpoints.csv"
    path.write_text(text)
    with pytest.raises(UserError, match=said):
        jx.tune(jx.joint(actuator="starleth"), f"tracking:{path}")
    with pytest.raises(UserError, match="needs a file of setpoints"):
        jx.tune(jx.joint(actuator="starleth"), "tracking:")


SINE = tuple(0.05 * np.sin(2.0 * np.pi * 2.0 * 0.01 * np.arange(101)))
TRACKING = Goal(objective="tracking", reference=SINE, reference_period=0.01)
SLOW = ensemble(0.7, 110.0, 0.9, 1.9e-3, sampling=Sampling(2.5e-3))


@pytest.mark.exhaustive
def test_a_search_does_not_end_where_the_joint_stands_still():
    """From hardly any gains, at which the error has no slope, to those that track."""
    case = Case(SLOW, replace(TRACKING, max_peak=3.0))
    how = timed(case.goal, [SLOW], use="polish")
    nothing = np.log([[1e-6, 20.0]])
    still = -np.log(_time(SLOW, *np.exp(nothing[0]), case.goal, "polish"))
    known = Polished(nothing, np.array([still]), np.zeros(1), 1)
    assert standstill.stands_still(case.goal, np.exp(-still))
    found, tried = standstill.moved([case], known, log_bounds(case.goal)[None], how)
    assert tried > 100 and found.feasible[0] and found.value[0] > still + 0.3
    # As the whole search finds it.
    best = tune(SLOW, case.goal)
    assert found.value[0] == pytest.approx(-np.log(best.value), abs=1e-3)
    assert not best.certificate.notes


@pytest.mark.exhaustive
def test_along_a_front_a_looser_bound_is_never_worse():
    points = front(SLOW, TRACKING, 3)
    values = [point.value for point in points]
    assert all(point.certified for point in points)
    assert all(later <= earlier for earlier, later in zip(values[:-1], values[1:], strict=True))
    notes = [standstill.NOTE in point.certificate.notes for point in points]
    assert notes == [standstill.stands_still(TRACKING, value) for value in values]
    assert notes[0] and not notes[-1]
