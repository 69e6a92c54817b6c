"""Where the search for a robot's gains begins, and how it goes on: starts, descent, polish."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.errors import UserError
from jaxact.tuning.course import Course
from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import Groups
from jaxact.tuning.joint.problem import STARTS as TABLE
from jaxact.tuning.optimise import Descended, Descent, descend
from jaxact.tuning.polish import MET
from jaxact.tuning.robot import cores, smooth
from jaxact.tuning.robot.loops import Situation
from jaxact.tuning.robot.polishing import polished
from jaxact.tuning.robot.rows import Found, RobotCase, excess, part, rescued, seen
from jaxact.tuning.robot.starts import closer

# Log-gains stay this near to where the search begins.
_REACH = 8.0
# Bounds exceeded by more than this are the boundary's doing [ln]; linear programmes away from it.
_BESIDE, _APPROACH = 1.5, 4
# Points that are polished roughly, how far apart they are [ln], and how many of them to the end
# where none meets the bounds.
_POLISHED, _SAME, _CLOSEST = 4, 0.05, 2
# Bounds exceeded by less are met in the end [ln], at that price in the objective for each of it.
_NEARLY, _PRICE = 0.1, 2.0
# Where on a path that ended unstable to look for a stable point.
_BACKWARDS = (0.9, 0.75, 0.5, 0.25, 0.1, 0.0)


def least_inertias(situations: Sequence[Situation]) -> np.ndarray:
    """The joints' smallest effective inertias in any situation [kg or kg m^2], shape (m,).

    Of a joint that no force moves in any, such as one that stands at its limit, the largest of the
    others: it bears any gains.

    Raises:
        UserError: no force moves any joint.
    """
    found = np.min([one.inertias for one in situations], axis=0)
    moves = np.isfinite(found) & (found > 0.0)
    if not moves.any():
        raise UserError("no joint can be tuned: in this posture no force moves any of them")
    return np.where(moves, found, found[moves].max())


def usual(situations: Sequence[Situation], groups: Groups) -> np.ndarray:
    """Log-gains to begin with where none are known: moderate ones for the inertias and the lag."""
    lag = max(one.lag for one in situations)
    inertia = least_inertias(situations)
    a, b = TABLE[4]
    return groups.log_gains(b * inertia / lag**2, a * inertia / lag)


def bounds(goal: Goal, groups: Groups, *x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest log-gains, shape (2 g,) each: those of the goal, and not far from x.

    Args:
        x: one or more log-gains, shape (2 g,) each.
    """
    low, high = np.min(x, axis=0) - _REACH, np.max(x, axis=0) + _REACH
    kp = slice(0, len(groups))
    with np.errstate(divide="ignore"):
        least, most = np.log([goal.min_kp, goal.max_kp])
    low[kp] = np.maximum(np.minimum(low[kp], most - _REACH), least)
    high[kp] = np.minimum(np.maximum(high[kp], low[kp] + _REACH), most)
    return low, high


def stabilised(
    case: RobotCase, situations: Sequence[Situation], x: np.ndarray
) -> tuple[np.ndarray, int]:
    """Log-gains at which all loops are stable, as near x as they are found; and loops tried."""
    if case.stable(x):
        return x, len(case.table.loops)
    lag = max(one.lag for one in situations)
    plain = np.clip(usual(situations, case.groups), case.low, case.high)
    tried = 0
    for begin in (x, plain):
        there, steps = rescued(case.table.loops, case.groups, begin, lag, case.low, case.high)
        tried += steps * len(case.table.loops)
        if case.stable(there):
            break
    return there, tried


def approached(case: RobotCase, x: np.ndarray) -> Found:
    """x, or a point further from the boundary where x is beside it."""
    over = float(excess(case, x).max(initial=-np.inf))
    if over > _BESIDE:
        return polished(case, x, aim=False, steps=_APPROACH)
    return Found(x, -np.inf, max(over, 2.0 * MET), len(case.table.loops), 1)


