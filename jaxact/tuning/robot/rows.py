"""A robot's tuning as exact rows for the polish, and the way back from unstable gains.

The unknowns are the log-gains of the groups (`jaxact.tuning.groups`). Every peak of every loop is a
row, with the singular values next to the largest: the legs of a robot are alike, and so are theirs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from jaxact.parameters import KP
from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import Groups
from jaxact.tuning.polish import MET, Rows, polish
from jaxact.tuning.robot.open_loops import OpenLoops
from jaxact.tuning.robot.peaks import Table, beside, growth_rates, peaks, sensitivity
from jaxact.tuning.rollouts.tracking import Tracking

# A polished point that exceeds the bounds by more is not led inside them by looking closer [ln]:
# left alone, except where it takes little, with few unknowns.
OUT_OF_REACH, _FEW = 0.3, 8
# Loops and roots that a rescue follows; what is stable enough, as a share of 1 / lag.
_UNSTABLE, _ROOTS = 8, 3
_INSIDE = 1e-5
# Responses on the table, numbers in all, with which a search takes longer than a few seconds.
_LONG = 1_000_000


@dataclass(frozen=True)
class RobotCase:
    """A robot's loops, and what is asked of their gains.

    Attributes:
        table: responses of the loops.
        groups: of the joints.
        goal: objective and constraints.
        low, high: bounds of the log-gains, shape (2 g,).
        tracking: a term of the objective, None for none.
    """

    table: Table
    groups: Groups
    goal: Goal
    low: np.ndarray
    high: np.ndarray
    tracking: Tracking | None = None

    @property
    def takes_long(self) -> bool:
        """Whether a search is worth starting other processes for."""
        return self.table.response.size > _LONG

    def stable(self, x: np.ndarray) -> bool:
        """Whether every loop is stable at log-gains x."""
        return bool(growth_rates(self.table.loops, *self.groups.gains(x)).max() < 0.0)


def rows(
    case: RobotCase,
    x: np.ndarray,
    *,
    aim: bool = True,
    shy: float = 0.0,
    anchors: list[tuple[np.ndarray, np.ndarray]] | None = None,
) -> Rows:
    """Exact values and constraints at log-gains x of shape (2 g,), as those of one problem.

    Args:
        aim: False leaves the objective out.
        shy: how far inside the bounds to stay [ln].
        anchors: gains of the joints with which all loops were found stable, the last one at the
            end; those at x join them. Near the last one, no roots are computed.
    """
    goal = case.goal
    gains = case.groups.gains(x)
    S = sensitivity(case.table.response, *gains)
    usable = bool(anchors) and beside(case.table, S, gains, anchors[-1])  # type: ignore[index]
    if not usable:
        usable = case.stable(x)
        if usable and anchors is not None:
            anchors.append(gains)
    found = peaks(case.table, *gains, goal.wanted, S)
    size = len(x)
    excess, slopes = [np.empty(0)], [np.empty((0, size))]
    for _, metric, sign, bound in goal.rows:
        log, slope = _of_metric(case, found, metric, gains)
        excess.append((sign * (log - np.log(bound))).ravel() + shy)
        slopes.append((sign * slope).reshape(-1, size))
    value, value_slope = np.zeros(1), np.zeros((1, size))
    if aim and goal.metric == KP:
        value_slope = np.concatenate([case.groups.share, np.zeros(len(case.groups))])[None]
        value = value_slope @ x
    elif aim:
        log, slope = _of_metric(case, found, goal.metric, gains)
        value, value_slope = log.ravel(), slope.reshape(-1, size)
    if aim and usable and case.tracking is not None:
        rms, rms_slope = case.tracking.log_rms(x)
        usable = bool(np.isfinite(rms))
        value = value - case.tracking.weight * rms
        value_slope = value_slope - case.tracking.weight * rms_slope
    return Rows(
        value[None], value_slope[None], np.concatenate(excess)[None],
        np.concatenate(slopes)[None], np.array([usable]),
    )  # fmt: skip


def _of_metric(case: RobotCase, found, metric: str, gains) -> tuple[np.ndarray, np.ndarray]:
    """ln of a metric and its slopes by the log-gains; the disk margin is one over its peak."""
    sign = -1.0 if metric == "disk_margin" else 1.0
    by_log = found[metric].slope * np.stack(gains, axis=1)
    by_group = np.einsum("lraq,ag->lrqg", by_log, case.groups.spread)
    return sign * found[metric].log, sign * by_group.reshape(*by_group.shape[:2], -1)


def excess(case: RobotCase, x: np.ndarray) -> np.ndarray:
    """How far each loop is beyond its bounds at x, ln of the ratio, shape (l,); stable loops."""
    gains = case.groups.gains(x)
    found = peaks(case.table, *gains, case.goal.wanted)
    over = np.full(len(case.table.loops), -np.inf)
    for _, metric, sign, bound in case.goal.rows:
        log, _ = _of_metric(case, found, metric, gains)
        over = np.maximum(over, (sign * (log - np.log(bound))).max(axis=1))
    if case.goal.metric in found:
        # Of an objective, the worst loops count.
        peak = found[case.goal.metric].highest
        over = np.maximum(over, peak - peak.max())
    return over


def part(case: RobotCase, index: np.ndarray) -> RobotCase:
    """The same for some of the loops."""
    return replace(case, table=case.table.take(index))


@dataclass(frozen=True)
class Found:
    """Log-gains found.

    Attributes:
        x: shape (2 g,).
        value: of the objective, ln, signed so that larger is better [-].
        violation: largest excess [-], at most `polish.MET` where everything is met.
        evaluations: loops evaluated.
        steps: points at which.
    """

    x: np.ndarray
    value: float
    violation: float
    evaluations: int
    steps: int

    @property
    def met(self) -> bool:
        """Whether all bounds hold."""
        return self.violation <= MET

    @property
    def out_of_reach(self) -> bool:
        """Whether it would take too long to look closer at the point, which leads nowhere."""
        return self.violation > OUT_OF_REACH and len(self.x) > _FEW

    def rank(self) -> tuple[bool, float]:
        """Smaller is better: what meets the bounds by its value, then what exceeds them least."""
        return not self.met, -self.value if self.met else self.violation


def seen(case: RobotCase, x: np.ndarray, *, stable: bool = False) -> Found:
    """What is known of log-gains; of those that are known to be stable, no roots are computed."""
    known = rows(case, x, anchors=[case.groups.gains(x)] if stable else None)
    number = len(case.table.loops)
    return Found(x, float(known.worst_value[0]), float(known.violation[0]), number, 1)


def more(found: Found, evaluations: int, steps: int = 0) -> Found:
    """The same, with what else it took."""
    return replace(found, evaluations=found.evaluations + evaluations, steps=found.steps + steps)


def rescued(loops: OpenLoops, groups: Groups, x: np.ndarray, lag: float,
            low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, int]:  # fmt: skip
    """Log-gains near x at which every loop is stable, and the points tried.

    The largest growth rates of all loops are made small together, by the slopes of their roots.
    What cannot be made stable ends where its growth rate is smallest.

    Args:
        lag: that makes rates comparable [s].
    """

    def of(points: np.ndarray) -> Rows:
        return _growth_rows(loops, groups, points[0], lag)

    found = polish(of, x[None], low[None], high[None])
    return found.x[0], found.evaluations


def _growth_rows(loops: OpenLoops, groups: Groups, x: np.ndarray, lag: float) -> Rows:
    """Growth rates of the fastest roots of the worst loops, times the lag, as rows."""
    gains = groups.gains(x)
    worst = np.argsort(-growth_rates(loops, *gains))[:_UNSTABLE]
    excess, slopes = [], []
    for index in worst:
        M, _, _ = loops.closed(int(index), *gains)
        roots, left, right = scipy.linalg.eig(M, left=True, right=True)
        for k in np.argsort(-np.abs(roots))[:_ROOTS]:
            y, z = left[:, k].conj(), right[:, k]
            pushed, moved = y @ loops.B[index], loops.seen[index] @ z
            by_gain = -pushed[:, None] * moved / (y @ z) / roots[k]
            by_log = by_gain.real * np.stack(gains, axis=1)
            scale = lag / loops.period[index]
            excess.append(np.log(np.abs(roots[k])) * scale + _INSIDE)
            slopes.append(scale * (by_log.T @ groups.spread).ravel())
    nothing = np.zeros((1, 1)), np.zeros((1, 1, len(x)))
    return Rows(*nothing, np.array(excess)[None], np.array(slopes)[None], np.ones(1, bool))
