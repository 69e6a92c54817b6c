"""Growth rates of maps of gains, which follow from a few characteristic polynomials."""

import dataclasses

import jax
import numpy as np
import pytest
from exact import growth_rate as exact_growth_rate
from quickly import compiled_quickly as compiled_quickly
from robots import PENDULUM

from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.parameters import PRESETS
from jaxact.simulation import plans, spectra, tiles

MAP = """
engine = "{engine}"
[parameters]
actuator = "hyq"
control_rate = {rate}
[axes]
kd = {{min = 0.1, max = 2000, num = 8, spacing = "log"}}
delay = {delays}
gain_scale = [0.5, 3.0]
kp = {{min = 0, max = 1e5, num = 9}}
"""


def _rates(asked):
    samples = expand(asked)
    found = np.empty(len(samples))
    for plan in plans.groups(asked, samples):
        for numbers, count in plans.batches(plan, samples):
            rates = spectra.rates_batch(plan, asked, samples, numbers).growth
            found[numbers[:count]] = rates[:count]
    return found, samples


def _known(asked):
    """Whether the rates come from shared polynomials."""
    samples = expand(asked)
    with jax.enable_x64(True):
        sets = spectra._sets(plans.groups(asked, samples)[0], asked, samples)
    return sets is not None and sets.linear.all()


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("rate", "delays", "shared"),
    [
        (1000.0, "[0, 0.0013, 0.005]", True),
        (4000.0, "[0, 0.0007]", False),
        (500.0, "[0.04]", False),
    ],
    ids=["map", "high-rate", "many-states"],
)
def test_maps_of_gains_equal_the_exact_figures(rate, delays, shared):
    asked = reading.parse(MAP.format(engine="mass", rate=rate, delays=delays))
    assert _known(asked) == shared
    got, samples = _rates(asked)
    values = samples.values
    kp, kd = (values["gain_scale"] * values[name] for name in ("kp", "kd"))
    want = np.empty(len(samples))
    for delay in np.unique(values["delay"]):
        own = values["delay"] == delay
        want[own] = exact_growth_rate(
            kp[own], kd[own], 0.7, *PRESETS["hyq"], delay, period=1.0 / rate
        ).ravel()
    near = np.abs(want) < 200.0
    assert near.sum() > 10
    np.testing.assert_array_less(np.abs(got - want)[near], 0.01 * np.abs(want[near]) + 0.02)
    wrong = (got > 0.0) != (want > 0.0)
    assert not np.any(wrong & (np.abs(np.expm1(want / rate)) > 1e-4))


@pytest.mark.exhaustive
def test_a_plant_of_mjx_is_linear_in_the_gains():
    asked = reading.parse(MAP.format(engine="mjx", rate=1000.0, delays="[0.001]"))
    assert _known(asked)
    samples = expand(asked)
    (plan,) = plans.groups(asked, samples)
    (numbers, count), *_ = plans.batches(plan, samples)
    got = spectra.rates_batch(plan, asked, samples, numbers).growth[:count]
    with jax.enable_x64(True):
        want = spectra._each(plan, asked, samples, numbers)[:count]
    np.testing.assert_allclose(got, want, rtol=1e-6, atol=2e-3)


@pytest.mark.exhaustive
def test_what_is_not_linear_in_the_gains_goes_by_itself(monkeypatch):
    """The fourth pair of gains would tell."""
    asked = reading.parse(MAP.format(engine="mass", rate=1000.0, delays="[0, 0.0013, 0.005]"))
    right, samples = _rates(asked)
    sets = spectra._sets

    def wrong(*given):
        found = sets(*given)
        linear = np.array([True, False, True])
        return dataclasses.replace(found, linear=linear, bases=found.bases * linear[:, None, None])

    monkeypatch.setattr(spectra, "_sets", wrong)
    again, _ = _rates(asked)
    np.testing.assert_allclose(again, right, rtol=1e-6, atol=3e-3)


ROBOT = """
engine = "mujoco"
duration = {duration}
[plant]
model = "pendulum.xml"
keyframe = "home"
{moved}
[parameters]
actuator = "hyq"
{errors}
[axes]
gain_scale = [0.5, 3.0]
"""
MOVED = """
[motion]
kind = "sine"
frequency = 3.0
[push]
body = "lower"
impulse = [0, 0, 1.0]
"""


def test_neither_errors_nor_what_moves_a_robot_need_another_program(tmp_path, monkeypatch):
    (tmp_path / "pendulum.xml").write_text(PENDULUM)
    calm = reading.parse(ROBOT.format(duration=0.2, moved="", errors=""), tmp_path)
    errors = "position_noise = 1e-4\ncommand_resolution = 0.01\nforce_limit = 50"
    rough = reading.parse(ROBOT.format(duration=0.35, moved=MOVED, errors=errors), tmp_path)
    found, _ = _rates(calm)
    monkeypatch.setattr(tiles.run, "_found", None)  # what it calls for a program that is not there
    again, _ = _rates(rough)
    np.testing.assert_array_equal(again, found)
    assert found[0] != found[1]
