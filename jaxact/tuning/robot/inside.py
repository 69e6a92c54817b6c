"""The worst points of a robot's box: every loop is closed, and climbed along each bound apart.

A point is looked at on a grid made of its loop's own roots, as its certificate is: what follows the
peaks that are known does not see a resonance that only stands out elsewhere in the box. The slopes
are difference quotients at the frequency of the peak (Danskin's theorem), only where one climbs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from jaxact.analysis.robot import multiloop
from jaxact.analysis.robot.stability import MARGINAL
from jaxact.tuning.goal import Goal
from jaxact.tuning.robot import cores
from jaxact.tuning.robot.loops import Situation
from jaxact.tuning.robot.peaks import SHIFTS, largest, limits, narrowed, sensitivity, vertex
from jaxact.tuning.robot.rows import RobotCase
from jaxact.tuning.worst import Slopes, Worst, screen, worst

# Points that climb side by side.
_CLIMBERS = 4
# Frequencies decomposed at once, those first that may be the highest.
_AT_ONCE = 8
# Parabolas through three points that a peak is refined with.
_PARABOLAS = 3
# Step of the difference quotients [fraction of the ranges].
_STEP = 1e-4


def worst_inside(
    situations: Sequence[Situation], case: RobotCase, x: np.ndarray, seed: int
) -> list[Worst]:
    """The worst points of the box for each situation at log-gains x, the members among them.

    Args:
        situations: of the robot.
        case: what is known, with some bound.
        x: log-gains.
        seed: of what is screened.
    """
    loops = case.table.loops
    size = loops.fraction.shape[1]
    screened = screen(size, seed)
    gains = case.groups.gains(x)
    return [
        worst(
            _Inside(one, case.goal, gains),
            np.concatenate([loops.fraction[loops.situation == place], screened]),
            seed,
            _CLIMBERS,
        )
        for place, one in enumerate(situations)
    ]


@dataclass(frozen=True)
class _Inside:
    """By how much each bound is exceeded over the box of one situation, with slopes.

    Attributes:
        situation: whose loops are closed.
        goal: with r bounds.
        gains: kp and kd of the joints, shape (m,) each.
    """

    situation: Situation
    goal: Goal
    gains: tuple[np.ndarray, np.ndarray]

    def __call__(self, points: np.ndarray) -> tuple[np.ndarray, Slopes]:
        """Excess [ln] at points of the box (n, d): shape (n, r), inf where unstable; and slopes."""
        apart, place = np.unique(points, axis=0, return_inverse=True)  # steps often meet in corners
        seen = _Seen(self.goal, self.gains, self.situation.period)
        found = cores.many(seen, [self._opened(u) for u in apart])
        height, angle = np.moveaxis(np.array(found)[place.ravel()], 1, 0)

        def slopes(index: np.ndarray, row: np.ndarray) -> np.ndarray:
            """Shape (k, d)."""
            slope = np.zeros((len(index), points.shape[1]))
            for own, i, r in zip(slope, index, row, strict=True):
                own[:] = self._slope(points[i], int(r), height[i, r], angle[i, r])
            return slope

        return height, slopes

    def _opened(self, u: np.ndarray) -> tuple[np.ndarray, ...]:
        """A, B and Y of the loop at a point (d,), opened at its controllers."""
        return self.situation.opened(self.situation.values(u[None])[0])[:3]

    def _slope(self, u: np.ndarray, row: int, height: float, angle: float) -> np.ndarray:
        """Of a bound at a point, one-sided, shape (d,); 0 where it is unstable."""
        if not np.isfinite(height):
            return np.zeros(len(u))
        slope = []
        for axis, fraction in enumerate(u):
            end = u.copy()
            end[axis] += _STEP if fraction < 0.5 else -_STEP
            there = _excess(self.goal, row, self._at(self._opened(end), row, angle))
            slope.append((there - height) / (end[axis] - fraction))
        return np.array(slope)

    def _at(self, matrices: tuple[np.ndarray, ...], row: int, angle: float) -> float:
        """ln of what a bound is of, at one frequency [rad]."""
        A, B, seen = matrices
        states = np.linalg.solve(np.exp(1j * angle) * np.eye(len(A)) - A, B.astype(complex))
        response = (seen.reshape(-1, len(A)) @ states).reshape(1, *seen.shape[:2], -1)
        return float(_logs(sensitivity(response, *self.gains), self.goal.rows[row][1])[0])


@dataclass(frozen=True)
class _Seen:
    """By how much a loop that was opened exceeds each bound with gains.

    Attributes:
        goal, gains: as of `_Inside`.
        period: T [s].
    """

    goal: Goal
    gains: tuple[np.ndarray, np.ndarray]
    period: float

    def __call__(self, matrices: tuple[np.ndarray, ...]) -> np.ndarray:
        """Excess of every bound [ln] and w T of its peak [rad], shape (2, r)."""
        A, B, seen = matrices
        kp, kd = self.gains
        C = -(kp[:, None] * seen[:, 0] + kd[:, None] * seen[:, 1])
        loop = multiloop.decomposed(A + B @ C, B, C, self.period)
        rows = self.goal.rows
        if not np.abs(loop.roots).max(initial=0.0) < 1.0 + MARGINAL:
            return np.array([np.full(len(rows), np.inf), np.zeros(len(rows))])
        grid = multiloop.grid_of(loop.roots, multiloop.lowest(loop.roots))
        S = multiloop.sensitivity(loop, grid)
        S[[0, -1]] = S[[0, -1]].real
        found = [_highest(loop, grid, S, metric) for _, metric, _, _ in rows]
        over = [_excess(self.goal, row, log) for row, (log, _) in enumerate(found)]
        return np.array([over, [at for _, at in found]])


def _excess(goal: Goal, row: int, log: float) -> float:
    """Of a bound at a peak of its metric; of the disk margin, mu is one over it."""
    _, _, sign, bound = goal.rows[row]
    return log - sign * float(np.log(bound))


def _logs(S: np.ndarray, metric: str) -> np.ndarray:
    """ln of the largest singular value of what a metric is of, S of shape (k, m, m); (k,)."""
    c, c0 = SHIFTS[metric]
    with np.errstate(divide="ignore"):
        return np.log(largest(c * S + c0 * np.eye(S.shape[-1]), metric))


def _highest(
    loop: multiloop.Multiloop, grid: np.ndarray, S: np.ndarray, metric: str
) -> tuple[float, float]:
    """ln of a metric's peak and w T there [rad], refined; decomposed only where it may be.

    Args:
        loop: whose S it is.
        grid: angles [rad], shape (k,).
        S: there, shape (k, m, m).
        metric: one of SHIFTS.
    """
    c, c0 = SHIFTS[metric]
    _, most = limits(c * S + c0 * np.eye(S.shape[-1]))
    order = np.argsort(-most, kind="stable")
    highest, place = -np.inf, 0
    for first in range(0, len(order), _AT_ONCE):
        some = order[first : first + _AT_ONCE]
        if np.log(most[some[0]]) <= highest:
            break
        logs = _logs(S[some], metric)
        top = int(np.argmax(logs))
        if logs[top] > highest:
            highest, place = float(logs[top]), int(some[top])
    if place < 2 or place == len(grid) - 1:  # the first one is 0, which has no logarithm
        return highest, float(grid[place])
    at = np.log(grid[None, place - 1 : place + 2])
    log = _logs(S[place - 1 : place + 2], metric)[None]
    for _ in range(_PARABOLAS):
        new = vertex(at, log)
        at, log = narrowed(at, log, new, _logs(multiloop.sensitivity(loop, np.exp(new)), metric))
    return float(log[0, 1]), float(np.exp(at[0, 1]))
