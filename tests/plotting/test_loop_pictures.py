"""The pictures of single loops: margins stand where they are, nothing else is invented."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from jaxact.plotting import theme
from jaxact.plotting.bode import bode
from jaxact.plotting.nyquist import disk, nyquist
from jaxact.plotting.response import LoopResponse
from jaxact.plotting.sensitivity import sensitivity
from jaxact.plotting.step import StepResponse, step
from jaxact.plotting.trajectory import Joint, trajectory

W = np.geomspace(1.0, 1e4, 2000)


def _response(**changes):
    """L = 400 (1 + 0.05 s)/(0.7 s^2) exp(-0.005 s) with rounded margins of the oracle's."""
    open_loop = (400.0 + 20.0j * W) / (-0.7 * W**2) * np.exp(-0.005j * W)
    phase = np.degrees(np.arctan(0.05 * W) - 0.005 * W) - 180.0
    margins = {
        "gain_margin": 10.507775, "phase_crossover": 300.884662, "phase_margin": 49.481868,
        "gain_crossover": 33.322573, "delay_margin": 0.025917, "sensitivity_peak": 1.241075,
        "sensitivity_peak_frequency": 44.416673, "complementary_peak": 1.458392,
        "complementary_peak_frequency": 20.0, "disk_margin": 0.885257,
    }  # fmt: skip
    fields = {"label": "ideal", "frequency": W, "open_loop": open_loop, "phase": phase,
              "margins": margins}  # fmt: skip
    return LoopResponse(**(fields | changes))


UNSTABLE = {"label": "fast", "margins": {"gain_margin": float("nan")}, "stable": False}


def _legend(figure):
    return [text.get_text() for text in figure.legends[0].get_texts()]


def test_bode_bars_reach_from_the_curve_to_the_critical_lines():
    figure = bode([_response(), _response(**UNSTABLE)], title="t", footer="f")
    magnitude, phase = figure.axes
    bars = [line for line in magnitude.lines if line.get_linewidth() == 2.6]
    assert len(bars) == 1  # none for the unstable loop
    np.testing.assert_allclose(bars[0].get_xdata(), 300.884662)
    curve = np.interp(np.log(300.884662), np.log(W), 20 * np.log10(np.abs(_response().open_loop)))
    np.testing.assert_allclose(bars[0].get_ydata(), [curve, 0.0], atol=1e-3)
    bar = next(line for line in phase.lines if line.get_linewidth() == 2.6)
    np.testing.assert_allclose(bar.get_ydata()[1], -180.0, atol=1e-3)
    assert _legend(figure) == [
        "ideal: gain margin 10.5 (20.4 dB), phase margin 49.5°, delay margin 25.92 ms",
        "fast: unstable, no margins",
    ]


def test_infinite_gain_margin_has_no_bar():
    margins = _response().margins | {"gain_margin": float("inf"), "phase_crossover": float("inf")}
    figure = bode([_response(margins=margins)])
    assert not [line for line in figure.axes[0].lines if line.get_linewidth() == 2.6]
    assert "gain margin ∞" in _legend(figure)[0]


def test_disk_touches_what_the_margin_says():
    for alpha in (0.2, 0.885257, 1.5):
        centre, radius = disk(alpha)
        high, low = (2 + alpha) / (2 - alpha), (2 - alpha) / (2 + alpha)
        assert centre - radius == pytest.approx(-high)
        assert centre + radius == pytest.approx(-low)
    loop = _response()
    centre, radius = disk(loop.margins["disk_margin"])
    distance = np.abs(loop.open_loop - centre)
    assert distance.min() == pytest.approx(radius, rel=1e-4)  # L stays outside and touches


def test_nyquist_marks_crossovers_on_axis_and_circle():
    figure = nyquist([_response(), _response(**UNSTABLE)])
    points = [
        (line.get_marker(), float(line.get_xdata()[0]), float(line.get_ydata()[0]))
        for line in figure.axes[0].lines
        if line.get_marker() in ("o", "s")
    ]
    (_, x, y), (_, u, v) = sorted(points)
    assert (x, y) == (pytest.approx(-1 / 10.507775), 0.0)
    assert np.hypot(u, v) == pytest.approx(1.0)
    crossing = np.interp(33.322573, W, _response().open_loop)
    assert complex(u, v) == pytest.approx(crossing, abs=1e-3)
    assert _legend(figure)[1] == "fast: unstable"


def test_sensitivity_marks_its_peaks():
    figure = sensitivity([_response(), _response(**UNSTABLE)])
    marks = [line for axes in figure.axes for line in axes.lines if line.get_marker() == "o"]
    np.testing.assert_allclose(
        marks[0].get_ydata(), np.abs(_response().sensitivity).max(), rtol=1e-3
    )
    assert len(marks) == 2
    assert _legend(figure)[0].startswith("ideal: Ms 1.24 at 44.4 rad/s, Mt 1.46")
    assert "say nothing" in _legend(figure)[1]


