"""Where the search for a robot's gains begins, and how it goes on: starts, descent, polish."""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.tune import robot_smooth
from jaxact.tune.goal import Goal
from jaxact.tune.groups import Groups
from jaxact.tune.joint import STARTS as TABLE
from jaxact.tune.optimize import Descended, Descent, descend
from jaxact.tune.polish import MET
from jaxact.tune.robot_loops import Situation
from jaxact.tune.robot_rows import Found, RobotCase, excess, part, polished, rescued
from jaxact.tune.run import candidates

# Log-gains stay this near to where the search begins.
_REACH = 8.0
# Spread of the starts around a point that is fine, in ln kp and ln kd, and how high peaks of a
# start may be [ln].
_SPREAD, _HIGHEST = (1.0, 0.6), 2.0
# How often a start is brought nearer.
_HALVINGS = 5
# Bounds exceeded by more than this are the boundary's doing [ln]; linear programmes away from it.
_BESIDE, _APPROACH = 1.5, 4
# Ends of the descent that are polished.
_POLISHED = 2


def usual(situations: Sequence[Situation], groups: Groups) -> np.ndarray:
    """Log-gains to begin with where none are known: moderate ones for the inertias and the lag."""
    lag = max(one.lag for one in situations)
    inertia = np.min([one.inertias for one in situations], axis=0)
    a, b = TABLE[4]
    return groups.log_gains(b * inertia / lag**2, a * inertia / lag)


def bounds(goal: Goal, groups: Groups, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest log-gains, shape (2 g,) each: those of the goal, and not far from x."""
    low, high = x - _REACH, x + _REACH
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


def starts_around(case: RobotCase, x: np.ndarray, number: int, seed: int) -> np.ndarray:
    """x, and points around it at which all loops are stable and none is near its boundary."""
    from scipy.stats import qmc

    size = len(x)
    power = max(number - 1, 1).bit_length()
    points = qmc.Sobol(size, scramble=True, rng=seed).random_base2(power)[: number - 1]
    reach = np.repeat(_SPREAD, size // 2)
    small = hardest(case, x)
    found = [x]
    limit = max(_HIGHEST, float(excess(small, x).max(initial=-np.inf)) + 1.0)
    for offset in (2.0 * points - 1.0) * reach:
        for _ in range(_HALVINGS):
            there = np.clip(x + offset, case.low, case.high)
            if small.stable(there) and excess(small, there).max(initial=-np.inf) < limit:
                found.append(there)
                break
            offset = 0.5 * offset
        else:
            found.append(x)
    return np.array(found)


def hardest(case: RobotCase, x: np.ndarray) -> RobotCase:
    """The same with a few loops only: the worst at x, and one at least of every situation."""
    over = excess(case, x)
    situation = case.table.loops.situation
    first = [int(np.flatnonzero(situation == s)[np.argmax(over[situation == s])])
             for s in np.unique(situation)]  # fmt: skip
    rest = [int(i) for i in np.argsort(-over) if int(i) not in first]
    chosen = (first + rest)[: max(robot_smooth.LOOPS, len(first))]
    return part(case, np.sort(chosen))


def descended(case: RobotCase, first: np.ndarray, how: Descent) -> Descended:
    """Where the descent leads from several log-gains, shape (starts, 2 g), for a few loops."""
    smooth = robot_smooth.RobotSurrogate(robot_smooth.family(case.goal), len(case.table.loops))
    data = robot_smooth.data(case.table, case.groups, case.goal, case.low, case.high)
    one = jax.tree.map(lambda leaf: leaf[None], data)
    still = np.zeros(first.shape[1], np.float32)
    found = descend(smooth, one, jnp.asarray(first[None], jnp.float32), still, how)
    return jax.tree.map(np.asarray, found)


def best_of(case: RobotCase, near: Found, paths: Descended) -> Found:
    """The best of the ends of the descent, polished; no worse than the point that was fine."""
    best = near
    for x in candidates(0, paths)[:_POLISHED]:
        x = np.clip(x, case.low, case.high)
        if not case.stable(x):
            continue
        found = polished(case, x)
        best = found if _better(found, best) else best
    return polished(case, near.x) if best is near else best


def _better(one: Found, other: Found) -> bool:
    if max(one.violation, other.violation) <= MET:
        return one.value > other.value
    return one.violation < other.violation
