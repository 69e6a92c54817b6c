"""Samples: the grid in C order, defaults filled in, presets resolved, reproducible draws."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from jaxact.loops.joint_units import with_units
from jaxact.loops.reading import parse
from jaxact.loops.samples import expand
from jaxact.parameters import PARAMETERS, PRESETS

GRID = """
[parameters]
mass = 2.5
[axes]
actuator = ["starleth", "ideal"]
delay = [0.005, 0.0, 0.001]
kp = { min = 10, max = 1000, num = 3, spacing = "log" }
"""


def test_grid_is_the_product_of_the_axes_in_c_order():
    samples = expand(parse(GRID))
    assert samples.dims == ("actuator", "delay", "kp") and samples.shape == (2, 3, 3)
    product = itertools.product(["starleth", "ideal"], [0.005, 0.0, 0.001], [10, 100, 1000])
    for index, (actuator, delay, kp) in enumerate(product):
        wn, zeta = PRESETS[actuator]
        row = {name: values[index] for name, values in samples.values.items()}
        assert (row["wn"], row["zeta"], row["delay"]) == (wn, zeta, delay)
        assert math.isclose(row["kp"], kp) and row["mass"] == 2.5 and row["kd"] == 20.0
    assert len(samples) == 18


def test_every_parameter_has_a_value_for_every_sample():
    samples = expand(parse(GRID))
    assert set(samples.values) == set(PARAMETERS)
    for values in samples.values.values():
        assert values.shape == (18,) and values.dtype == np.float64


def test_a_fixed_parameter_takes_no_memory():
    samples = expand(parse("[axes]\nkp={min=1, max=2, num=1000000}"))
    assert samples.values["kd"].strides == (0,) and samples.values["kp"].strides == (8,)


def test_coordinates_carry_units_and_the_presets_numbers():
    coords = expand(parse(GRID)).coords
    assert coords["delay"].dims == ("delay",) and coords["delay"].attributes["units"] == "s"
    assert coords["wn"].dims == ("actuator",)
    np.testing.assert_array_equal(coords["wn"].values, [110.0, math.inf])
    assert list(coords["actuator"].values) == ["starleth", "ideal"]


SAMPLED = """
seed = {seed}
[axes]
actuator = ["hyq", "ideal"]
kp = {{ min = 10, max = 1000, spacing = "log" }}
kd = {{ min = -1, max = 3 }}
[sampling]
method = "{method}"
samples = {samples}
"""


def _sampled(method, samples=64, seed=0):
    return expand(parse(SAMPLED.format(method=method, samples=samples, seed=seed)))


@pytest.mark.parametrize("method", ["sobol", "latin-hypercube"])
def test_sampled_ranges_share_one_dimension_and_repeat_for_every_listed_value(method):
    samples = _sampled(method)
    assert samples.dims == ("actuator", "sample") and samples.shape == (2, 64)
    kp = samples.values["kp"].reshape(2, 64)
    np.testing.assert_array_equal(kp[0], kp[1])
    np.testing.assert_array_equal(kp[0], samples.coords["kp"].values)
    assert samples.coords["kp"].dims == ("sample",)


@pytest.mark.parametrize("method", ["sobol", "latin-hypercube"])
def test_draws_fill_the_range_evenly_in_its_spacing(method):
    samples = _sampled(method, samples=256)
    kp, kd = samples.coords["kp"].values, samples.coords["kd"].values
    assert kp.min() >= 10 and kp.max() <= 1000 and kd.min() >= -1 and kd.max() <= 3
    for unit in (np.log10(kp / 10) / 2, (kd + 1) / 4):
        assert stats.kstest(unit, "uniform").statistic < 2 / 256
        assert len(set(np.floor(unit * 256))) == 256  # one in each of 256 equal parts


@pytest.mark.parametrize("method", ["sobol", "latin-hypercube"])
def test_draws_depend_on_the_seed_alone(method):
    first, again, other = (_sampled(method, seed=seed).values["kp"] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.all(first != other)


def test_any_number_of_sobol_points_begins_the_same_sequence():
    long, short = _sampled("sobol", 64), _sampled("sobol", 37)
    np.testing.assert_array_equal(short.coords["kp"].values, long.coords["kp"].values[:37])


@given(
    low=st.floats(-1e3, 1e3), width=st.floats(1e-3, 1e3), number=st.integers(2, 50),
    log=st.booleans(),
)  # fmt: skip
def test_a_range_has_its_ends_and_even_spacing(low, width, number, log):
    low = abs(low) + 1e-3 if log else low
    spacing = "log" if log else "linear"
    axis = f"{{min={low!r}, max={low + width!r}, num={number}, spacing='{spacing}'}}"
    values = expand(parse(f"[axes]\nkp={axis}")).values["kp"]
    assert values[0] == low and values[-1] == low + width and len(values) == number
    steps = np.diff(np.log(values) if log else values)
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-6, atol=1e-12)


def test_axes_of_robots_are_in_the_units_of_the_joints_they_are_meant_for(tmp_path):
    """One joint slides and one turns; a payload is a mass whatever they do."""
    (tmp_path / "robot.xml").write_text(
        "<mujoco><option timestep='0.002'/><worldbody><body>"
        "<joint name='lift' type='slide' axis='0 0 1' stiffness='1e3'/>"
        "<geom size='0.1' mass='2'/><body pos='0.2 0 0'><joint name='knee' axis='0 1 0'/>"
        "<geom size='0.1' pos='0 0 -0.2' mass='1'/></body></body></worldbody>"
        "<actuator><motor name='l' joint='lift'/><motor name='k' joint='knee'/></actuator></mujoco>"
    )
    specification = parse(
        '[plant]\nmodel = "robot.xml"\n[axes]\nkp = [5.0, 6.0]\n"kp@knee" = [5.0]\n'
        '"kd@lift" = [0.1, 0.2]\npayload = [0.0, 1.0]\ndelay = [0.0, 1e-3]\nwn = [100.0]\n',
        tmp_path,
    )
    found = with_units(expand(specification).coords, specification.plant)
    assert {name: place.attributes["units"] for name, place in found.items()} == {
        "kp": "N m/rad or N/m", "kp@knee": "N m/rad", "kd@lift": "N s/m",
        "payload": "kg", "delay": "s", "wn": "rad/s",
    }  # fmt: skip
