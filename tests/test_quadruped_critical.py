"""Critical gain scales: the search itself, and loops that are the same with and without a drive."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from experiment_modules import imported
from quickly import compiled_quickly as compiled_quickly

from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.simulation import plans, single, spectra
from jaxact.verbs.render import _runs, pair

FOLDER = Path(__file__).resolve().parent.parent / "experiments" / "quadruped"
with imported(FOLDER, "critical") as modules:
    (critical,) = modules

SPECIFICATION = """
engine = "mass"
duration = 0.2
velocity = "differenced"
[parameters]
kp = 300
actuator = "hyq"
delay = 0.002
position_noise = 1e-4
velocity_filter = 500
force_limit = 70
[axes]
kd = [10, 20]
"""


def _judge(low, high, asked):
    """Loops that are stable between two gain scales; keeps what it was asked."""

    def stable(columns):
        asked.append(columns["gain_scale"])
        places = columns["place"].astype(int)
        return (columns["gain_scale"] >= low[places]) & (columns["gain_scale"] <= high[places])

    return stable


@pytest.mark.parametrize("rounds", [1, 3])
def test_an_edge_is_found_from_either_side(rounds):
    low, high = np.array([0.5, 0.9, 0.1, 8.0]), np.array([2.0, 1.0, 9.0, 9.0])
    columns = {"place": np.arange(4)}
    asked = []
    stable = _judge(low, high, asked)
    upper = critical.edge(stable, columns, 6.0, 0.2, points=33, rounds=rounds)
    lower = critical.edge(stable, columns, 0.2, 6.0, points=33, rounds=rounds)
    close = (6.0 / 0.2) ** (0.5 / 32 / 34 ** (rounds - 1)) * (1 + 1e-12)
    assert np.all(np.abs(np.log(upper[:2] / high[:2])) <= np.log(close))
    assert np.all(np.abs(np.log(lower[:2] / low[:2])) <= np.log(close))
    assert upper[2] == np.inf and lower[2] == 0.0
    assert np.isnan(upper[3]) and np.isnan(lower[3])
    assert {scales.size for scales in asked} == {4 * 33}


def test_each_loop_may_have_a_way_of_its_own():
    stable = _judge(np.array([0.0, 0.0]), np.array([2.0, 3.0]), [])
    columns = {"place": np.arange(2)}
    found = critical.edge(stable, columns, np.array([4.0, 3.5]), np.array([1.0, 2.9]))
    np.testing.assert_allclose(found, [2.0, 3.0], rtol=1e-3)


def test_the_bare_loop_has_the_same_gains_and_no_drive():
    specification = reading.parse(SPECIFICATION)
    values = pair(specification).values
    without, own = ({name: column[place] for name, column in values.items()} for place in (0, 1))
    assert own == specification.nominal
    changed = {name for name in own if own[name] != without[name]}
    assert changed == {"wn", "zeta", "delay", "position_noise", "velocity_filter"}
    assert without["wn"] == np.inf and without["delay"] == 0.0 and without["position_noise"] == 0.0


def test_a_bare_loop_sees_a_sampled_velocity(monkeypatch):
    specification = dataclasses.replace(reading.parse(SPECIFICATION), velocity="differenced")
    asked = []

    def followed(one, samples):
        asked.append((one.velocity, samples))
        return [len(asked)]

    monkeypatch.setattr(single, "simulate_all", followed)
    assert _runs(specification) == [1, 2]
    both = pair(specification)
    assert [velocity for velocity, _ in asked] == ["sampled", "differenced"]
    for place, (_, alone) in enumerate(asked):
        assert len(alone) == 1 and alone.first == place
        assert {k: v[0] for k, v in alone.values.items()} == {
            k: v[place] for k, v in both.values.items()
        }
    assert np.isinf(asked[0][1].values["velocity_filter"])


@pytest.mark.exhaustive
def test_a_bias_that_walks_is_no_part_of_the_growth_rate():
    specification = reading.parse(SPECIFICATION)
    parameters = specification.parameters | {"position_bias_walk": 1e-4}
    walking = dataclasses.replace(specification, parameters=parameters)
    rates = []
    for one in (specification, walking):
        samples = expand(one)
        (plan,) = plans.groups(one, samples)
        rates.append(spectra.rates_batch(plan, one, samples, np.zeros(plan.batch, int)).growth)
    np.testing.assert_array_equal(*rates)
