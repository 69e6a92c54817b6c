"""What only the exact metrics and the ascent on the uncertainty know of goes back to the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxact.tuning.course import Course
from jaxact.tuning.polish import MET
from jaxact.tuning.robot.exact import Exact, exact, worst_inside
from jaxact.tuning.robot.loops import OpenLoops, Situation, open_loops, together
from jaxact.tuning.robot.peaks import extended, growth_rates, refined, tabulate
from jaxact.tuning.robot.rows import OUT_OF_REACH, Found, RobotCase, excess, more, polished, rescued

# How often it does, and how far a peak may be off where the bounds cannot be met anyway [ln], or
# are out of reach.
_EXCHANGES, _OFF, _FAR_OFF = 12, 1e-3, 0.02


@dataclass(frozen=True)
class Candidate:
    """Where a search has led.

    Attributes:
        case: with all loops and frequencies that turned out to matter.
        found: the best point.
        interior: largest excess that ascent on the uncertainty found there, None if there was none.
        known: exact metrics of all loops there, None where they are not known.
    """

    case: RobotCase
    found: Found
    interior: float | None
    known: Exact | None


def exchanged(
    case: RobotCase,
    situations: Sequence[Situation],
    found: Found,
    seed: int,
    course: Course | None = None,
) -> Candidate:
    """Go on from a point with what only the exact metrics and the ascent on the box know of.

    Args:
        case: with the loops that are known.
        situations: of the robot.
        found: where the search has led to.
        seed: of where the ascent begins.
        course: of the search; None where nobody looks on.
    """
    course = course or Course()
    interior, known = None, None
    for turn in range(_EXCHANGES):
        course.case, course.points = case, [*course.points, found]
        course.phase("certifying", turn, _EXCHANGES)
        known = exact(case.table.loops, *case.groups.gains(found.x), case.goal.wanted)
        over = known.excess(case.goal).max(initial=-np.inf)
        if not np.isfinite(over):
            break
        far = found.violation > OUT_OF_REACH
        near = MET if found.met else _FAR_OFF if far else _OFF
        if over > max(found.violation, 0.0) + near:
            angles = np.stack([known.angle[name] for name in case.goal.wanted], axis=1)
            case = replace(case, table=refined(case.table, np.maximum(angles, 1e-9)))
        elif far:
            break
        else:
            # The ascent takes longest: only where nothing else is left.
            course.phase("looking for the worst point of the box", turn, _EXCHANGES)
            beyond = max(found.violation, 0.0) + near
            more = inside_worse(case, situations, found.x, beyond, seed, turn)
            if more is None:
                break
            interior, loops = more
            if not len(loops):
                break
            case = replace(case, table=extended(case.table, loops))
        course.phase("polishing for what the certificate adds", turn, _EXCHANGES)
        found, known = _polished_again(case, situations, found), None
    return Candidate(case, found, interior, known)


def inside_worse(
    case: RobotCase,
    situations: Sequence[Situation],
    x: np.ndarray,
    beyond: float,
    seed: int,
    turn: int = 0,
) -> tuple[float, OpenLoops] | None:
    """The largest excess that ascent finds in the box, and loops worse than those that are known.

    Args:
        x: log-gains.
        beyond: excess from which a loop is worse.
        seed: of where the ascent begins.
        turn: how many loops have been found so before, for their names.

    Returns:
        None where nothing is uncertain, or nothing bounded.
    """
    if not case.goal.rows or not len(situations[0].box):
        return None
    gains = case.groups.gains(x)
    points = worst_inside(situations, case, x, seed)
    inside = together(*(
        open_loops([one], own) for one, own in zip(situations, points, strict=True)
    ))  # fmt: skip
    inside = _renamed(inside, situations, turn)
    own = replace(case, table=tabulate(inside))
    stable = growth_rates(inside, *gains) < 0.0
    over = np.where(stable, excess(own, x), np.inf)
    order = np.argsort(-over)
    worse = order[over[order] > beyond]
    return float(over.max()), inside.take(_apart(inside, worse))


def _polished_again(case: RobotCase, situations: Sequence[Situation], found: Found) -> Found:
    """Polished once more, for more loops or frequencies."""
    x = found.x
    if not case.stable(x):
        lag = max(one.lag for one in situations)
        x, _ = rescued(case.table.loops, case.groups, x, lag, case.low, case.high)
        if not case.stable(x):
            return replace(found, x=x, violation=np.inf)
    return more(polished(case, x, fresh=False), found.evaluations, found.steps)


def _renamed(loops: OpenLoops, situations: Sequence[Situation], turn: int) -> OpenLoops:
    """Loops of one situation each, put back to their situations."""
    each = len(loops) // len(situations)
    number = [place for place in range(len(situations)) for _ in range(each)]
    names = tuple(
        f"{situations[s].name}, interior {turn}.{i % each}" if len(situations) > 1
        else f"interior {turn}.{i}"
        for i, s in enumerate(number)
    )  # fmt: skip
    return replace(loops, names=names, situation=np.array(number))


def _apart(loops: OpenLoops, worse: np.ndarray) -> np.ndarray:
    """The worst of these, one of each place in the box; three of a situation at most."""
    kept: list[int] = []
    for index in map(int, worse):
        same = [k for k in kept if loops.situation[k] == loops.situation[index]]
        near = any(np.abs(loops.fraction[k] - loops.fraction[index]).max() < 0.02 for k in same)
        if not near and len(same) < 3:
            kept.append(index)
    return np.array(kept, dtype=int)