def hardest(case: RobotCase, x: np.ndarray) -> RobotCase:
    """The same with a few loops only: the worst at x, and one at least of every situation."""
    over = excess(case, x)
    situation = case.table.loops.situation
    first = [int(np.flatnonzero(situation == s)[np.argmax(over[situation == s])])
             for s in np.unique(situation)]  # fmt: skip
    rest = [int(i) for i in np.argsort(-over) if int(i) not in first]
    chosen = (first + rest)[: max(smooth.LOOPS, len(first))]
    return part(case, np.sort(chosen))


def descended(case: RobotCase, first: np.ndarray, how: Descent) -> Descended:
    """Where the descent leads from several log-gains, shape (starts, 2 g), for a few loops."""
    points = min(smooth.POINTS, case.table.angle.shape[1])
    surrogate = smooth.RobotSurrogate(smooth.family(case.goal), len(case.table.loops), points)
    data = smooth.data(case.table, case.groups, case.goal, case.low, case.high, points)
    one = jax.tree.map(lambda leaf: leaf[None], data)
    still = np.zeros(first.shape[1], np.float32)
    found = descend(surrogate, one, jnp.asarray(first[None], jnp.float32), still, how)
    return jax.tree.map(lambda leaf: np.asarray(leaf[0]), found)


def best_of(case: RobotCase, near: Found, paths: Descended, others: Sequence[np.ndarray],
            course: Course) -> Found:  # fmt: skip
    """The best of all that is known, polished: ends of the descent, and where it began.

    Args:
        near: a point that is fine.
        others: log-gains at which all loops are stable, shape (k, 2 g).
        course: of the search.
    """
    ways = [_stable_end(case, paths, start) for start in range(len(paths.gains))]
    points = [
        near.x,
        *others,
        *(np.clip(end, case.low, case.high) for end in ways if end is not None),
    ]
    known = sorted((seen(case, x, stable=True) for x in points), key=_promise)
    course.points += known
    kept: list[Found] = []
    for one in known:
        if len(kept) < _POLISHED and all(np.abs(one.x - k.x).max() > _SAME for k in kept):
            kept.append(one)
    # Roughly first: the last digits of what loses take longest.
    rough = []
    ends = cores.spread(partial(polished, fine=False), [(case, one.x) for one in kept])
    for number in range(1, len(kept) + 1):
        course.phase(f"polishing end {number} of {len(kept)}", number - 1, len(kept))
        rough.append(next(ends))
        course.points.append(rough[-1])
    course.phase("polishing the best")
    last = _finely(case, rough)
    course.points += last
    best = min([*rough, *last], key=Found.rank)
    if not best.met and not best.out_of_reach:
        course.phase("looking around what comes nearest")
        last.append(polished(case, closer(case, best.x, course)))
        best = min(best, last[-1], key=Found.rank)
    spent = [*known, *rough, *last]
    return replace(
        best,
        evaluations=sum(one.evaluations for one in spent),
        steps=sum(one.steps for one in spent),
    )


def _promise(one: Found) -> tuple[bool, float]:
    """Smaller is better: what nearly meets the bounds by its value once it does, then as `rank`."""
    beyond = max(one.violation, 0.0)
    return beyond > _NEARLY, beyond if beyond > _NEARLY else _PRICE * beyond - one.value


def _finely(case: RobotCase, rough: list[Found]) -> list[Found]:
    """The most promising of what is roughly polished, to the end; more until one meets the bounds.

    What is roughly polished gets stuck a little beyond the bounds where several peaks are level.
    """
    few = sorted(rough, key=_promise)[:_CLOSEST]
    best = min(rough, key=Found.rank)
    if best.met and all(one is not best for one in few):
        few.append(best)
    found: list[Found] = []
    with contextlib.closing(cores.spread(polished, [(case, one.x) for one in few])) as ends:
        for one in ends:
            found.append(one)
            if one.met or one.out_of_reach:
                break
    return found


def _stable_end(case: RobotCase, paths: Descended, start: int) -> np.ndarray | None:
    """The end of a start's path, or the last of a few points before it at which loops are stable.

    The descent follows peaks alone, which it may jump over, and has no word of stability.
    """
    path = paths.path[start]
    back = [path[int(len(path) * share)] for share in _BACKWARDS]
    for x in (paths.gains[start], *back):
        x = np.clip(np.asarray(x, float), case.low, case.high)
        if np.isfinite(x).all() and case.stable(x):
            return x
    return None
