"""Where a search begins: the best start of each of the most promising pieces of the delay's range.

A model that contains another begins where that one ended, its drive's numbers apart: of those the
sum of delay and lag is what the other has found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jaxact.identification.problem import Problem, Unknown, effective_lag
from jaxact.parameters import DELAY, WN, ZETA

if TYPE_CHECKING:
    from jaxact.identification.fitting import Fit

# The most promising pieces are solved; from a solution at a tick the search goes on beyond it, as
# often as that gains anything: a slow loop begins as a delay of many ticks.
_MOST_PIECES = 2
# Beside another model a piece is not solved whose start is so many times worse than the best.
_AS_PROMISING = 3.0
# Where a residual changes so much faster than an unknown, no step along it says anything.
_LARGEST_SLOPE = 1e100
# Of another model's lag, a delay may be these shares, and the loop behind it damped so.
_SHARES_OF_THE_LAG, _DAMPINGS = (0.15, 0.5, 0.85), (0.45, 0.9)
# A model that leaves a larger share of the motion's square has not followed it.
_FOLLOWED = 0.01
# At most so many starts are looked at before the best ones are solved.
_MOST_STARTS = 256

Evaluated = tuple[np.ndarray, np.ndarray]
"""Residuals and their slopes, shapes (rows,) and (rows, unknowns)."""


@dataclass(frozen=True)
class Begun:
    """A start of the search.

    Attributes:
        piece: number of the tick before its delay; None where nothing has kinks.
        point: in the coordinates of the search, shape (unknowns,).
        evaluated: residuals and slopes there, where they were looked at.
        cost: sum of the squared residuals, beside another model as `_promised`.
    """

    piece: int | None
    point: np.ndarray
    evaluated: Evaluated | None = None
    cost: float = math.nan


def begin(
    sought: Problem, held: Mapping[str, float], start: Mapping[str, float], near: Fit | None
) -> list[Begun]:
    """The best start of each of the most promising pieces, the best first."""
    chosen = {**start, **held}
    own = {
        u.name: (min(max(chosen[u.name], u.low), u.high),) if u.name in chosen else u.starts
        for u in sought.unknowns
    }
    each = own
    if near is not None:
        each = {u.name: _nearby(u, own[u.name], near, chosen) for u in sought.unknowns}
    points = _products(sought, each)
    if near is not None and DELAY in each and DELAY not in chosen and {WN, "lag"} & set(each):
        matched = [_matched(sought, point, near) for point in points]
        matched += _shared(sought, points[0], near) if WN in each else []
        points = list({point.tobytes(): point for point in matched}.values())
    if near is not None and near.square_sum > _FOLLOWED * len(near.residuals):
        # What lacks friction may have ended at a joint too heavy to move, far from any motion.
        points += _products(sought, own)
    if len(points) == 1:
        return [Begun(_piece(sought, points[0], held), points[0])]
    others = [i for i, u in enumerate(sought.unknowns) if u.name not in (DELAY, WN, ZETA, "lag")]
    best: dict[int | None, Begun] = {}
    for point in points:
        evaluated = sought.evaluate(point)
        cost = float(np.sum(evaluated[0] ** 2))
        if near is not None and math.isfinite(cost):
            cost = _promised(evaluated, others)
        one = Begun(_piece(sought, point, held), point, evaluated, cost)
        if math.isfinite(one.cost) and (one.piece not in best or one.cost < best[one.piece].cost):
            best[one.piece] = one
            # Slopes of many logs take memory: no more are kept than are solved.
            promising = sorted(best.values(), key=lambda begun: begun.cost)[:_MOST_PIECES]
            best = {begun.piece: begun for begun in promising}
    if near is not None and best:
        least = min(one.cost for one in best.values())
        best = {piece: one for piece, one in best.items() if one.cost <= _AS_PROMISING * least}
    return list(best.values()) or [Begun(_piece(sought, points[0], held), points[0])]


def _promised(evaluated: Evaluated, others: list[int]) -> float:
    """Sum of squares one step from a start, if the residuals changed along straight lines.

    Another model's numbers fit that model's drive: beside the right one they look wrong until they
    have followed it. The drive's own step promises more than it keeps where the lines are curved:
    what counts is the geometric mean of the sums with it and without.

    Args:
        evaluated: residuals and slopes at the start.
        others: columns of the slopes that are not the drive's.
    """
    rest, slopes = evaluated
    if not np.isfinite(slopes).all() or np.max(np.abs(slopes)) > _LARGEST_SLOPE:
        return float(rest @ rest)
    scaled = slopes / np.maximum(np.linalg.norm(slopes, axis=0), 1e-100)
    alike, along = scaled.T @ scaled, scaled.T @ rest

    def left(moved: list[int]) -> float:
        step = np.linalg.lstsq(alike[np.ix_(moved, moved)], along[moved], rcond=1e-10)[0]
        return max(float(rest @ rest - along[moved] @ step), 0.0)

    return math.sqrt(left(others) * left(list(range(slopes.shape[1]))))


def _products(sought: Problem, each: Mapping[str, Iterable[float]]) -> list[np.ndarray]:
    rows = itertools.islice(itertools.product(*each.values()), _MOST_STARTS)
    return [_inner(sought, row) for row in rows]


def _inner(sought: Problem, values: Iterable[float]) -> np.ndarray:
    return np.array([u.inner(x) for u, x in zip(sought.unknowns, values, strict=True)], float)


def _nearby(
    unknown: Unknown, starts: tuple[float, ...], near: Fit, chosen: Mapping[str, float]
) -> tuple[float, ...]:
    """Starts of one unknown: where another model ended; of the drive's also its own."""
    if unknown.name in chosen or unknown.name not in near.values:
        return starts
    ended = near.values[unknown.name]
    if unknown.name == DELAY:
        # The search crosses ticks by itself: one in four is near enough.
        return (ended, *starts[::4])
    return (ended, *starts) if unknown.name in (WN, ZETA, "lag") else (ended,)


