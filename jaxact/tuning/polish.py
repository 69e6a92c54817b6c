"""From where the descent ended to the optimum of the exact problem, in float64.

    maximise  min_k value_k(x)   subject to  c_r(x) <= 0,  low <= x <= high

by a sequence of linear programmes in a trust region (Fletcher and Maza, 1989): every value and
every constraint of every member is a row, so that those that bind find each other; where two bind
it converges like Newton's method. A violation that cannot be avoided is made as small as it gets.
Rows come from a function of x, so that anything with rows can be polished: a joint, a robot.
Many problems are polished side by side, because their rows are computed in one batch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

# Constraints are met when no row exceeds this: the bounds hold to better than 1e-9.
MET = 1e-10
_AIM = 4e-11
_RADIUS, _SMALLEST = 0.15, 1e-7
_STEPS = 60
# Weight of a violation that cannot be avoided, and the least of any. Value bought with a violation
# is less: steps must not be paid for with constraints that the linear programme does not know. The
# last is what counts where there is no value at all.
_ELASTIC, _LIGHTEST, _WORTHLESS = 1e3, 10.0, -1e6
_NEAR = 1.0
# A step that promises less than this is not worth an evaluation.
_GAIN = 1e-8
# Rows of points this many radii away still count.
_FAR = 10.0
_REACHES, _LOOKS = (1e-2, 1e-3, 1e-4), 6


@dataclass(frozen=True)
class Rows:
    """Exact values and constraints of several problems at one point each; p problems, d unknowns.

    Attributes:
        value: to be large, shape (p, k).
        value_slope: shape (p, k, d).
        excess: c, at most 0 where a constraint is met, shape (p, r).
        excess_slope: shape (p, r, d).
        usable: whether the problem's rows mean anything, every member stable; shape (p,).
    """

    value: np.ndarray
    value_slope: np.ndarray
    excess: np.ndarray
    excess_slope: np.ndarray
    usable: np.ndarray

    @property
    def worst_value(self) -> np.ndarray:
        """Smallest value, -inf where unusable; shape (p,)."""
        return np.where(self.usable, _smallest(self.value), -np.inf)

    @property
    def violation(self) -> np.ndarray:
        """Largest excess, inf where unusable; shape (p,)."""
        return np.where(self.usable, -_smallest(-self.excess), np.inf)


Problem = Callable[[np.ndarray], Rows]
"""x of every problem, shape (p, d) -> the rows there."""


def _smallest(rows: np.ndarray) -> np.ndarray:
    filled = np.where(np.isnan(rows), -np.inf, rows)
    return np.min(filled, axis=1, initial=np.inf)


@dataclass(frozen=True)
class Polished:
    """Best points found; p problems.

    Attributes:
        x: shape (p, d).
        value: smallest value [-], shape (p,).
        violation: largest excess [-], shape (p,); at most MET where all constraints are met.
        evaluations: points at which each problem was evaluated.
        end: where the way led in the end, maybe a little beyond the constraints, shape (p, d).
    """

    x: np.ndarray
    value: np.ndarray
    violation: np.ndarray
    evaluations: int
    end: np.ndarray | None = None

    @property
    def feasible(self) -> np.ndarray:
        """Whether all constraints are met, shape (p,)."""
        return self.violation <= MET


def better(
    value: np.ndarray, violation: np.ndarray, than_value: np.ndarray, than_violation: np.ndarray
) -> np.ndarray:
    """Whether one point beats another: constraints first, then the value; elementwise."""
    met, than_met = violation <= MET, than_violation <= MET
    higher = met & than_met & (value > than_value)
    closer = ~met & ~than_met & (violation < than_violation)
    return (met & ~than_met) | higher | closer


def polish(
    problem: Problem,
    start: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    *,
    steps: int = _STEPS,
    worth: float = _GAIN,
    radius: float = _RADIUS,
    kinks: bool = True,
    memory: int = 0,
) -> Polished:
    """The best points near the starts.

    Args:
        problem: rows of every problem at a point of each.
        start: shape (p, d).
        low, high: bounds that are never left, shape (p, d).
        steps: most linear programmes.
        worth: gain at which a feasible point is left as it is [-].
        radius: of the trust region to begin with [-].
        kinks: look to all sides where it gets stuck, which takes 2 d evaluations.
        memory: points before whose rows count as well, where a point shows a few of its rows only.
    """
    start = np.clip(start, low, high)
    best, x, stuck = _descend(problem, start, low, high, steps, worth, radius, memory)
    for reach in _REACHES if kinks and stuck.any() else ():
        best, x = _across_kinks(problem, best, x, stuck, reach, low, high)
    return replace(best, end=x)


def _descend(
    problem: Problem,
    x: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    steps: int,
    worth: float,
    trust: float,
    memory: int,
) -> tuple[Polished, np.ndarray, np.ndarray]:
    """The sequence of linear programmes; where it ended, and whether it got stuck there."""
    number = len(x)
    rows = problem(x)
    best = Polished(x.copy(), rows.worst_value, rows.violation, 1)
    radius = np.full(number, trust)
    finished = np.zeros(number, dtype=bool)
    seen: list[tuple[np.ndarray, Rows]] = []
    for _ in range(steps):
        going = (radius > _SMALLEST) & rows.usable & ~finished
        if not going.any():
            break
        trial, weight, gain = x.copy(), np.zeros(number), np.zeros(number)
        place = np.flatnonzero(going)
        cuts = [_cuts(rows, seen, i, x[i], radius[i], _FAR) for i in place]
        sides = _sides(x, radius[:, None], low, high)[place]
        step, weight[place], gain[place] = _linear_steps(cuts, sides, rows.violation[place])
        trial[place] = np.clip(x[place] + step, low[place], high[place])
        there = problem(trial)
        best = _keep_better(best, trial, there)
        merit = _merit(rows, weight) - _merit(there, weight)
        taken = there.usable & (merit > 0.05 * gain)
        # Of two points, the one that is not gone to shows what lies beside the other.
        moved = taken[:, None]
        other = np.where(moved, x, trial), _where(taken, rows, there)
        seen = [*seen, other][-memory:] if memory else []
        length = np.max(np.abs(trial - x), axis=1)
        good = taken & (merit > 0.7 * gain) & (length > 0.9 * radius)
        finished |= going & (gain <= worth) & (rows.violation <= MET)
        radius = np.where(taken, np.where(good, 2.0 * radius, radius), 0.35 * length)
        radius = np.minimum(radius, _NEAR)
        x = np.where(moved, trial, x)
        rows = _where(taken, there, rows)
    return best, x, ~finished & rows.usable


def _across_kinks(
    problem: Problem,
    best: Polished,
    x: np.ndarray,
    stuck: np.ndarray,
    reach: float,
    low: np.ndarray,
    high: np.ndarray,
) -> tuple[Polished, np.ndarray]:
    """Look a little to every side, then step where all that was seen there allows.

    A margin is a maximum over frequencies. Where two peaks are level, the rows at one point know of
    one of them only, and the other stops every step.
    """
    size = x.shape[1]
    sides = reach * np.concatenate([np.eye(size), -np.eye(size)])
    around = [np.clip(x + side, low, high) for side in sides]
    memory = [(point, problem(point)) for point in around]
    rows = problem(x)
    best = _counted(best, len(memory) + 1)
    for _ in range(_LOOKS):
        trial = x.copy()
        place = np.flatnonzero(rows.usable & stuck)
        cuts = [_cuts(rows, memory, i, x[i], 2.0 * reach) for i in place]
        sides = _sides(x, reach, low, high)[place]
        step, _, gain = _linear_steps(cuts, sides, rows.violation[place])
        there = np.clip(x[place] + step, low[place], high[place])
        trial[place] = np.where(gain[:, None] > _GAIN, there, x[place])
        if np.array_equal(trial, x):
            break
        there = problem(trial)
        best = _keep_better(best, trial, there)
        memory.append((x, rows))
        fine = there.usable
        x, rows = np.where(fine[:, None], trial, x), _where(fine, there, rows)
    return best, x


def _counted(best: Polished, more: int) -> Polished:
    return replace(best, evaluations=best.evaluations + more)


def _merit(rows: Rows, weight: np.ndarray) -> np.ndarray:
    """To be small: -value + weight * violation; shape (p,)."""
    excess = np.maximum(rows.violation, 0.0)
    with np.errstate(invalid="ignore"):
        return -np.maximum(rows.worst_value, _WORTHLESS) + weight * excess


def _where(mask: np.ndarray, first: Rows, second: Rows) -> Rows:
    def pick(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.where(mask.reshape((-1,) + (1,) * (a.ndim - 1)), a, b)

    return Rows(
        pick(first.value, second.value), pick(first.value_slope, second.value_slope),
        pick(first.excess, second.excess), pick(first.excess_slope, second.excess_slope),
        mask & first.usable | ~mask & second.usable,
    )  # fmt: skip


def _keep_better(best: Polished, x: np.ndarray, rows: Rows) -> Polished:
    value, violation = rows.worst_value, rows.violation
    wins = better(value, violation, best.value, best.violation)
    return Polished(
        np.where(wins[:, None], x, best.x),
        np.where(wins, value, best.value),
        np.where(wins, violation, best.violation),
        best.evaluations + 1,
    )


@dataclass(frozen=True)
class _Cuts:
    """Linearised rows of one problem, about its present point.

    value + value_slope s, to be large;  excess + excess_slope s, to be at most 0
    """

    value: np.ndarray
    value_slope: np.ndarray
    excess: np.ndarray
    excess_slope: np.ndarray


def _cuts(
    rows: Rows,
    memory: list[tuple[np.ndarray, Rows]],
    index: int,
    x: np.ndarray,
    radius: float,
    far: float = 2.0,
) -> _Cuts:
    """Rows at the present point, and of points nearby; what contradicts the present is dropped."""
    own_value = _finite(rows.value[index], rows.value_slope[index])
    own_excess = _finite(rows.excess[index], rows.excess_slope[index])
    values, excesses = [own_value], [own_excess]
    for point, kept in memory:
        back = x - point[index]
        if not kept.usable[index] or np.abs(back).max() > far * radius:
            continue
        value, value_slope = _finite(kept.value[index], kept.value_slope[index])
        excess, excess_slope = _finite(kept.excess[index], kept.excess_slope[index])
        value, excess = value + value_slope @ back, excess + excess_slope @ back
        fits = value >= (own_value[0].min() if own_value[0].size else -np.inf)
        values.append((value[fits], value_slope[fits]))
        fits = excess <= max(own_excess[0].max(initial=-np.inf), 0.0) + radius * radius
        excesses.append((excess[fits], excess_slope[fits]))
    joined = [
        np.concatenate(part) for pair in (values, excesses) for part in zip(*pair, strict=True)
    ]
    return _Cuts(*joined)


def _sides(
    x: np.ndarray, radius: np.ndarray | float, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Smallest and largest steps within radius and bounds, shape (p, 2, d)."""
    return np.stack([np.maximum(low - x, -radius), np.minimum(high - x, radius)], axis=1)


