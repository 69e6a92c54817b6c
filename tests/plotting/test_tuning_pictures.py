"""Pictures of a tuning from made-up numbers: what is drawn, and what is left out."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_hex

from jaxact.analysis.boundary.curves import BoundaryCurve
from jaxact.plotting import theme, tuning
from jaxact.plotting.convergence import UnmetBound, convergence
from jaxact.plotting.robot_gains import gains, limits
from jaxact.plotting.step_band import Responses, step_band
from jaxact.plotting.tuning_map import Boundary, Plane, tuning_map
from jaxact.tuning.certificate import Check
from jaxact.verbs import tuning_pictures

KP, KD = np.geomspace(10.0, 1000.0, 12), np.geomspace(1.0, 50.0, 9)
PEAK = np.where(KP[None] < 400.0, 1.0 + KP[None] / 100.0 + 0.1 * KD[:, None], np.nan)
EDGE = BoundaryCurve(np.full(9, 400.0), KD, KD, "curve", True, "left")
PLANE = Plane(KP, KD, PEAK, [Boundary("light, late", [EDGE]), Boundary("heavy, late", [EDGE])])


def _words(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def _handle(figure, words):
    """The line in the legend beside some words."""
    (legend,) = figure.legends
    return next(
        handle
        for handle, text in zip(legend.legend_handles, legend.get_texts(), strict=True)
        if words in text.get_text()
    )


@pytest.mark.parametrize("before", [None, (400.0, 20.0)])
def test_the_map_marks_both_pairs_of_gains(before, tmp_path):
    figure = tuning_map(PLANE, before, (90.0, 12.0), max_peak=2.0)
    words = _words(figure)
    assert any("after: kp 90" in word for word in words)
    assert any("before" in word for word in words) == (before is not None)
    assert any("max(Ms, Mt) = 2" in word for word in words)
    missed = tuning_map(PLANE, before, (90.0, 12.0), max_peak=2.0, reached=False)
    assert any(word.startswith("nearest found: kp 90") for word in _words(missed))
    theme.write(figure, tmp_path / "map.png", title="map")
    assert (tmp_path / "map.png").stat().st_size > 10_000


def test_the_contour_has_the_colour_of_its_legend_and_is_not_white():
    figure = tuning_map(PLANE, None, (90.0, 12.0), max_peak=2.0)
    (contour,) = [c for c in figure.axes[0].collections if hasattr(c, "levels")]
    drawn = to_hex(contour.get_edgecolor()[0])
    assert drawn == to_hex(_handle(figure, "max(Ms, Mt) = 2").get_color())
    assert drawn not in ("#ffffff", to_hex(theme.FAINT), "#000000")


def test_every_boundary_is_named_and_has_a_dash_of_its_own():
    figure = tuning_map(PLANE, None, (90.0, 12.0), max_peak=2.0)
    edges = [line for line in figure.axes[0].lines if line.get_xdata()[0] == 400.0]
    assert len({str(line.get_linestyle()) for line in edges}) == 2
    for name, line in zip(("light", "heavy"), edges, strict=True):
        handle = _handle(figure, f"exact boundary: {name}")
        assert handle.get_linestyle() == line.get_linestyle()
    assert figure.axes[1].get_ylabel() == "max(Ms, Mt), worst of the members named"
    assert "unstable" in [text.get_text() for text in figure.axes[0].texts]


def test_a_map_without_the_bound_says_so_and_has_no_legend_of_it():
    figure = tuning_map(PLANE, None, (90.0, 12.0), max_peak=1.05)
    assert not any("= 1.05" in word for word in _words(figure))
    assert figure.axes[0].get_title() == "max(Ms, Mt) above 1.05 everywhere here"
    lost = Plane(KP, KD, np.full_like(PEAK, np.nan), [])
    assert "unstable" in tuning_map(lost, None, (90.0, 12.0), max_peak=2.0).axes[0].get_title()


def test_convergence_shows_every_start_and_the_given_one():
    values = np.linspace(10.0, 100.0, 40)[None] * np.ones((3, 1))
    figure = convergence(values, values / 90.0, label="stiffness [N/m]", given=True)
    upper, lower = figure.axes
    assert len(upper.lines) == 3 and upper.get_ylabel() == "stiffness [N/m]"
    assert lower.get_xlabel() == "step" and "the given start" in _words(figure)
    assert upper.get_title() == "" and not any("best found" in word for word in _words(figure))


def test_an_infeasible_tuning_looks_infeasible():
    values = np.full((3, 40), 400.0) * (1.0 + 1e-14 * np.arange(40))
    ratio = np.full((3, 40), 2.5)
    ratio[2] = 0.7  # of unstable loops: it says nothing
    figure = convergence(
        values, ratio, label="stiffness [N/m]", given=False,
        stable=np.array([True, True, False]),
        missed=UnmetBound("not reached: sensitivity peak 4.5 at best, asked for ≤ 2", 2.25),
    )  # fmt: skip
    upper, lower = figure.axes
    assert "not reached" in upper.get_title() and "4.5" in upper.get_title()
    best = [line for line in lower.lines if line.get_linestyle() == "--"]
    assert [float(line.get_ydata()[0]) for line in best] == [2.25]
    low, high = lower.get_ylim()
    assert low < 1.0 < 2.25 < high and (1.0 - low) / (high - low) > 0.05
    assert len(lower.patches) == 2, "what was to be reached, and what is beyond"
    assert not any(np.allclose(line.get_ydata(), 0.7) for line in lower.lines)
    assert "starts that stay unstable" in _words(figure)
    low, high = upper.get_ylim()
    assert high / low > 1.15, "dust of the objective is flat"


def test_a_tuning_without_stable_gains_says_so():
    values = np.full((2, 40), 800.0)
    figure = convergence(
        values, np.full((2, 40), 1.1), label="stiffness", given=True, stable=np.zeros(2, bool),
        missed=UnmetBound("not reached: no gains found that make every member stable", math.inf),
    )  # fmt: skip
    assert "no stable gains found" in [text.get_text() for text in figure.axes[1].texts]
    assert _words(figure) == ["starts that stay unstable", "every bound met"]


def test_what_was_missed_is_the_worst_of_the_closest_gains():
    checks = (
        Check("max_peak", "sensitivity_peak", 2.0, 4.5, "corner", math.log(2.25)),
        Check("min_delay_margin", "delay_margin", 0.005, 0.004, "corner", math.log(1.25)),
        Check("max_peak", "complementary_peak", 2.0, 1.5, "corner", math.log(0.75)),
    )
    certificate = SimpleNamespace(stable=True)
    tuned = SimpleNamespace(feasible=False, closest=checks, certificate=certificate)
    missed = tuning_pictures.missed(tuned)
    assert missed.words == "not reached: sensitivity peak 4.5 at best, asked for ≤ 2"
    assert missed.ratio == pytest.approx(2.25)
    tuned.closest = checks[1:]
    assert tuning_pictures.missed(tuned).words.endswith("0.004 at best, asked for ≥ 0.005")
    tuned.certificate.stable = False
    assert tuning_pictures.missed(tuned).ratio == math.inf
    tuned.feasible = True
    assert tuning_pictures.missed(tuned) is None


TIME = np.linspace(0.0, 0.3, 50)
ROWS = 1.0 - np.exp(-TIME[None] * np.array([[20.0], [40.0], [60.0]]))
ROWS[1] *= 1.0 + 0.3 * np.sin(30.0 * TIME)  # overshoots


def test_step_responses_of_a_single_loop_are_lines():
    figure = step_band(TIME, Responses(0.5 * ROWS[:1]), Responses(ROWS[:1]))
    (axes,) = figure.axes
    assert axes.get_xlabel() == "time [ms]" and _words(figure) == ["before", "after"]
    assert len(axes.lines) == 3 and not axes.collections  # two responses, and the setpoint


def test_step_responses_of_an_ensemble_are_a_band_with_two_members_on_it():
    after = Responses(ROWS, ("a", "b", "c"), nominal=ROWS[0])
    figure = step_band(TIME, None, after)
    (axes,) = figure.axes
    (band,) = axes.collections
    edge = band.get_paths()[0].vertices
    for time, low, high in zip(TIME * 1e3, ROWS.min(axis=0), ROWS.max(axis=0), strict=True):
        there = edge[np.isclose(edge[:, 0], time), 1]
        assert there.min() == pytest.approx(low) and there.max() == pytest.approx(high)
    worst, nominal, _ = axes.lines
    np.testing.assert_allclose(worst.get_ydata(), ROWS[1])
    np.testing.assert_allclose(nominal.get_ydata(), ROWS[0])
    assert _words(figure) == ["after: all 3 members", "nominal", "overshoots most: b"]


def test_a_member_that_explodes_is_drawn_no_further():
    rows = np.vstack([ROWS, np.where(TIME > 0.2, np.nan, 1e300 * TIME)])
    figure = step_band(TIME, Responses(rows, "abcd", ROWS[0]), Responses(ROWS, "abc", ROWS[0]))
    (axes,) = figure.axes
    assert axes.get_ylim()[1] == pytest.approx(2.2)
    assert any("overshoots most: d" in word for word in _words(figure))
    figure.canvas.draw()


def test_one_outlier_does_not_squeeze_the_other_gains():
    after = np.array([40.0, 55.0, 60.0, 80.0, 3e5, 70.0]), np.full(6, 2.0)
    ends = np.array([after, after])
    names = [f"joint {i}" for i in range(6)]
    figure = gains(names, None, after, ends, units=("N m/rad", "N m s/rad"))
    kp, kd = figure.axes
    low, high = kp.get_ylim()
    assert low < 40.0 and 80.0 < high < 200.0
    arrows = [line for line in kp.lines if line.get_marker() == "^"]
    assert all(low < line.get_ydata()[0] < high and line.get_xdata()[0] == 4 for line in arrows)
    assert arrows and [text.get_text() for text in kp.texts] == ["3e+05"]
    assert not [line for line in kd.lines if line.get_marker() in "^v"] and not kd.texts


def test_limits_hold_all_gains_that_are_alike():
    values = np.geomspace(1.0, 1e4, 12)
    low, high = limits(values)
    assert low < 1.0 and high > 1e4, "a wide spread has no outliers"
    assert limits(np.array([np.nan, 0.0])) == (0.1, 10.0)


def test_the_front_marks_the_bound_asked_for():
    peaks = np.linspace(1.2, 3.0, 6)
    figure = tuning.front(
        peaks, peaks * 100, peaks * 10, label="stiffness [N/m]", marked=(1.6, 160)
    )
    assert _words(figure) == ["the bound asked for"]
    assert figure.axes[1].get_xlabel() == "largest Ms and Mt allowed"


def test_the_front_of_a_robot_names_its_groups():
    peaks = np.linspace(1.2, 3.0, 6)
    kd = peaks[:, None] * np.array([1.0, 2.0])
    figure = tuning.front(
        peaks, peaks * 100, kd, label="stiffness", kd_unit="N m s/rad", groups=("hip", "knee")
    )
    assert _words(figure) == ["kd of hip", "kd of knee"]
    assert len(figure.axes[1].lines) == 2 and figure.axes[1].get_ylabel() == "kd [N m s/rad]"
