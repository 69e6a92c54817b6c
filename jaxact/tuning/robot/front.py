"""The front of stiffness against robustness for a robot: the same goal for many peaks in turn.

It goes from the smallest peak that can be reached, which for many joints in contact is far from 1,
to well above the one that was asked for. Each point is polished from its neighbour's gains,
beginning with those of the goal itself, and is certified like them: loops that turned out to matter
for one point stay members for the next ones.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxact.tuning.goal import Goal
from jaxact.tuning.pareto import HIGHEST, LOWEST, peaks
from jaxact.tuning.polish import MET
from jaxact.tuning.robot.descent import approached, bounds
from jaxact.tuning.robot.exchange import Reached, exchanged
from jaxact.tuning.robot.loops import Situation
from jaxact.tuning.robot.rows import Found, RobotCase, more, polished
from jaxact.tuning.robot.tuned import RobotTuned, Spent, judged, no_path

# The front begins so far above the smallest peak, and ends so far above it or above the bound that
# was asked for.
_ABOVE, _HIGH, _FAR = 1.02, 2.0, 1.5
# Gains that a tighter bound leads to count as better from here on [ln].
_WORTH = 1e-6


@dataclass(frozen=True)
class _Point:
    """A point of a front: where its search has led, and that judged."""

    reached: Reached
    tuned: RobotTuned

    @property
    def met(self) -> bool:
        return self.reached.found.violation <= MET


def front(tuned: RobotTuned, number: int, *, seed: int = 0) -> list[RobotTuned]:
    """The best gains for peaks from small to large, even in 1/M (`jaxact.tuning.pareto.peaks`).

    tuned: where it begins; its situations, groups and goal, whose own peak does not count
    number: of points
    seed: of the ascent on the uncertainty

    Returns nothing where no gains are known with which all loops are stable. Raises UserError for
    fewer than two points.
    """
    peaks(number)
    x = tuned.groups.log_gains(tuned.kp, tuned.kd)
    low, high = bounds(tuned.goal, tuned.groups, x)
    case = RobotCase(tuned.table, tuned.groups, tuned.goal, low, high)
    if not case.stable(x):
        return []
    closest = polished(_at(case, LOWEST), x)
    levels = _levels(tuned.goal, closest, number)

    def of(case: RobotCase, x: np.ndarray, peak: float) -> _Point:
        return _point(tuned.situations, _at(case, peak), x, seed)

    def beside(other: _Point, peak: float) -> _Point:
        """The point of a bound, starting from that of the bound next to it."""
        own = other.reached
        if not other.met and peak < own.case.goal.max_peak:
            # What comes nearest to a bound that cannot be met comes nearest to a tighter one, too.
            reached = replace(own, case=_at(own.case, peak))
            return _judged(tuned.situations, reached, time.perf_counter())
        return of(own.case, own.found.x, peak)

    first = int(np.argmin(np.abs(np.log(levels) - np.log(min(tuned.goal.max_peak, levels[-1])))))
    points = {first: of(case, x, levels[first])}
    for place in range(first + 1, number):
        points[place] = beside(points[place - 1], levels[place])
    for place in range(first - 1, -1, -1):
        points[place] = beside(points[place + 1], levels[place])
    if not points[0].met:
        other = of(points[0].reached.case, closest.x, levels[0])
        points[0] = other if other.met else points[0]
    for place in range(1, number):
        if _behind(points[place], points[place - 1]):
            beginning = points[place - 1].reached.found.x
            points[place] = of(points[place].reached.case, beginning, levels[place])
    return [points[place].tuned for place in range(number)]


def _levels(goal: Goal, closest: Found, number: int) -> np.ndarray:
    """Peaks of the front; `closest` is what comes nearest to the lowest of all."""
    smallest = LOWEST * math.exp(max(closest.violation, 0.0))
    lowest = LOWEST if closest.violation <= MET else _ABOVE * smallest
    asked = goal.max_peak if math.isfinite(goal.max_peak) else 0.0
    return peaks(number, lowest, max(HIGHEST, _HIGH * smallest, _FAR * asked))


def _at(case: RobotCase, peak: float) -> RobotCase:
    return replace(case, goal=replace(case.goal, max_peak=float(peak)))


def _point(situations: Sequence[Situation], case: RobotCase, x: np.ndarray, seed: int) -> _Point:
    """The best gains near log-gains x."""
    begun = time.perf_counter()
    near = approached(case, x)
    found = more(polished(case, near.x), near.evaluations, near.steps)
    return _judged(situations, exchanged(case, situations, found, seed), begun)


def _judged(situations: Sequence[Situation], reached: Reached, begun: float) -> _Point:
    found = reached.found
    spent = Spent(found.evaluations, found.steps, begun)
    return _Point(reached, judged(situations, reached, no_path(found.x), spent))


def _behind(one: _Point, tighter: _Point) -> bool:
    """Whether the gains of a tighter bound are better than a point's own."""
    if not tighter.met:
        return False
    return not one.met or one.reached.found.value < tighter.reached.found.value - _WORTH
