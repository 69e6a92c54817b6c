"""The experiment on the quadruped: its gains, its critical gain scales, and that it runs."""

import dataclasses
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from experiment_modules import imported
from quickly import compiled_quickly as compiled_quickly

from jaxact.loops import robots
from jaxact.plants import linearize

ROOT = Path(__file__).resolve().parent.parent
FOLDER = ROOT / "experiments" / "quadruped"
with imported(FOLDER, "critical") as modules:
    (critical,) = modules


@pytest.fixture(scope="module")
def experiment():
    """Its modules `cases` and `gains`."""
    with imported(FOLDER, "cases", "gains", "run") as modules:
        yield modules[:2]


def _radius(linear, kp, kd):
    """Spectral radius of the bare robot over a physics step, PD at every step."""
    A, B = np.asarray(linear.A), np.asarray(linear.B)
    positions, velocities = np.asarray(linear.positions), np.asarray(linear.velocities)
    gains = np.asarray(kp)[:, None] * positions + np.asarray(kd)[:, None] * velocities
    return np.max(np.abs(np.linalg.eigvals(A - B @ gains)))


@pytest.mark.parametrize("situation", ["stand", "three"])
def test_a_posture_that_stands_is_left_as_it_is(experiment, situation):
    """On its way through a sag the robot on three feet would topple."""
    cases, _ = experiment
    scene = robots.scene(cases.load(situation).plant)
    np.testing.assert_array_equal(scene.posture.qpos, scene.robot.qpos)
    assert scene.posture.residual < 1e-6 and scene.posture.settled


@pytest.fixture(scope="module")
def toppling(experiment):
    """Stiffness below which the robot topples in each situation, by bisection on A - B K."""
    cases, _ = experiment
    found = {}
    for situation in ("stand", "three"):
        scene = robots.scene(cases.load(situation).plant)
        linear = linearize.linear_c(scene.robot, scene.posture, 0.001).plant
        low, high = 100.0, 1000.0
        while high / low > 1.0001:
            middle = np.sqrt(low * high)
            stands = _radius(linear, np.full(12, middle), np.full(12, 12.0)) < 1.0
            low, high = (low, middle) if stands else (middle, high)
        found[situation] = high
    return found


def test_the_specifications_hold_the_gains_of_the_rule(experiment, toppling):
    cases, gains = experiment
    situations = {name: cases.load(name) for name in cases.SITUATIONS}
    least = dict(zip(gains.KINDS, gains._inertias(situations), strict=True))
    kp = gains.RESERVE * max(toppling.values())
    bandwidth = 2.0 * gains.DAMPING * np.sqrt(kp / min(least.values()))
    kd = {kind: bandwidth * own for kind, own in least.items()}
    rule = gains.Nominal(kp, kd, toppling, least)
    assert rule.bandwidth == pytest.approx(bandwidth)
    assert not any(gains.differs(one, rule) for one in situations.values())
    doubled = dataclasses.replace(rule, kp=2.0 * kp)
    assert all(gains.differs(one, doubled) for one in situations.values())


@pytest.mark.exhaustive
def test_the_growth_rate_finds_the_same_toppling_stiffness(experiment, toppling):
    cases, gains = experiment
    assert gains.toppling_stiffness(cases.load("three")) == pytest.approx(
        toppling["three"], rel=2e-3
    )


def test_the_nominal_gains_are_well_damped_and_bear_tripling_without_a_drive(experiment):
    cases, _ = experiment
    for situation in cases.SITUATIONS:
        one = cases.load(situation)
        scene = robots.scene(one.plant)
        linear = linearize.linear_c(scene.robot, scene.posture, 0.001).plant
        kd = np.array([one.parameters[f"kd@.*_{joint[3:]}"] for joint in scene.labels])
        kp = np.full(12, one.parameters["kp"])
        assert _radius(linear, kp, kd) < 1.0
        assert _radius(linear, 3.0 * kp, 3.0 * kd) < 1.0


@pytest.mark.exhaustive
def test_linear_and_nonlinear_critical_gain_scales_agree(experiment):
    """Within 5 % for three drive models, by two independent ways."""
    cases, _ = experiment
    smooth = cases.smooth(cases.load("hang"), duration=0.8)
    every = cases.drives(bare=False)
    columns = every.columns()
    linear = critical.edge(
        lambda columns: critical.growth_rates(smooth, columns) < 0.0, columns, 6.0, 0.3
    )
    finite = np.flatnonzero(np.isfinite(linear))
    assert finite.size >= 3
    own = {name: values[finite] for name, values in columns.items()}
    rollouts = critical.edge(
        lambda columns: critical.die_out(smooth, columns), own, 5.0, 0.35, points=6
    )
    close = np.abs(rollouts / linear[finite] - 1.0) < 0.05
    assert np.count_nonzero(close) >= 3, (linear[finite], rollouts)


@pytest.mark.exhaustive
def test_a_small_part_of_it_runs(experiment, tmp_path, monkeypatch, capfd):
    """In this process, where its programs have been compiled already."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["run.py", "--quick", "--out", "made"])
    assert sys.modules["run"].main() == 0
    assert capfd.readouterr().err == "" and os.listdir(tmp_path) == ["made"]
    assert sorted(os.listdir(tmp_path / "made")) == [
        "README.md", "numbers.json", "stability_map.png", "traces.png",
    ]  # fmt: skip
    numbers = json.loads((tmp_path / "made" / "numbers.json").read_text())
    assert numbers["gains"]["toppling"].keys() == numbers["situations"].keys() == {"three"}
    bare, *driven = numbers["situations"]["three"]["cases"]
    assert bare["bare"] and len(driven) == 9
    rates = {(one["actuator"], one["delay"]): one["growth_rates"] for one in driven}
    # what the study found: bare and nominal are stable, tripled with HyQ's drive is not
    assert max(bare["growth_rates"]) < 0.0
    assert rates["hyq", 0.001][0] < 0.0 < rates["hyq", 0.001][1]
    page = (tmp_path / "made" / "README.md").read_text()
    assert "| HyQ | 1 ms |" in page and "nan" not in page
