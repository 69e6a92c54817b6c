"""Bounded least squares with forward derivatives, from several starts.

    minimise  sum_i r_i(x)^2,      x within its bounds

The delay of a held command makes the sum smooth between control ticks and gives it a kink at each:
its range is therefore cut at whole periods, each piece is a problem of its own, and those whose
start is best are solved: a little first, and the best one to the end.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from jaxact.identification.first_points import Evaluated, begin
from jaxact.identification.problem import Problem
from jaxact.parameters import DELAY, WN

LEAST_SQUARES, ADAM = "trf", "adam"
METHODS = (LEAST_SQUARES, ADAM)

# A step that changes the sum by less than this share of one residual's ends the search: what is
# left is some hundredths of a standard deviation.
_TOLERANCE = 1e-3
# Evaluations after which the best piece is known; and of all.
_FIRST_EVALUATIONS = 4
_MOST_EVALUATIONS = 100
# Share of a control period within which a delay lies at a tick.
_AT_THE_TICK = 1e-3
# Share of its range within which an unknown lies at a bound.
_AT_THE_BOUND = 1e-6
# A model that after some evaluations is not better than a simpler one by this share is left there;
# not one that is worse by the second: it contains the simpler one, and is still on its way.
_WORTH, _ON_ITS_WAY = 5e-3, 0.2
_HOPELESS_AFTER = 12
# A search that gains less than this share in so many evaluations creeps along a flat valley.
_CREEPING = 1e-3


@dataclass(frozen=True)
class Fit:
    """A solved problem.

    Attributes:
        problem: it.
        point: solution in the coordinates of the search, shape (unknowns,).
        residuals: there, shape (rows,).
        slopes: derivatives of the residuals there, shape (rows, unknowns).
        at_bounds: unknowns that lie at a bound of their range.
        evaluations: of the residuals, in all.
        converged: whether the search ended by itself.
    """

    problem: Problem
    point: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    at_bounds: tuple[str, ...]
    evaluations: int
    converged: bool = True

    @property
    def values(self) -> dict[str, float]:
        """The unknowns by name."""
        return self.problem.values(self.point)

    @property
    def square_sum(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residuals @ self.residuals)


def solve(
    sought: Problem,
    *,
    loss: str = "linear",
    method: str = LEAST_SQUARES,
    fixed: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    near: Fit | None = None,
    enough: float = 0.0,
) -> Fit:
    """The least squares, from the most promising starts.

    Args:
        sought: the problem.
        loss: of `scipy.optimize.least_squares`; "soft_l1" and "huber" bear outliers.
        method: "trf", least squares on all logs at once, or "adam" on a few at a time.
        fixed: unknowns that are held at a value.
        start: unknowns that begin at a value instead of each of their starts.
        near: a solution of another model of the same logs, whose values are begun from.
        enough: sum of squares of a simpler model; the search is left early where this one is
            hardly better.

    Returns:
        The best solution found.
    """
    held = {} if fixed is None else dict(fixed)
    begun = begin(sought, held, {} if start is None else start, near)
    if method == ADAM:
        free = [index for index, u in enumerate(sought.unknowns) if u.name not in held]
        from jaxact.identification.minibatches import descend  # imports optax

        point = descend(sought, begun[0].point, *bounds(sought), free)
        return at(sought, point, sought.evaluate(point))
    tried = {
        one.piece: _solve_piece(
            sought, held, one.point, one.piece, loss, _FIRST_EVALUATIONS, one.evaluated
        )
        for one in begun
    }
    # A slow loop begun at a wrong delay is far from its end after a few steps.
    slow = near is not None and WN in sought.names
    to_end = list(tried) if slow else [min(tried, key=lambda one: tried[one].square_sum)]
    ended = [_ended(sought, held, tried, piece, loss, enough) for piece in to_end]
    return min(ended, key=lambda one: one.square_sum)


def _ended(
    sought: Problem, held: Mapping[str, float], tried: Mapping[int | None, Fit],
    piece: int | None, loss: str, enough: float,
) -> Fit:  # fmt: skip
    """A solution searched to its end, over one control tick after another.

    Args:
        sought: the problem.
        held: unknowns that are held at a value.
        tried: what is known of each piece.
        piece: of them, in which the search begins.
        loss, enough: as in `solve`.
    """
    best = _finished(sought, held, tried[piece], piece, loss, enough)
    ended = {piece}
    while True:
        beyond = _beyond(sought, best, piece)
        if beyond is None or beyond in ended:
            break
        ended.add(beyond)
        found = _solve_piece(
            sought, held, _inside(sought, best.point, beyond), beyond, loss, _FIRST_EVALUATIONS
        )
        found = min(found, tried.get(beyond, found), key=lambda one: one.square_sum)
        found = _finished(sought, held, found, beyond, loss, enough)
        if found.square_sum >= best.square_sum:
            break
        creeping = found.square_sum > (1.0 - _CREEPING) * best.square_sum
        piece, best = beyond, found
        if creeping:
            break
    return best


def _inside(sought: Problem, point: np.ndarray, piece: int) -> np.ndarray:
    """A point with its delay some way into a piece, as steps at a bound are small."""
    moved, index = point.copy(), sought.names.index(DELAY)
    ticks = moved[index] / (sought.period or 1.0)
    moved[index] = (sought.period or 1.0) * float(np.clip(ticks, piece + 0.1, piece + 0.9))
    return moved


def _finished(
    sought: Problem, held: Mapping[str, float], begun: Fit, piece: int | None, loss: str,
    enough: float,
) -> Fit:  # fmt: skip
    """A solution searched to its end, or left where it is hardly better than a simpler model's."""
    best = begun
    while not best.converged and best.evaluations < _MOST_EVALUATIONS:
        hopeless = 1.0 - _WORTH < best.square_sum / (enough or math.inf) < 1.0 + _ON_ITS_WAY
        if hopeless and best.evaluations >= _HOPELESS_AFTER:
            break
        before = best.square_sum
        evaluated = best.residuals, best.slopes
        more = _solve_piece(sought, held, best.point, piece, loss, _HOPELESS_AFTER, evaluated)
        best = replace(more, evaluations=best.evaluations + more.evaluations)
        if best.square_sum > (1.0 - _CREEPING) * before:
            break
    return best


