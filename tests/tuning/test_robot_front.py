"""The front of a robot: against searches of their own, and where nothing can be met."""

import numpy as np
import pytest
from arms import at_home
from quickly import compiled_quickly as compiled_quickly

from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import group
from jaxact.tuning.robot import front as robot_front
from jaxact.tuning.robot import search as robot

QUICK = {"starts": 2, "steps": 30}


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return at_home(tmp_path_factory.mktemp("front"))


@pytest.fixture(scope="module")
def tuned(arm):
    return robot.tune([arm], Goal(max_peak=1.8), group([], arm.names), **QUICK)


def test_the_front_rises_and_passes_through_optima_of_their_own(arm, tuned):
    points = robot_front.front(tuned, 4)
    peaks = [point.goal.max_peak for point in points]
    assert len(points) == 4 and peaks[-1] == pytest.approx(3.0) and np.all(np.diff(peaks) > 0)
    np.testing.assert_allclose(np.diff(1.0 / np.array(peaks)), np.diff(1.0 / np.array(peaks))[0])
    assert all(point.certified for point in points)
    values = [point.value for point in points]
    assert np.all(np.diff(values) > 0)
    for point in points[::2]:
        single = robot.tune([arm], point.goal, tuned.robot.case.groups, **QUICK)
        assert single.value == pytest.approx(point.value, rel=1e-5)
    # It begins just above the smallest peak there is.
    below = Goal(max_peak=peaks[0] / 1.03)
    assert not robot.tune([arm], below, tuned.robot.case.groups, **QUICK).feasible
    assert tuned.value == pytest.approx(np.exp(np.interp(1.8, peaks, np.log(values))), rel=0.2)


@pytest.mark.exhaustive
def test_points_that_cannot_be_met_say_so(arm, tuned):
    goal = Goal(max_peak=1.8, min_kp=150.0)
    stiff = robot.tune([arm], goal, tuned.robot.case.groups, **QUICK)
    assert not stiff.feasible
    points = robot_front.front(stiff, 3)
    assert points[0].kp.min() >= 150.0 and points[-1].certified
    # Nothing softer is allowed, so that the front begins higher.
    assert points[0].goal.max_peak > robot_front.front(tuned, 2)[0].goal.max_peak + 0.3