def _linear_steps(
    cuts: list[_Cuts], sides: np.ndarray, violation: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Linear programmes of n problems: steps (n, d), weights of a violation (n,), gains promised.

    Unknowns (s, t, e) of each: maximise t - elastic * e with value + slope s >= t and
    excess + slope s <= e. All are solved as one, a block each, as most of a small one is the call.

    Args:
        cuts: of each.
        sides: smallest and largest steps, shape (n, 2, d).
        violation: present largest excess, shape (n,).
    """
    number, _, size = sides.shape
    step, weight, gain = np.zeros((number, size)), np.ones(number), np.zeros(number)
    near = [_that_may_bind(cut, side) for cut, side in zip(cuts, sides, strict=True)]
    # Without a value there is nothing to step towards.
    whole = [i for i in range(number) if near[i].value.size]
    for i, solved in zip(whole, _solved([(near[i], sides[i]) for i in whole]), strict=True):
        if solved is None:
            continue
        step[i], target, slack, dual = solved
        weight[i] = _ELASTIC if slack > MET else max(2.0 * dual, _LIGHTEST)
        before = -near[i].value.min() + weight[i] * max(violation[i], 0.0)
        gain[i] = before - (-target + weight[i] * max(slack - _AIM, 0.0))
    return step, weight, gain


def _that_may_bind(cuts: _Cuts, sides: np.ndarray) -> _Cuts:
    """Without constraints that are far enough from binding within the step."""
    reach = np.abs(cuts.excess_slope) @ np.abs(sides).max(axis=0)
    near = cuts.excess + reach > min(0.0, cuts.excess.max(initial=-np.inf)) - 1e-9
    return _Cuts(cuts.value, cuts.value_slope, cuts.excess[near], cuts.excess_slope[near])


def _solved(
    problems: list[tuple[_Cuts, np.ndarray]],
) -> list[tuple[np.ndarray, float, float, float] | None]:
    """Step, target, slack and the sum of duals of each linear programme; None where there is none.

    Args:
        problems: rows and sides of each.
    """
    from scipy.optimize import linprog

    if not problems:
        return []
    size = problems[0][1].shape[1]
    free = [[-np.inf, np.inf], [0.0, np.inf]]
    found = linprog(
        np.tile(np.r_[np.zeros(size), -1.0, _ELASTIC], len(problems)),
        _side_by_side([_matrix(cuts) for cuts, _ in problems]),
        np.concatenate([np.r_[cuts.value, -cuts.excess - _AIM] for cuts, _ in problems]),
        bounds=np.concatenate([np.r_[sides.T, free] for _, sides in problems]),
    )
    if found.x is None or not np.all(np.isfinite(found.x)):
        # One that cannot be solved must not stop the others.
        half = len(problems) // 2
        return _solved(problems[:half]) + _solved(problems[half:]) if half else [None]
    duals = -found.ineqlin.marginals
    done: list[tuple[np.ndarray, float, float, float] | None] = []
    for x, (cuts, _) in zip(found.x.reshape(len(problems), -1), problems, strict=True):
        rows = len(cuts.value) + len(cuts.excess)
        done.append((x[:size], x[size], x[size + 1], float(duals[len(cuts.value) : rows].sum())))
        duals = duals[rows:]
    return done


def _matrix(cuts: _Cuts) -> np.ndarray:
    """Rows over the unknowns (s, t, e): -slope s + t of the values, slope s - e of the excesses."""
    above, size = cuts.value_slope.shape
    rows = np.zeros((above + len(cuts.excess), size + 2))
    rows[:above, :size], rows[:above, size] = -cuts.value_slope, 1.0
    rows[above:, :size], rows[above:, size + 1] = cuts.excess_slope, -1.0
    return rows


def _side_by_side(blocks: list[np.ndarray]) -> Any:
    """The block diagonal matrix of blocks with as many columns each, sparse."""
    from scipy.sparse import csr_array

    rows, width = np.concatenate(blocks), blocks[0].shape[1]
    first = width * np.repeat(np.arange(len(blocks)), [len(block) for block in blocks])
    columns = first[:, None] + np.arange(width)
    ends = width * np.arange(len(rows) + 1)
    shape = (len(rows), width * len(blocks))
    whole = csr_array((rows.ravel(), columns.ravel(), ends), shape=shape)
    whole.eliminate_zeros()
    return whole.tocsc()


def _finite(value: np.ndarray, slope: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows that are numbers: an infinite margin neither binds nor leads anywhere."""
    keep = np.isfinite(value) & np.all(np.isfinite(slope), axis=1)
    return value[keep], slope[keep]
