"""Which part of a sweep goes into which panel."""

import numpy as np
import pytest
from synthetic_store import DRAWN, GRID, dataset, dataset_of

from jaxact.errors import UserError
from jaxact.loops import reading
from jaxact.loops.samples import expand
from jaxact.plotting import wording
from jaxact.plotting.panels import arrange, axis


@pytest.fixture(scope="module")
def grid():
    return dataset(GRID)


@pytest.fixture(scope="module")
def drawn():
    return dataset(DRAWN)


def test_default_map_is_kp_against_kd_with_a_panel_for_each_case(grid):
    found = arrange(grid)
    assert (found.kind, found.x.name, found.y.name) == ("map", "kp", "kd")
    assert (found.x.scale, found.y.scale) == ("log", "log")
    assert (found.rows, found.columns) == (2, 2)
    assert [panel.caption for panel in found.panels] == ["delay 0 ms", "delay 5 ms", "", ""]
    assert found.panels[2].row_caption == "StarLETH (110 rad/s, ζ 0.9)"
    assert found.panels[0].data["verdict"].dims == ("kd", "kp")


def test_panels_show_rising_values_whatever_the_order_of_the_list(grid):
    found = arrange(grid)
    expected = grid["growth_rate"].sel(actuator="starleth", delay=0.005).transpose("kd", "kp")
    np.testing.assert_array_equal(found.panels[3].data["growth_rate"], expected)
    assert found.panels[3].data["delay"] == 0.005


def test_select_keeps_the_nearest_value_and_says_so(grid):
    found = arrange(grid, select={"delay": "0.004", "actuator": "hyq"})
    assert len(found.panels) == 1
    assert found.selected == ("delay 5 ms", "HyQ (800 rad/s, ζ 0.45)")
    assert found.data["verdict"].size == 120


def test_select_reaches_half_a_spacing_beyond_the_ends(grid):
    assert arrange(grid, select={"delay": "0.0074"}).selected == ("delay 5 ms",)
    assert arrange(grid, select={"delay": "-0.0024"}).selected == ("delay 0 ms",)


def test_of_a_single_value_select_takes_that_value_only():
    single = dataset(GRID.replace("[0.005, 0.0]", "[0.001534]"))
    assert arrange(single, select={"delay": "0.0015341"}).selected == ("delay 1.534 ms",)
    with pytest.raises(UserError, match=r"0.002 s is outside .* only value is 0.001534 s"):
        arrange(single, select={"delay": "0.002"})


def test_few_uneven_values_become_equal_cells(grid):
    found = arrange(grid, x="delay", y="kd", select={"kp": "400"})
    assert found.x.scale == "linear"  # two values have no unevenness
    uneven = dataset(GRID.replace("[0.005, 0.0]", "[0.005, 0.0, 0.001]"))
    found = arrange(uneven, x="delay", y="kd", select={"kp": "400"})
    assert found.x.scale == "category"
    np.testing.assert_array_equal(found.x.values, [0.0, 0.001, 0.005])


def test_lines_take_the_shortest_other_axis_as_family(grid):
    found = arrange(grid, kind="lines", x="kd", select={"kp": "400"})
    assert found.x.name == "kd"
    assert found.y.name in ("delay", "actuator")
    assert len(found.panels) == 2


def test_a_random_sample_is_a_scatter_with_its_gridded_axes_as_panels(drawn):
    found = arrange(drawn)
    assert (found.kind, found.x.name, found.y.name) == ("scatter", "kp", "kd")
    assert [panel.data["verdict"].size for panel in found.panels] == [40, 40]
    found = arrange(drawn, x="actuator", y="kd")
    assert found.panels[0].data["verdict"].size == 80
    assert set(found.panels[0].data["actuator"].values) == {"hyq", "starleth"}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"x": "kpp"}, "did you mean 'kp'"),
        ({"facet": ("dely",)}, "did you mean 'delay'"),
        ({"x": "kp", "y": "kp"}, "two parameters"),
        ({"x": "mass"}, "unknown axis 'mass'"),
        ({"select": {"delay": "0.0"}, "x": "delay"}, "single value 0 ms"),
        ({"select": {"delay": "soon"}}, "'soon' is not a number"),
        ({"select": {"delay": "nan"}}, "not a number"),
        ({"select": {"delay": "7"}}, "delay: 7 s is outside its axis, .* from 0 to 0.005 s"),
        ({"select": {"delay": "-0.003"}}, "-0.003 s is outside"),
        ({"select": {"delay": "inf"}}, "inf s is outside"),
        ({"select": {"kp": "2e5"}}, "200000 N/m is outside .* from 10 to 100000 N/m"),
        ({"select": {"actuator": "hyk"}}, "did you mean 'hyq'"),
        ({"select": {"mass": "1"}}, "unknown axis to select 'mass'"),
        ({"kind": "scatter"}, "does not fit"),
        ({"kind": "pie"}, "unknown kind"),
        ({"kind": "lines", "x": "kd", "y": "kp"}, "too many curves"),
        ({"x": "actuator", "y": "delay"}, "`select` kp=VALUE"),
        ({"facet": ("delay", "delay")}, "twice"),
        ({"facet": ("kp",), "x": "kp"}, "is an axis already"),
    ],
)
def test_mistakes_are_one_line(grid, options, message):
    with pytest.raises(UserError, match=message):
        arrange(grid, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"facet": ("kd",)}, "drawn at random"),
        ({"select": {"kp": "400"}}, "drawn at random"),
        ({"kind": "map"}, "random sample"),
    ],
)
def test_mistakes_with_a_random_sample(drawn, options, message):
    with pytest.raises(UserError, match=message):
        arrange(drawn, **options)


def test_more_axes_than_panels_can_show():
    text = GRID + "mass = [0.5, 0.7, 1.0]\n"
    specification = reading.parse(text)
    samples = expand(specification)
    flat = {"growth_rate": np.zeros(len(samples)), "verdict": np.zeros(len(samples), np.int8)}
    results = dataset_of(specification, samples, flat)
    with pytest.raises(UserError, match="`select` mass=VALUE"):
        arrange(results)
    assert len(arrange(results, select={"mass": "0.7"}).panels) == 4


@pytest.mark.parametrize(
    ("value", "units", "text"),
    [
        (0.001, "s", "1 ms"), (0.00183, "s", "1.83 ms"), (3.7e-4, "s", "370 µs"),
        (0.0, "s", "0 ms"), (2.0, "s", "2 s"), (1000.0, "Hz", "1 kHz"),
        (float("inf"), "rad/s", "∞"), (0.9, "1", "0.9"),
        (400.0, "N/m", "400 N/m"), ("starleth", "", "StarLETH"),
    ],
)  # fmt: skip
def test_quantities_read_as_an_engineer_writes_them(value, units, text):
    assert wording.quantity(value, units) == text


def test_an_infinite_value_makes_a_category():
    results = dataset(GRID.replace('actuator = ["hyq", "starleth"]', "wn = [inf, 100.0]"))
    found = axis(results["wn"])
    assert found.scale == "category"
    assert list(found.values) == [100.0, float("inf")]