def _solve_piece(
    sought: Problem, held: Mapping[str, float], point: np.ndarray, piece: int | None, loss: str,
    most: int, evaluated_there: Evaluated | None = None,
) -> Fit:  # fmt: skip
    """The least squares with the delay between two ticks, in so many evaluations at most.

    Args:
        sought: the problem.
        held: unknowns that are held at a value.
        point: where the search begins, shape (unknowns,).
        piece: number of the tick before the delay.
        loss: of the least squares.
        most: evaluations.
        evaluated_there: residuals and slopes at `point`, where they are known.
    """
    low, high = bounds(sought, piece)
    free = [index for index, u in enumerate(sought.unknowns) if u.name not in held]
    base = np.clip(point, low, high)
    for index, unknown in enumerate(sought.unknowns):
        if unknown.name in held:
            base[index] = unknown.inner(held[unknown.name])
    if not free:
        return at(sought, base, sought.evaluate(base), evaluations=1)
    known: dict[bytes, Evaluated] = {}
    if evaluated_there is not None:
        known[point[free].tobytes()] = evaluated_there

    def evaluated(inner: np.ndarray) -> Evaluated:
        key = inner.tobytes()
        if key not in known:
            if len(known) > 1:
                known.pop(next(iter(known)))
            whole = base.copy()
            whole[free] = inner
            known[key] = sought.evaluate(whole)
        return known[key]

    margin = 1e-9 * (high - low)
    solved = least_squares(
        lambda inner: evaluated(inner)[0],
        np.clip(base, low + margin, high - margin)[free],
        jac=lambda inner: evaluated(inner)[1][:, free],
        bounds=(low[free], high[free]),
        x_scale="jac",
        loss=loss,
        ftol=_TOLERANCE / sum(sought.lengths), xtol=1e-8, gtol=1e-8,
        max_nfev=most,
    )  # fmt: skip
    base[free] = solved.x
    ended = evaluated(solved.x)
    late = sought.names.index(DELAY) if DELAY in sought.names else None
    if late in free and 0.0 < base[late] < _AT_THE_BOUND * (sought.period or 0.0):
        # A search within bounds ends just inside of them: there is no delay.
        base[late] = 0.0
        ended = sought.evaluate(base)
    found = at(sought, base, ended, evaluations=int(solved.nfev))
    return replace(found, converged=bool(solved.status > 0))


def at_a_tick(found: Fit) -> bool:
    """Whether the delay of a solution lies at a whole number of control periods, at a kink."""
    sought = found.problem
    if sought.period is None or DELAY not in sought.names:
        return False
    ticks = found.point[sought.names.index(DELAY)] / sought.period
    return bool(abs(ticks - round(ticks)) < _AT_THE_TICK)


def _beyond(sought: Problem, found: Fit, piece: int | None) -> int | None:
    """The piece beyond the tick at which a solution's delay lies."""
    if piece is None or sought.period is None:
        return None
    delay = found.point[sought.names.index(DELAY)] / sought.period
    last = round(sought.unknowns[sought.names.index(DELAY)].high / sought.period) - 1
    if delay - piece < _AT_THE_TICK and piece > 0:
        return piece - 1
    if piece + 1 - delay < _AT_THE_TICK and piece < last:
        return piece + 1
    return None


def at(
    sought: Problem,
    point: np.ndarray,
    evaluated: Evaluated,
    *,
    evaluations: int = 0,
) -> Fit:
    """A problem's residuals and slopes at a point, as a fit."""
    low, high = bounds(sought)
    near = _AT_THE_BOUND * (high - low)
    touched = (point - low < near) | (high - point < near)
    return Fit(
        problem=sought,
        point=point,
        residuals=evaluated[0],
        slopes=evaluated[1],
        at_bounds=tuple(
            u.name for u, there in zip(sought.unknowns, touched.tolist(), strict=True) if there
        ),
        evaluations=evaluations,
    )


def bounds(sought: Problem, piece: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the search, of the delay between the ticks `piece` and `piece + 1`."""
    both = np.array([sorted((u.inner(u.low), u.inner(u.high))) for u in sought.unknowns], float)
    low, high = both[:, 0].copy(), both[:, 1].copy()
    if piece is not None and sought.period is not None:
        index = sought.names.index(DELAY)
        low[index] = piece * sought.period
        high[index] = min(high[index], (piece + 1) * sought.period)
    return low, high
