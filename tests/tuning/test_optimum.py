"""Tuned gains against optima found by brute force, with other code and another method."""

import json
from pathlib import Path

import brute_force
import numpy as np
import pytest
from loops import largest_peaks
from quickly import optimised_little

from jaxact.tuning.goal import Goal
from jaxact.tuning.joint.ensemble import PLANT, Ensemble, ensemble
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.joint.search import tune_all

DATA = Path(__file__).parent.parent / "data"
ORACLE = json.loads((DATA / "tuner_optima.json").read_text())["cases"]
STORED = json.loads((DATA / "tuner_random.json").read_text())


def _largest_peaks(results):
    """max(Ms, Mt) over the members of every case, straight from the margins."""
    rows = [np.stack([getattr(t.members, name) for t in results]) for name in PLANT]
    gains = [np.array([getattr(t, name) for t in results])[:, None] for name in ("kp", "kd")]
    *rows, kp, kd = (row.ravel() for row in np.broadcast_arrays(*rows, *gains))
    peaks = largest_peaks(Ensemble(*rows), kp, kd)
    return peaks.reshape(len(results), -1).max(axis=1)


def _bounds(results):
    return np.array([tuned.goal.max_peak for tuned in results])


@pytest.fixture(scope="module")
def oracle():
    cases = [
        Case(
            ensemble(c["mass"], c["natural_frequency"], c["damping_ratio"], c["delay"]),
            Goal(max_peak=c["max_peak"]),
        )
        for c in ORACLE
    ]
    with optimised_little():
        return tune_all(cases)


@pytest.fixture(scope="module")
def plants():
    members, peaks = brute_force.random_members(100, 7)
    cases = [
        Case(ensemble(*row), Goal(max_peak=float(peak)))
        for row, peak in zip(members, peaks, strict=True)
    ]
    return tune_all(cases)


@pytest.fixture(scope="module")
def ensembles():
    members, peaks = brute_force.random_ensembles(20, 32, 11)
    cases = [
        Case(ensemble(*rows.T), Goal(max_peak=float(peak)))
        for rows, peak in zip(members, peaks, strict=True)
    ]
    return tune_all(cases)


@pytest.mark.parametrize("number", range(len(ORACLE)))
def test_the_oracles_optima_are_reached(oracle, number):
    tuned, case = oracle[number], ORACLE[number]
    assert tuned.kp == pytest.approx(case["kp"], rel=1e-3)
    assert tuned.certified and tuned.feasible


@pytest.mark.exhaustive
def test_the_oracles_constraints_are_met_to_rounding(oracle):
    assert np.all(_largest_peaks(oracle) <= _bounds(oracle) * (1.0 + 1e-9))


def test_it_takes_a_hundredth_of_the_evaluations_of_brute_force(oracle):
    case = ORACLE[0]
    row = [case[n] for n in ("mass", "natural_frequency", "damping_ratio", "delay")]
    *_, refined = brute_force.stiffest(row, case["max_peak"])
    # One grid over the same range, as fine as 0.1 % in both gains.
    whole = np.log(1.5 / 2e-4) * np.log(1.6 / 2e-2) / 1e-3**2
    assert refined > 10_000
    assert max(t.evaluations for t in oracle) < whole / 100


@pytest.mark.exhaustive
def test_random_plants_are_within_half_a_percent_of_brute_force(plants):
    best = np.array([kp for kp, _ in STORED["plants"]])
    ratio = np.array([tuned.kp for tuned in plants]) / best
    assert np.sum(ratio > 0.995) >= 99
    assert np.all(ratio < 1.01), "brute force missed an optimum by more than its grid"
    assert all(tuned.certified for tuned in plants)
    assert np.all(_largest_peaks(plants) <= _bounds(plants) * (1.0 + 1e-9))


@pytest.mark.parametrize("number", [3, 58])
def test_the_stored_optima_are_those_of_brute_force(number):
    members, peaks = brute_force.random_members(100, 7)
    kp, kd, _ = brute_force.stiffest(members[number], peaks[number])
    assert (kp, kd) == pytest.approx(STORED["plants"][number], rel=1e-6)


@pytest.mark.exhaustive
def test_ensembles_are_within_a_percent_of_brute_force(ensembles):
    best = np.array([kp for kp, _ in STORED["ensembles"]])
    ratio = np.array([tuned.kp for tuned in ensembles]) / best
    assert ratio.min() > 0.99
    assert all(tuned.certified and tuned.certificate.binding for tuned in ensembles)
    assert np.all(_largest_peaks(ensembles) <= _bounds(ensembles) * (1.0 + 1e-9))


@pytest.mark.exhaustive
def test_no_gains_near_an_ensembles_optimum_are_stiffer(ensembles):
    tuned = ensembles[4]
    rows = np.stack([getattr(tuned.members, name) for name in PLANT], axis=1)
    kp, kd = np.meshgrid(tuned.kp * np.array([1.01, 1.1, 1.3]), tuned.kd * np.geomspace(0.5, 2, 25))
    worst = brute_force.log_peaks(rows, kp.ravel(), kd.ravel())
    assert worst.min() > np.log(tuned.goal.max_peak)


def test_scaling_a_joint_scales_its_gains(oracle):
    """Ten times the mass and half the speed: kp by 10/4, kd by 10/2."""
    cases = [
        Case(
            ensemble(
                10 * c["mass"], c["natural_frequency"] / 2, c["damping_ratio"], 2 * c["delay"]
            ),
            Goal(max_peak=c["max_peak"]),
        )
        for c in ORACLE
    ]
    for scaled, own in zip(tune_all(cases), oracle, strict=True):
        assert scaled.kp == pytest.approx(2.5 * own.kp, rel=1e-5)
        assert scaled.kd == pytest.approx(5.0 * own.kd, rel=3e-3)
