"""The front of stiffness against robustness for a robot: the same goal for many peaks in turn.

It goes from the smallest peak that can be reached, which for many joints in contact is far from 1,
to well above the one that was asked for. Each point is polished from its neighbour's gains,
beginning with those of the goal itself, and is certified like them: loops that turned out to matter
for one point stay members for the next ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxact.analysis.robot.one_thread import one_thread
from jaxact.tuning.course import Told, silent
from jaxact.tuning.goal import HIGHEST, LOWEST, Goal, peaks
from jaxact.tuning.polish import MET
from jaxact.tuning.result import Tuned
from jaxact.tuning.robot import cores
from jaxact.tuning.robot.descent import approached, bounds
from jaxact.tuning.robot.exchange import Candidate, exchanged
from jaxact.tuning.robot.loops import Situation
from jaxact.tuning.robot.polishing import polished
from jaxact.tuning.robot.resting import settled
from jaxact.tuning.robot.rows import Found, RobotCase, more
from jaxact.tuning.robot.search import judge

# The front begins so far above the smallest peak, and ends so far above it or above the bound that
# was asked for.
_ABOVE, _HIGH, _FAR = 1.02, 2.0, 1.5
# Gains that a tighter bound leads to count as better from here on [ln].
_WORTH = 1e-6


@one_thread()
def front(tuned: Tuned, number: int, *, seed: int = 0, told: Told = silent) -> list[Tuned]:
    """The best gains for peaks from small to large, even in 1/M (`jaxact.tuning.goal.peaks`).

    Args:
        tuned: where it begins; its situations, groups and goal, whose own peak does not count.
        number: of points.
        seed: of the climbs in the box.
        told: what is being done.

    Returns:
        Nothing where no gains are known with which all loops are stable.

    Raises:
        UserError: fewer than two points.
    """
    peaks(number)
    robot = tuned.robot
    assert robot is not None
    groups, situations = robot.case.groups, robot.situations
    x = groups.log_gains(tuned.kp, tuned.kd)
    low, high = bounds(tuned.goal, groups, x)
    case = RobotCase(robot.case.table, groups, tuned.goal, low, high)
    if not case.stable(x):
        return []
    with cores.helped(worthwhile=case.takes_long):
        return _walked(situations, case, x, number, seed, told)


def _walked(
    situations: Sequence[Situation],
    case: RobotCase,
    x: np.ndarray,
    number: int,
    seed: int,
    told: Told,
) -> list[Tuned]:
    """The front from stable log-gains x on, those of the case's own goal."""
    closest = polished(_at(case, LOWEST), x)
    levels = _levels(case.goal, closest, number)

    points: dict[int, Candidate] = {}

    def of(case: RobotCase, x: np.ndarray, peak: float) -> Candidate:
        told("walking along the front", len(points), number)
        return _point(situations, _at(case, peak), x, seed)

    def beside(other: Candidate, peak: float) -> Candidate:
        """The point of a bound, starting from that of the bound next to it."""
        if not other.found.met and peak < other.case.goal.max_peak:
            # What comes nearest to a bound that cannot be met comes nearest to a tighter one, too.
            return replace(other, case=_at(other.case, peak))
        return of(other.case, other.found.x, peak)

    first = int(np.argmin(np.abs(np.log(levels) - np.log(min(case.goal.max_peak, levels[-1])))))
    points[first] = of(case, x, levels[first])
    for place in range(first + 1, number):
        points[place] = beside(points[place - 1], levels[place])
    for place in range(first - 1, -1, -1):
        points[place] = beside(points[place + 1], levels[place])
    if not points[0].found.met:
        other = of(points[0].case, closest.x, levels[0])
        points[0] = other if other.found.met else points[0]
    for place in range(1, number):
        if _behind(points[place], points[place - 1]):
            points[place] = of(points[place].case, points[place - 1].found.x, levels[place])
    judged = []
    for place in range(number):
        told("certifying the front", place, number)
        point, there = settled(points[place], situations, seed)
        judged.append(judge(there, point, seed))
    return judged


def _levels(goal: Goal, closest: Found, number: int) -> np.ndarray:
    """Peaks of the front; `closest` is what comes nearest to the lowest of all."""
    smallest = LOWEST * math.exp(max(closest.violation, 0.0))
    lowest = LOWEST if closest.violation <= MET else _ABOVE * smallest
    asked = goal.max_peak if math.isfinite(goal.max_peak) else 0.0
    return peaks(number, lowest, max(HIGHEST, _HIGH * smallest, _FAR * asked))


def _at(case: RobotCase, peak: float) -> RobotCase:
    return replace(case, goal=replace(case.goal, max_peak=float(peak)))


def _point(situations: Sequence[Situation], case: RobotCase, x: np.ndarray, seed: int) -> Candidate:
    """The best gains near log-gains x."""
    near = approached(case, x)
    found = more(polished(case, near.x), near.evaluations, near.steps)
    return exchanged(case, situations, found, seed)


def _behind(one: Candidate, tighter: Candidate) -> bool:
    """Whether the gains of a tighter bound are better than a point's own."""
    if not tighter.found.met:
        return False
    return not one.found.met or one.found.value < tighter.found.value - _WORTH
