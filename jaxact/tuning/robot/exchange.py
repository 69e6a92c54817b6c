"""What only the exact metrics and the worst points of the box know of goes back to the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxact.tuning.box import Points
from jaxact.tuning.course import Course
from jaxact.tuning.polish import MET
from jaxact.tuning.robot.exact import Exact, exact
from jaxact.tuning.robot.inside import worst_inside
from jaxact.tuning.robot.loops import Situation
from jaxact.tuning.robot.open_loops import OpenLoops, open_loops, together
from jaxact.tuning.robot.peaks import extended, refined
from jaxact.tuning.robot.polishing import polished
from jaxact.tuning.robot.rows import OUT_OF_REACH, Found, RobotCase, more, rescued, seen
from jaxact.tuning.worst import SMALL, apart, named

# How often it does, and how far a peak may be off where the bounds cannot be met anyway [ln], or
# are out of reach.
_EXCHANGES, _OFF, _FAR_OFF = 12, 1e-3, 0.02


@dataclass(frozen=True)
class Candidate:
    """Where a search has led.

    Attributes:
        case: with all loops and frequencies that turned out to matter.
        found: the best point.
        interior: largest excess in the box that was found there, None if it was not looked for.
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
    """Go on from a point with what only the exact metrics and the worst points of the box know of.

    Args:
        case: with the loops that are known.
        situations: of the robot.
        found: where the search has led to.
        seed: of where the climbs in the box begin.
        course: of the search; None where nobody looks on.
    """
    course = course or Course()
    interior, known, tighter = None, None, 0.0
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
            # The climbs take longest: only where nothing else is left.
            course.phase("looking for the worst point of the box", turn, _EXCHANGES)
            inside = inside_worse(case, situations, found.x, known, seed + turn)
            if inside is None:
                break
            interior = inside.excess
            if len(inside.loops):
                case = replace(case, table=extended(case.table, inside.loops))
                known = known.joined(inside.known)
            if interior <= max(found.violation, 0.0) + near:
                break
            tighter = 2.0 * interior if turn and found.met and interior < SMALL else tighter
        course.phase("polishing for what the certificate adds", turn, _EXCHANGES)
        found, known = polished_again(case, situations, found, tighter), None
    return Candidate(case, found, interior, known)


@dataclass(frozen=True)
class Inside:
    """The worst points of the box that were found.

    Attributes:
        excess: the largest, exact, inf where a loop is unstable.
        loops: those of them that are worse than what was known.
        known: their exact metrics.
    """

    excess: float
    loops: OpenLoops
    known: Exact


def inside_worse(
    case: RobotCase, situations: Sequence[Situation], x: np.ndarray, known: Exact, seed: int
) -> Inside | None:
    """The worst points of the box, as climbing in it finds them.

    Args:
        case: what is known.
        situations: of the robot.
        x: log-gains.
        known: exact metrics of the loops of the case there.
        seed: of where one begins.

    Returns:
        None where nothing is uncertain, or nothing bounded.
    """
    if not case.goal.rows or not len(situations[0].box):
        return None
    found = worst_inside(situations, case, x, seed)
    highest = [known.over(name, sign, bound).max() for _, name, sign, bound in case.goal.rows]
    parts = []
    for place, (one, own) in enumerate(zip(situations, found, strict=True)):
        fraction = apart([*own.fraction, *own.peaks(MET)])
        points = Points(fraction, _names(one, fraction, len(situations)))
        part = open_loops([one], points)
        parts.append(replace(part, situation=np.full(len(part), place)))
    loops = together(*parts)
    inside = exact(loops, *case.groups.gains(x), case.goal.wanted)
    over = [inside.over(name, sign, bound) for _, name, sign, bound in case.goal.rows]
    worse = [own > most for own, most in zip(over, highest, strict=True)]
    kept = np.flatnonzero(np.any(worse, axis=0))
    return Inside(float(inside.excess(case.goal).max()), loops.take(kept), inside.take(kept))


def polished_again(
    case: RobotCase, situations: Sequence[Situation], found: Found, tighter: float
) -> Found:
    """Polished once more, for more loops or frequencies.

    Args:
        case: with these.
        situations: of the robot.
        found: where the search has led to.
        tighter: how much tighter the bounds are [ln].
    """
    x = found.x
    if not case.stable(x):
        lag = max(one.lag for one in situations)
        x, _ = rescued(case.table.loops, case.groups, x, lag, case.low, case.high)
        if not case.stable(x):
            return replace(found, x=x, violation=np.inf)
    own = replace(case, goal=case.goal.tightened(tighter)) if tighter else case
    again = polished(own, x, fresh=False)
    again = more(seen(case, again.x), again.evaluations, again.steps) if tighter else again
    return more(again, found.evaluations, found.steps)


def _names(one: Situation, fraction: np.ndarray, situations: int) -> tuple[str, ...]:
    """What points of the box are called in a situation: by their values."""
    first = [int(np.argmax(one.places == place)) for place in range(len(one.box))]
    before = f"{one.name}, interior" if situations > 1 else "interior"
    return named(before, [each.name for each in one.box.ranges], one.values(fraction)[:, first])
