"""Axes of signals that stand still, and commands that do not hide each other."""

import numpy as np
import pytest

from jaxact.plotting import axis_spans
from jaxact.plotting.step import StepResponse, step
from jaxact.plotting.trajectory import Joint, trajectory

TIME = np.arange(500) * 1e-3
STILL = np.zeros_like(TIME)


def _joint(position, setpoint=0.0, force=0.0):
    velocity = np.gradient(position, TIME)
    return Joint(
        TIME, STILL + setpoint, position, velocity, STILL + force, STILL + force, STILL + force
    )


def _heights(figure):
    """How much of its axis each drawn signal takes, by panel."""
    shares = []
    for axes in figure.axes:
        low, high = axes.get_ylim()
        curve = axes.lines[1 if axes is figure.axes[0] else 0].get_ydata()
        shares.append(np.ptp(curve) / (high - low))
    return shares


def test_the_dust_of_a_robot_at_rest_is_drawn_flat():
    creeping = 7e-4 + 4e-7 * (1.0 - np.exp(-TIME / 0.3))
    force = -11.0 + 1e-6 * np.sin(50.0 * TIME)
    figure = trajectory(_joint(creeping, 7e-4, force), units=("rad", "N m"))
    assert max(_heights(figure)) < 0.01
    low, high = figure.axes[0].get_ylim()
    assert low < 7e-4 < high and high - low == pytest.approx(1e-4)
    assert figure.axes[0].texts[0].get_text() == "at rest: moves by 3.2e-07 rad"


def test_nothing_at_all_gives_axes_without_an_exponent():
    figure = trajectory(_joint(STILL, force=-1e-17))
    figure.canvas.draw()
    for axes in figure.axes:
        assert axes.yaxis.get_offset_text().get_text() == ""
    assert figure.axes[0].texts[0].get_text() == "at rest"


@pytest.mark.parametrize(
    ("position", "setpoint", "unit", "resolution"),
    [
        (2e-3 * np.sin(100.0 * TIME), 0.0, "rad", 1.5e-3),  # a limit cycle of counts
        (1e-6 * np.sin(100.0 * TIME), 0.0, "rad", 7e-7),  # the same of a 23 bit encoder
        (1e-6 * (1.0 - np.exp(-TIME / 0.05)), 1e-6, "m", 0.0),  # a small stage
        (0.1 * (1.0 - np.exp(-TIME / 0.05)), 0.1, "m", 0.0),
    ],
)
def test_a_small_motion_stays_a_motion(position, setpoint, unit, resolution):
    figure = trajectory(
        _joint(position, setpoint), units=(unit, "N m"), resolution=resolution
    )  # fmt: skip
    assert _heights(figure)[0] > 0.1
    assert not figure.axes[0].texts


def test_a_joint_that_another_moves_a_little_is_not_blown_up():
    """One of several joints of a step: 1e-7 of it is nothing."""
    least = axis_spans.spans(TIME, [STILL + 1e-7 * TIME], STILL + 0.2, [STILL], unit="rad")
    assert least.position == pytest.approx(2e-4)


def test_a_step_of_nothing_is_flat_too():
    figure = step([StepResponse("rest", _joint(1e-12 * TIME, force=1e-17 * TIME))])
    for axes in figure.axes:
        low, high = axes.get_ylim()
        assert high - low >= 1e-6
    low, high = figure.axes[1].get_ylim()
    assert high - low >= 0.05


def test_each_force_is_seen_beside_the_others_even_where_all_are_equal():
    figure = trajectory(_joint(0.1 * (1.0 - np.exp(-TIME / 0.05)), 0.1, force=3.0))
    command, delayed, force = (
        next(line for line in figure.axes[2].lines if line.get_label() == name)
        for name in ("command", "delayed command", "force")
    )
    widths = [line.get_linewidth() for line in (command, delayed, force)]
    assert widths[0] > 1.5 * widths[1] > 2.0 * widths[2], "nested: what is below stands out"
    assert all(line.get_linestyle() == "-" for line in (command, delayed))
    lines = list(figure.axes[2].lines)
    assert lines.index(command) < lines.index(delayed) < lines.index(force)
