"""The best log-gains of a robot near some: the polish of `jaxact.tuning.polish`, in stages.

The rows of all loops at all frequencies take long; those that matter are found on the way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from jaxact.parameters import KP
from jaxact.tuning.newton import inside, newton
from jaxact.tuning.polish import MET, Polished, Problem, Rows, polish
from jaxact.tuning.robot.peaks import columns, growth_rates
from jaxact.tuning.robot.rows import Found, RobotCase, excess, more, part, rows, seen

_ROUNDS = 12
# Points before whose rows count as well: at each, few of many singular values are rows.
_MEMORY = 12
# A point that exceeds the bounds by less may be gone on from, whatever was missed [ln].
_SLIGHT = 0.03
# One that exceeds them by less is stuck, sooner than at the least that is possible [ln]; it goes on
# from where bounds lead to that are tighter by these multiples of what is missed.
_STUCK, _TIGHTER = 1e-3, (2.0, 8.0)
# Step of difference quotients of slopes.
_APART = 1e-4
# No optimum is further inside all bounds than this [ln].
_SLACK = 1e-5
# How far inside the bounds the polish aims [ln]: peaks are refined to a few 1e-10.
_SHY = 1e-9


@dataclass(frozen=True)
class _Stage:
    """How closely the polish looks.

    Attributes:
        idle: loops that far inside the bounds are looked at only now and then [ln].
        depth: frequencies that far below the highest peak are not either [ln].
        steps: linear programmes.
        worth: of a step [ln].
        radius: of the trust region to begin with.
    """

    idle: float
    depth: float
    steps: int
    worth: float
    radius: float


_COARSE = _Stage(idle=0.35, depth=0.5, steps=8, worth=3e-3, radius=0.15)
_MIDDLE = _Stage(idle=0.2, depth=0.35, steps=40, worth=3e-4, radius=0.05)
_FINE = _Stage(idle=0.06, depth=0.2, steps=50, worth=1e-8, radius=0.02)


def polished(
    case: RobotCase,
    x: np.ndarray,
    *,
    aim: bool = True,
    steps: int = _COARSE.steps,
    fresh: bool = True,
    fine: bool = True,
) -> Found:
    """The best log-gains near x, where all loops are stable.

    Args:
        aim: False leaves the objective out.
        steps: most linear programmes, of those that take large steps.
        fresh: False where x is nearly the best already.
        fine: False leaves out the last digits.
    """
    first = replace(_COARSE, steps=steps) if fresh else _FINE
    found = _polished(case, x, first, aim=aim, fine=fine)
    for times in _TIGHTER if aim and fine else ():
        if found.met or found.violation > _STUCK:
            break
        found = _from_inside(case, found, times * found.violation)
    return found


def _from_inside(case: RobotCase, found: Found, tighter: float) -> Found:
    """The same, or better: where the polish leads from gains that tighter bounds lead to.

    Where several peaks are level it ends a little beyond the bounds, whatever the bounds are.

    Args:
        tighter: how much tighter they are [ln].
    """
    own = replace(case, goal=case.goal.tightened(tighter))
    inside = _polished(own, found.x, _FINE)
    ends = [found, more(seen(case, inside.x), inside.evaluations, inside.steps)]
    if ends[-1].met:
        ends.append(_polished(case, inside.x, _FINE))
    spent = {"evaluations": sum(one.evaluations for one in ends),
             "steps": sum(one.steps for one in ends)}  # fmt: skip
    return replace(min(ends, key=Found.rank), **spent)


def _polished(
    case: RobotCase, x: np.ndarray, stage: _Stage, *, aim: bool = True, fine: bool = True
) -> Found:
    """The same, once, from some stage on.

    Only loops that are near their bounds are computed at every step, and at the frequencies of
    their peaks; all are looked at in between, and join if they turn out to matter.
    """
    over = excess(case, x)
    near = np.zeros(len(over), bool)
    kept = np.zeros(case.table.angle.shape[1], bool)
    tried, number = len(over), 0
    for _ in range(_ROUNDS):
        near |= over > over.max(initial=-np.inf) - stage.idle
        kept |= _columns(case, near, x, stage)
        found, looked = _stage(case, near, kept, x, stage, aim)
        number, tried = number + found.evaluations, tried + looked + len(over)
        there = found.x[0]
        growth = growth_rates(case.table.loops, *case.groups.gains(there))
        if not (growth < 0.0).all():
            # From where all were stable once more, with those that were lost; at all frequencies
            # where a few did not show that they were.
            kept |= (near & (growth >= 0.0)).any()
            near |= growth >= 0.0
            continue
        beyond = excess(case, there)
        missed = beyond > max(float(found.violation[0]), 0.0) + _SHY
        near |= missed
        kept |= _columns(case, near, there, stage)
        if not missed.any() or beyond.max() <= max(over.max(), _SLIGHT):
            x, over = there, beyond
            last = stage is _FINE or not (aim and fine)
            if not missed.any() and last:
                break
            stage = stage if last else _MIDDLE if stage.steps < _MIDDLE.steps else _FINE
    # Where it begins all loops are stable, and everywhere that it went on from.
    whole = rows(case, x, aim=aim, anchors=[case.groups.gains(x)])
    return Found(x, float(whole.worst_value[0]), float(whole.violation[0]), tried, number)


def _columns(case: RobotCase, near: np.ndarray, x: np.ndarray, stage: _Stage) -> np.ndarray:
    """Which frequencies of the table a stage needs for some of the loops."""
    table = case.table.take(np.flatnonzero(near))
    return columns(table, *case.groups.gains(x), case.goal.wanted, stage.depth)


def _stage(
    case: RobotCase,
    near: np.ndarray,
    kept: np.ndarray,
    x: np.ndarray,
    stage: _Stage,
    aim: bool,
) -> tuple[Polished, int]:
    """Polish some of the loops at some of the frequencies; and how many loops were computed."""
    index = np.flatnonzero(near)
    own = replace(case, table=case.table.take(index, np.flatnonzero(kept)))
    of = problem(own, aim=aim)
    if stage is _FINE and aim and case.goal.metric == KP:
        found = newton(of, partial(_curvature, own), x, case.low, case.high)
        if -_SLACK < found.violation[0] <= MET:
            return found, found.evaluations * len(index)
    found = polish(
        of, x[None], case.low[None], case.high[None],
        steps=stage.steps, worth=stage.worth, radius=stage.radius, kinks=False, memory=_MEMORY,
    )  # fmt: skip
    if aim and found.end is not None and (found.end != found.x).any():
        found = inside(of, found.end[0], found, case.low, case.high)
    return found, found.evaluations * len(index)


def _curvature(case: RobotCase, x: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Second derivatives of the constraints, weighted, by differences of their slopes."""
    each = weights.reshape(len(case.goal.rows), len(case.table.loops), -1)
    own = np.flatnonzero(each.any(axis=(0, 2)))
    if not own.size:
        return np.zeros((len(x), len(x)))
    few, heavy = part(case, own), each[:, own].ravel()
    anchors = [case.groups.gains(x)]

    def slope(x: np.ndarray) -> np.ndarray:
        return heavy @ rows(few, x, aim=False, anchors=anchors).excess_slope[0]

    here = slope(x)
    found = np.array([(slope(x + _APART * unit) - here) / _APART for unit in np.eye(len(x))])
    return 0.5 * (found + found.T)


def problem(case: RobotCase, *, aim: bool = True) -> Problem:
    """The rows as a function of the log-gains, for the polish of one case."""

    anchors: list[tuple[np.ndarray, np.ndarray]] = []

    def of(x: np.ndarray) -> Rows:
        return rows(case, x[0], aim=aim, shy=_SHY, anchors=anchors)

    return of