def _matched(sought: Problem, point: np.ndarray, near: Fit) -> np.ndarray:
    """A start whose ``delay + 2 zeta / wn`` is that of another model, which slow excitation saw."""
    lag = effective_lag(near.problem.model_values(near.point))
    values = sought.model_values(point)
    index = sought.names.index(DELAY)
    unknown, matched = sought.unknowns[index], point.copy()
    matched[index] = np.clip(lag - 2.0 * values[ZETA] / values[WN], unknown.low, unknown.high)
    return matched


def _shared(sought: Problem, point: np.ndarray, near: Fit) -> list[np.ndarray]:
    """Starts whose delay is a share of another model's lag, the loop's ``2 zeta / wn`` the rest."""
    lag = max(effective_lag(near.problem.model_values(near.point)), 0.1 * (sought.period or 1.0))
    found = []
    for share, zeta in itertools.product(_SHARES_OF_THE_LAG, _DAMPINGS):
        start = point.copy()
        values = {DELAY: share * lag, ZETA: zeta, WN: 2.0 * zeta / ((1.0 - share) * lag)}
        for name, value in values.items():
            index = sought.names.index(name)
            unknown = sought.unknowns[index]
            start[index] = unknown.inner(float(np.clip(value, unknown.low, unknown.high)))
        found.append(start)
    return found


def _piece(sought: Problem, point: np.ndarray, held: Mapping[str, float]) -> int | None:
    """Number of the tick before the point's delay; None where nothing has kinks."""
    if sought.period is None or DELAY not in sought.names or DELAY in held:
        return None
    index = sought.names.index(DELAY)
    last = round(sought.unknowns[index].high / sought.period) - 1
    return min(math.floor(point[index] / sought.period + 1e-9), max(last, 0))