def _joint(position, force=None):
    time = np.arange(len(position)) * 1e-3
    ones = np.ones_like(time)
    return Joint(time, 0.1 * ones, position, ones, ones, ones, ones if force is None else force)


def test_trajectory_shares_its_time_axis_and_has_units():
    time = np.arange(400) * 1e-3
    figure = trajectory(_joint(0.1 * (1 - np.exp(-time / 0.05))), title="t", footer="f")
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "position [m]", "velocity [m/s]", "force [N]"
    ]  # fmt: skip
    assert figure.axes[2].get_xlabel() == "time [ms]"
    rotary = trajectory(_joint(time), units=("rad", "N m"))
    assert rotary.axes[2].get_ylabel() == "force [N m]"


@pytest.mark.parametrize("last", [1e300, np.inf, np.nan])
def test_a_diverging_trajectory_is_cut_where_it_leaves(tmp_path, last):
    position = 0.1 * 1.05 ** np.arange(400.0)
    position[-1] = last
    figure = trajectory(_joint(position))
    drawn = figure.axes[0].lines[1].get_ydata()
    assert np.max(np.abs(drawn)) < 3.0 and len(drawn) < 400
    assert "diverges" in figure.axes[0].texts[0].get_text()
    theme.write(figure, tmp_path / "run.png", title="t")


def test_an_unstable_step_does_not_set_the_range(tmp_path):
    time = np.arange(400) * 1e-3
    calm = _joint(0.1 * (1 - np.exp(-time / 0.05)))
    wild = _joint(0.1 * 1.5 ** np.arange(400.0), force=1e6 * 1.5 ** np.arange(400.0))
    figure = step([StepResponse("calm", calm), StepResponse("wild", wild, stable=False)])
    assert figure.axes[0].get_ylim()[1] < 1.0 and figure.axes[1].get_ylim()[1] < 10.0
    assert figure.axes[0].get_xlim() == (0.0, 399.0)
    theme.write(figure, tmp_path / "step.png", title="t")
    alone = step([StepResponse("wild", wild, stable=False)])
    assert np.isfinite(alone.axes[0].get_ylim()).all()


def _steps(axes):
    """Setpoints drawn with their colour, and heights of the bands around them."""
    dashed = [line for line in axes.lines if line.get_linestyle() == "--" and line.get_zorder() < 3]
    drawn = [line for line in dashed if len(line.get_ydata())]
    setpoints = [(line.get_ydata()[-1], line.get_color()) for line in drawn]
    return setpoints, [patch.get_height() for patch in axes.patches]


def test_every_step_has_its_setpoint_and_its_band_in_the_colour_of_its_loop():
    time = np.arange(400) * 1e-3
    rise = 1 - np.exp(-time / 0.05)
    low = StepResponse("low", _joint(0.1 * rise))
    high = StepResponse("high", replace(_joint(0.3 * rise), setpoint=np.full_like(time, 0.3)))
    colors = [theme.style(index)["color"] for index in range(2)]
    figure = step([low, high])
    setpoints, bands = _steps(figure.axes[0])
    assert setpoints == [(0.1, colors[0]), (0.3, colors[1])]
    np.testing.assert_allclose(bands, [2 * 0.02 * 0.1, 2 * 0.02 * 0.3])
    assert _legend(figure)[0] == "setpoints, bands of ±2%"
    begun_apart = StepResponse("near", _joint(0.05 + 0.05 * rise))
    setpoints, bands = _steps(step([low, begun_apart]).axes[0])
    assert setpoints == [(0.1, colors[0]), (0.1, colors[1])]
    np.testing.assert_allclose(bands, [2 * 0.02 * 0.1, 2 * 0.02 * 0.05])
    shared = step([low, low])
    assert _steps(shared.axes[0])[0] == [(0.1, theme.INK)]
    assert _legend(shared)[0] == "setpoint, band of ±2%"


def test_an_unstable_step_leaves_room_for_the_setpoints_of_all():
    time = np.arange(400) * 1e-3
    wild = _joint(0.1 * 1.5 ** np.arange(400.0))
    high = replace(_joint(2.0 * (1 - np.exp(-time / 0.5))), setpoint=np.full_like(time, 2.0))
    figure = step([StepResponse("wild", wild, stable=False), StepResponse("high", high)])
    low, top = figure.axes[0].get_ylim()
    assert low < 0.1 and 2.0 < top < 10.0


def test_styles_differ_in_grey_too():
    styles = [theme.style(index) for index in range(5)]
    assert len({str(s["linestyle"]) for s in styles}) == 5
    assert SimpleNamespace(**styles[0]).color != styles[1]["color"]
