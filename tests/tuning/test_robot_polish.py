"""What the polish of a robot's gains does where it ends a little beyond the bounds."""

from dataclasses import replace

import numpy as np
import pytest
from arms import at_home

from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import group
from jaxact.tuning.robot import polishing
from jaxact.tuning.robot.descent import bounds, usual
from jaxact.tuning.robot.open_loops import open_loops
from jaxact.tuning.robot.peaks import tabulate
from jaxact.tuning.robot.rows import RobotCase, seen

PEAK = 1.8


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    one = at_home(tmp_path_factory.mktemp("robots"))
    groups, goal = group([], one.names), Goal(max_peak=PEAK)
    low, high = bounds(goal, groups, usual([one], groups))
    loops = open_loops([one], one.box.members(1, 0))
    return RobotCase(tabulate(loops), groups, goal, low, high)


@pytest.fixture(scope="module")
def best(case):
    """Where the polish leads from usual gains, and its steps without what they are called by."""
    x = 0.5 * (case.low + case.high)
    found = polishing.polished(case, x)
    assert found.met
    return found


def _highest(case, x, points=4000):
    """The largest singular value of S and T on a fine grid, by dense solves."""
    kp, kd = case.groups.gains(x)
    M, N, C = case.table.loops.closed(0, kp, kd)
    assert np.abs(np.linalg.eigvals(M)).max() < 1.0
    z = np.exp(1j * np.pi * np.geomspace(1e-4, 1.0, points))[:, None, None]
    S = np.eye(len(kp)) + C @ np.linalg.solve(z * np.eye(len(M)) - M, N[None].astype(complex))
    both = np.concatenate([S, np.eye(len(kp)) - S])
    return float(np.linalg.norm(both, 2, axis=(1, 2)).max())


class _Stuck:
    """The polish, which ends too far by some in every gain; how often, and for which bounds."""

    def __init__(self, monkeypatch, ends):
        self.ends, self.asked, self.polish = ends, [], polishing._polished
        monkeypatch.setattr(polishing, "_polished", self)

    def __call__(self, case, x, *stage, **options):
        self.asked.append(case.goal.max_peak)
        found = self.polish(case, x, *stage, **options)
        if len(self.asked) > self.ends:
            return found
        return seen(case, found.x + 2e-4)


def test_gains_that_miss_a_bound_by_a_little_go_on_from_inside(case, best, monkeypatch):
    stuck = _Stuck(monkeypatch, 1)
    found = polishing.polished(case, best.x)
    assert found.met and found.value == pytest.approx(best.value, abs=1e-4)
    assert PEAK * (1.0 - 1e-4) < _highest(case, found.x) <= PEAK * (1.0 + 1e-9)
    assert stuck.asked[0] == stuck.asked[-1] == PEAK > stuck.asked[1]


def test_a_polish_that_always_ends_beyond_its_bounds_is_asked_for_tighter_ones(
    case, best, monkeypatch
):
    stuck = _Stuck(monkeypatch, 99)
    found = polishing.polished(case, best.x)
    # What it misses by is made up for.
    assert found.met and _highest(case, found.x) <= PEAK * (1.0 + 1e-9)
    assert len(stuck.asked) == 3


def test_what_cannot_be_met_is_not_tried_for_long(case, best, monkeypatch):
    stuck = _Stuck(monkeypatch, 0)
    far = replace(case, goal=Goal(max_peak=1.02))
    found = polishing.polished(far, best.x)
    assert not found.met and found.violation > 1e-3
    assert len(stuck.asked) == 1
