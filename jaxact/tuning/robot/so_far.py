"""What an interrupted search for a robot's gains has to show: the best that are certified.

A search knows many points by their peaks on a table of frequencies. Here the most promising of
them are evaluated exactly, all loops of each, until one meets every bound; then points between it
and a better one that does not quite. Where none does, the nearest one is led inside the bounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxact.parameters import KP
from jaxact.tuning.polish import MET
from jaxact.tuning.robot.exact import Exact, exact
from jaxact.tuning.robot.exchange import Candidate
from jaxact.tuning.robot.polishing import polished
from jaxact.tuning.robot.rows import Found, RobotCase

# Points that are evaluated: the best ones, and of the others those furthest inside the bounds.
_BEST, _SAFEST = 6, 3
# A point on the table that exceeds the bounds by more has nothing to be looked for [ln].
_NEAR = 0.5
# Points between one that is certified and a better one; how far before the bound they aim.
_BETWEEN, _SHORT = 4, 0.98
# Linear programmes that lead a point inside.
_INSIDE = 8
# Points this near each other are one [ln].
_SAME = 1e-9


def so_far(case: RobotCase, points: Sequence[Found]) -> Candidate | None:
    """The best certified gains among the points of a search, None where there are none.

    Args:
        case: with all loops that are known to matter.
        points: log-gains, with what the table says of them.
    """
    best, beyond = None, []
    for one in _promising(points):
        known = exact(case.table.loops, *case.groups.gains(one.x), case.goal.wanted)
        over = float(known.excess(case.goal).max(initial=-np.inf))
        if over <= MET:
            best = _candidate(case, one, known, over)
            break
        if np.isfinite(over):
            beyond.append((one, over))
    if best is None and beyond:
        return _led_inside(case, min(beyond, key=lambda one: one[1])[0])
    if best is None or not beyond:
        return best
    return _between(best, *beyond[0])


def _led_inside(case: RobotCase, found: Found) -> Candidate | None:
    """The bounds' side of a point where all loops are stable; None where that is not certified."""
    there = polished(case, found.x, aim=False, steps=_INSIDE)
    known = exact(case.table.loops, *case.groups.gains(there.x), case.goal.wanted)
    over = float(known.excess(case.goal).max(initial=-np.inf))
    return _candidate(case, there, known, over) if over <= MET else None


def _promising(points: Sequence[Found]) -> list[Found]:
    """The best of the points, then the safest."""
    ranked: list[Found] = []
    for one in sorted(points, key=Found.rank):
        if all(np.abs(one.x - other.x).max() > _SAME for other in ranked[-_BEST:]):
            ranked.append(one)
    near = [one for one in ranked if one.violation <= _NEAR]
    safe = sorted(near[_BEST:], key=lambda one: one.violation)
    return near[:_BEST] + safe[:_SAFEST]


def _candidate(case: RobotCase, found: Found, known: Exact, over: float) -> Candidate:
    goal = case.goal
    if goal.metric == KP:
        value = float(found.x[: len(case.groups)] @ case.groups.share)
    else:
        value = float(-np.max(-goal.sense * known.log[goal.metric]))
    return Candidate(case, replace(found, value=value, violation=over), None, known)


def _between(best: Candidate, beyond: Found, over: float) -> Candidate:
    """The best certified point on the way from one that is to one that exceeds its bounds.

    The bound is where a straight line through both excesses says; every point is evaluated.
    """
    case = best.case
    inside, outside = best.found.x, beyond.x
    for _ in range(_BETWEEN):
        under = min(best.found.violation, -MET)
        share = _SHORT * under / (under - over)
        x = inside + share * (outside - inside)
        known = exact(case.table.loops, *case.groups.gains(x), case.goal.wanted)
        here = float(known.excess(case.goal).max(initial=-np.inf))
        there = _candidate(case, replace(beyond, x=x), known, here)
        if here > MET:
            outside, over = x, min(here, 1.0)
        elif there.found.value > best.found.value:
            best, inside = there, x
        else:
            break
    return best
