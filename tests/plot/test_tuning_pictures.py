"""Pictures of a tuning from made-up numbers: what is drawn, and what is left out."""

import numpy as np
import pytest

from jaxact.plot import look, tuning

KP, KD = np.geomspace(10.0, 1000.0, 12), np.geomspace(1.0, 50.0, 9)
PEAK = np.where(KP[None] < 400.0, 1.0 + KP[None] / 100.0 + 0.1 * KD[:, None], np.nan)
PLANE = tuning.Plane(KP, KD, PEAK, [])


def _words(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.mark.parametrize("before", [None, (400.0, 20.0)])
def test_the_map_marks_both_pairs_of_gains(before, tmp_path):
    figure = tuning.tuning_map(PLANE, before, (90.0, 12.0), max_peak=2.0)
    words = _words(figure)
    assert any("after: kp 90" in word for word in words)
    assert any("before" in word for word in words) == (before is not None)
    assert any("max(Ms, Mt) = 2" in word for word in words)
    look.write(figure, tmp_path / "map.png", title="map")
    assert (tmp_path / "map.png").stat().st_size > 10_000


def test_convergence_shows_every_start_and_the_given_one():
    values = np.linspace(10.0, 100.0, 40)[None] * np.ones((3, 1))
    figure = tuning.convergence(values, values / 90.0, label="stiffness [N/m]", given=True)
    upper, lower = figure.axes
    assert len(upper.lines) == 3 and upper.get_ylabel() == "stiffness [N/m]"
    assert lower.get_xlabel() == "step" and "the given start" in _words(figure)


def test_step_responses_of_all_members():
    time = np.linspace(0.0, 0.3, 50)
    rows = 1.0 - np.exp(-time[None] * np.array([[20.0], [40.0]]))
    figure = tuning.step_band(time, None, rows)
    (axes,) = figure.axes
    assert axes.get_xlabel() == "time [ms]" and _words(figure) == ["after"]
    assert len(axes.lines) == 3  # two members, and the setpoint


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
