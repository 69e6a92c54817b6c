"""Tuned gains where the robot rests with them.

Under a payload that its controllers do not know of a robot gives way as far as its stiffness lets
it, and what is linear there depends on where that is. A search with unknown stiffness takes what
stiff joints would hold. Its gains are taken to where every member rests with them; if the bounds
are missed there, the search goes on from them, with the members left there,

    x(k+1) = best(members at rest with x(k)),

until the members at rest with the new gains meet the bounds, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from jaxact.tuning.box import Points
from jaxact.tuning.course import Course
from jaxact.tuning.polish import MET
from jaxact.tuning.robot.exact import exact
from jaxact.tuning.robot.exchange import Candidate, exchanged, inside_worse, polished_again
from jaxact.tuning.robot.loops import Situation
from jaxact.tuning.robot.open_loops import OpenLoops, open_loops, together
from jaxact.tuning.robot.peaks import tabulate
from jaxact.tuning.robot.rows import RobotCase

# Turns at most; and how much tighter bounds are asked of the later ones than was missed before.
TURNS, _TIGHTER = 6, 2.0
# More than this [ln] is missed because gains move, not because members do with the last digits.
_SMALL = 1e-3


def gives_way(situations: Sequence[Situation]) -> bool:
    """Whether a member of some situation rests elsewhere than the nominal robot."""
    return any(one.gives_way for one in situations)


def at_rest(
    case: RobotCase, situations: Sequence[Situation], kp: np.ndarray
) -> tuple[RobotCase, tuple[Situation, ...]]:
    """A case and situations, with every member where it rests.

    Args:
        case: of these situations, with any members.
        situations: of the robot.
        kp: stiffness of the joints [N/m or N m/rad], shape (joints,).
    """
    there = tuple(one.resting(kp) if one.gives_way else one for one in situations)
    loops = case.table.loops
    parts: list[OpenLoops] = []
    for place, one in enumerate(there):
        own = loops.situation == place
        names = tuple(name for name, kept in zip(loops.names, own, strict=True) if kept)
        part = open_loops([one], Points(loops.fraction[own], names))
        parts.append(replace(part, situation=np.full(len(part), place)))
    return replace(case, table=tabulate(together(*parts))), there


def settled(
    best: Candidate,
    situations: Sequence[Situation],
    seed: int,
    course: Course | None = None,
    turns: int = TURNS,
) -> tuple[Candidate, tuple[Situation, ...]]:
    """Gains that keep the bounds where every member rests with them, and the situations there.

    As they are where nothing gives way. Where the last turn misses a bound, it is not met.

    Args:
        best: where a search has led.
        situations: of the robot.
        seed: of the climbs in the box.
        course: of the search; None where nobody looks on.
        turns: at most; with one the gains stay.
    """
    if not gives_way(situations):
        return best, tuple(situations)
    course = course or Course()
    wanted, goal, tighter = best.case.goal.wanted, best.case.goal, 0.0
    was_met = best.found.met
    for turn in range(turns):
        course.phase("certifying where the members rest with these gains", turn, turns)
        found = best.found
        gains = best.case.groups.gains(found.x)
        case, there = at_rest(best.case, situations, gains[0])
        known = exact(case.table.loops, *gains, wanted)
        over = float(known.excess(goal).max(initial=-np.inf))
        interior = None
        if over <= MET:
            inside = inside_worse(case, there, found.x, known, seed + turn)
            interior = None if inside is None else inside.excess
            over = over if inside is None else max(over, inside.excess)
        found = replace(found, violation=over if np.isfinite(over) else np.inf)
        best = Candidate(case, found, interior, known)
        if found.met or turn == turns - 1 or not (was_met or turn < 1):
            break
        course.phase("polishing where the members rest with these gains", turn, turns)
        tighter = max(tighter, _TIGHTER * over) if turn and over < _SMALL else tighter
        own = replace(case, goal=goal.tightened(tighter)) if tighter else case
        again = exchanged(own, there, polished_again(own, there, found, 0.0), seed, course)
        was_met = again.found.met
        best = replace(again, case=replace(again.case, goal=goal), known=None)
    return best, there


def unheld(loops: OpenLoops, situations: Sequence[Situation], kp: np.ndarray) -> str:
    """The first member that does not rest with a stiffness, and why, in words; "" for none.

    Its linear loop says nothing of it where a limit of the force is too low for its weight.
    """
    for fraction, name, place in zip(loops.fraction, loops.names, loops.situation, strict=True):
        one = situations[place]
        if one.gives_way and (why := one.leaves(one.values(fraction[None])[0], kp)):
            return f"{one.name}, {name}: {why}"
    return ""
