"""Labels of logarithmic axes: several on any axis, all different, and true."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from jaxact.plotting import ticks


def _labels(low, high, **options):
    """Positions and words along an axis from low to high."""
    axes = Figure().subplots()
    axes.set_yscale("log")
    axes.set_ylim(low, high)
    ticks.label(axes.yaxis, **options)
    places = axes.yaxis.get_majorticklocs()
    return places, axes.yaxis.get_major_formatter().format_ticks(places)


@given(st.floats(-6.0, 6.0), st.floats(0.01, 14.0))
def test_any_axis_has_several_labels_and_they_differ(low, decades):
    ends = 10.0**low, 10.0 ** (low + decades)
    places, words = _labels(*ends)
    assert 3 <= len(places) <= 11
    assert len(set(words)) == len(words) and all(words)
    assert ends[0] * (1 - 1e-6) <= places[0] and places[-1] <= ends[1] * (1 + 1e-6)
    assert (np.diff(places) > 0).all()


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (1.0, 300.0, ["1", "3", "10", "30", "100", "300"]),
        (0.05, 20.0, ["0.1", "0.3", "1", "3", "10"]),
        (0.3, 5.0, ["0.5", "1", "2", "5"]),
        (10.0, 1e4, ["10", "100", "1000", "10000"]),
        (70.0, 90.0, ["70", "75", "80", "85", "90"]),
    ],
)
def test_labels_are_what_a_reader_would_write(low, high, expected):
    _, words = _labels(low, high)
    assert words == expected


def test_long_numbers_are_powers_of_ten_all_along_the_axis():
    _, words = _labels(10.0, 1e7)
    assert all("10^{" in word for word in words)
    _, words = _labels(2e5, 2e7)
    assert r"3\times10^{5}" in words[0]


def test_seconds_are_written_in_milliseconds():
    places, words = _labels(1e-3, 0.03, factor=1e3)
    assert [float(word) for word in words] == pytest.approx(1e3 * np.asarray(places))
    assert words == ["1", "3", "10", "30"]


def test_decades_are_left_out_of_very_long_axes_evenly():
    places, _ = _labels(1e-9, 1e9)
    steps = np.diff(np.log10(places))
    assert steps == pytest.approx(np.full(len(steps), steps[0])) and math.isclose(steps[0] % 1, 0)


def test_an_axis_without_numbers_has_no_ticks():
    assert ticks.LogTicks().tick_values(-1.0, 10.0) == []
    assert ticks.LogTicks().tick_values(2.0, 2.0) == []
    assert ticks.LogLabels()(0.0) == "0"
