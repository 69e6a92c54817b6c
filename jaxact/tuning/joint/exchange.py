"""What is worst in the box goes back to the search, until the gains hold for all of it.

The worst points found are members from then on, kept bounds or not: what is reported is the worst
that is known. Where one exceeds its bounds the gains are polished for it, and then searched for
once more from all over the plane: the best ones may now be elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jaxact.tuning.box import Points
from jaxact.tuning.certificate import Metrics
from jaxact.tuning.course import Course
from jaxact.tuning.goal import Goal
from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.ensemble import FIELDS, Ensemble, Uncertain, chosen, joined
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.joint.response import timed as timed_of
from jaxact.tuning.polish import MET, polish
from jaxact.tuning.result import Outcome, objective_value
from jaxact.tuning.worst import SMALL, Rise, Slopes, Worst, apart, named, screen, worst

# How often the worst points may join the members.
_EXCHANGES = 12

Search = Callable[[Case, np.ndarray], Outcome]
"""A case and log-gains, shape (2,), known to be good -> where a search from all over leads."""


def exchanged(
    plants: Uncertain, case: Case, found: Outcome, search: Search, seed: int, course: Course
) -> tuple[Case, Outcome]:
    """Members and gains once more, with the worst points of the box among the members.

    Args:
        plants: the box.
        case: with the members that were searched for.
        found: where that has led to.
        search: from all over the plane of gains.
        seed: of where in the box is looked.
        course: of the search.
    """
    number, first = len(case.members), found.gains

    def elsewhere(case: Case, found: Outcome) -> Outcome:
        """Where a search from all over leads with these members, for all of them."""
        course.phase("searching again with what is worst in the box")
        wide = search(_shortened(case, found, number), np.log(found.gains))
        gains = _polished(case, np.log(wide.gains), 0.0)
        return replace(
            wide, begun=found.begun, evaluations=found.evaluations + wide.evaluations,
            gains=gains or wide.gains, met=gains is not None,
            metrics=joint.metrics_at(case, np.log(gains or wide.gains)),
        )  # fmt: skip

    case, found = _held(plants, case, found, elsewhere, seed, course)
    if case.goal.tail or found.gains == first or not _certain(found):
        return case, found
    course.case, course.best = case, found
    other = elsewhere(case, found)
    if not (other.met and _better(case.goal, other, found)):
        return case, replace(found, evaluations=other.evaluations)
    again = _held(plants, case, other, elsewhere, seed + _EXCHANGES, course)
    return again if _better(case.goal, again[1], found) else (case, found)


def _certain(found: Outcome) -> bool:
    """Whether gains hold for all that is known of the box."""
    return found.met and found.interior is not None and found.interior <= MET


def _better(goal: Goal, one: Outcome, other: Outcome) -> bool:
    """Whether an outcome is better than another: what holds first, then the objective."""
    assert one.metrics is not None and other.metrics is not None
    excess = [max(0.0, float(each.metrics.excess(goal).max(initial=0.0))) for each in (one, other)]  # type: ignore[union-attr]
    if max(excess) > MET:
        return excess[0] < excess[1]
    value = [objective_value(goal, each.gains[0], each.metrics) for each in (one, other)]  # type: ignore[arg-type]
    return goal.sense * value[0] > goal.sense * value[1]


def _held(
    plants: Uncertain,
    case: Case,
    found: Outcome,
    elsewhere: Callable[[Case, Outcome], Outcome],
    seed: int,
    course: Course,
) -> tuple[Case, Outcome]:
    """Polished for the worst points of the box in turns, until none exceeds its bounds.

    Where no gains nearby meet them it goes on from elsewhere.
    """
    excess = 0.0
    for turn in range(_EXCHANGES + 1):
        course.phase("looking for the worst point of the box", turn, _EXCHANGES)
        case, found = _looked(plants, case, found, seed + turn)
        if course.best is None:
            course.case = case
        if case.goal.tail or not found.met or _certain(found) or turn == _EXCHANGES:
            break
        course.phase("polishing for what is worst in the box", turn, _EXCHANGES)
        assert found.interior is not None
        excess = 2.0 * found.interior if turn and found.interior < SMALL else excess
        x = np.log(found.gains)
        gains = _polished(case, x, excess)
        if gains is None:
            found = elsewhere(case, found)
        else:
            found = replace(found, gains=gains, metrics=joint.metrics_at(case, np.log(gains)))
        course.points.append(np.log(found.gains))
    return case, found


def _polished(case: Case, x: np.ndarray, tighter: float) -> tuple[float, float] | None:
    """The best gains near log-gains x for all members, None where none meet the bounds.

    Args:
        tighter: how much tighter the bounds are [ln].
    """
    case = replace(case, goal=case.goal.tightened(tighter)) if tighter else case
    low, high = joint.log_bounds(case.goal)
    problem = joint.problem([case], timed_of(case.goal, [case.members], use="polish"))
    polished = polish(problem, x[None], low[None], high[None])
    return joint.gains(polished.x[0]) if polished.feasible[0] else None


def _shortened(case: Case, found: Outcome, number: int) -> Case:
    """As many members as a search was compiled for: the worst ones, corners and interior first."""
    assert found.metrics is not None
    members = case.members
    excess = found.metrics.excess(case.goal)
    sampled = np.array([members.name(i).startswith("sample") for i in range(len(members))])
    order = np.lexsort((-excess, sampled))
    return replace(case, members=chosen(members, np.sort(order[:number])))


def _looked(plants: Uncertain, case: Case, found: Outcome, seed: int) -> tuple[Case, Outcome]:
    """The members with the worst points of the box among them, and what is known of all."""
    known = found.metrics
    assert known is not None
    inside = worst_inside(plants, case, np.log(found.gains), seed)
    found = replace(found, interior=inside.largest)
    highest = [known.over(name, sign, bound).max() for _, name, sign, bound in case.goal.rows]
    worse = [one for one, over, own in zip(inside.fraction, inside.excess, highest, strict=True)
             if over > own]  # fmt: skip
    if not worse or case.goal.tail:
        return case, found
    worse += list(inside.peaks(MET))
    fraction = apart(worse)
    more = plants.at(Points(fraction, _names(plants, fraction)))
    own = joint.metrics_at(Case(more, case.goal), np.log(found.gains))
    metrics = Metrics(
        np.concatenate([known.stable, own.stable]),
        {name: np.concatenate([log, own.log[name]]) for name, log in known.log.items()},
    )
    return replace(case, members=joined(case.members, more)), replace(found, metrics=metrics)


def _names(plants: Uncertain, fraction: np.ndarray) -> tuple[str, ...]:
    """What points of the box are called: by their values."""
    values = plants.low + (plants.high - plants.low) * fraction
    return named("interior", [one.name for one in plants.box.ranges], values)


def worst_inside(plants: Uncertain, case: Case, x: np.ndarray, seed: int) -> Worst:
    """The worst points of the box at log-gains x, the members among them."""
    size = len(plants.box)
    if not case.goal.rows:
        return Worst(np.empty((0, size)), np.empty(0))
    points = np.concatenate([fractions(plants, case.members), screen(size, seed)])
    return worst(_riser(plants, case.goal, x), points, seed)


def fractions(plants: Uncertain, members: Ensemble) -> np.ndarray:
    """Where members are in the box, shape (n, ranges)."""
    values = np.stack(
        [getattr(members, FIELDS[one.name]) - members.base(one.name) for one in plants.box.ranges],
        axis=1,
    )
    # Of factors on a negative stiffness the second end is the lower one.
    return np.clip((values - plants.low) / (plants.high - plants.low), 0.0, 1.0)


def _riser(plants: Uncertain, goal: Goal, x: np.ndarray) -> Rise:
    """By how much each bound is exceeded over the box at log-gains x."""
    columns, span = plants.columns, plants.high - plants.low

    def rise(u: np.ndarray) -> tuple[np.ndarray, Slopes]:
        found = joint.exact([Case(plants.at(Points(u, ())), goal)], x[None])
        over = [sign * (found.log[name][0] - np.log(bound)) for _, name, sign, bound in goal.rows]
        height = np.stack(over, axis=1)
        height = np.where(np.isnan(height) | ~found.stable[0][:, None], np.inf, height)
        every = [sign * found.slope[name][0, :, 2:] for _, name, sign, _ in goal.rows]
        slope = np.nan_to_num(np.stack(every, axis=1)[..., columns] * span, posinf=0.0, neginf=0.0)
        return height, lambda index, row: slope[index, row]

    return rise
