"""A robot's tuning as exact rows for the polish, and the way back from unstable gains.

The unknowns are the log-gains of the groups (`jaxact.tuning.groups`). Every peak of every loop is a
row, with the singular values next to the largest: the legs of a robot are alike, and so are theirs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy.linalg

from jaxact.parameters import KP
from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import Groups
from jaxact.tuning.newton import inside, newton
from jaxact.tuning.polish import MET, Polished, Problem, Rows, polish
from jaxact.tuning.robot.open_loops import OpenLoops
from jaxact.tuning.robot.peaks import Table, beside, columns, growth_rates, peaks, sensitivity
from jaxact.tuning.rollouts.tracking import Tracking

_ROUNDS = 12
# Points before whose rows count as well: at each, few of many singular values are rows.
_MEMORY = 12
# A polished point that exceeds the bounds by more is not led inside them by looking closer [ln]:
# left alone, except where it takes little, with few unknowns.
OUT_OF_REACH, _FEW = 0.3, 8
# A point that exceeds the bounds by less may be gone on from, whatever was missed [ln].
_SLIGHT = 0.03
# Step of difference quotients of slopes.
_APART = 1e-4
# No optimum is further inside all bounds than this [ln].
_SLACK = 1e-5
# How far inside the bounds the polish aims [ln]: peaks are refined to a few 1e-10.
_SHY = 1e-9
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


def problem(case: RobotCase, *, aim: bool = True) -> Problem:
    """The rows as a function of the log-gains, for the polish of one case."""

    anchors: list[tuple[np.ndarray, np.ndarray]] = []

    def of(x: np.ndarray) -> Rows:
        return rows(case, x[0], aim=aim, shy=_SHY, anchors=anchors)

    return of


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

    Only loops that are near their bounds are computed at every step, and at the frequencies of
    their peaks; all are looked at in between, and join if they turn out to matter.

    Args:
        aim: False leaves the objective out.
        steps: most linear programmes, of those that take large steps.
        fresh: False where x is nearly the best already.
        fine: False leaves out the last digits.
    """
    over = excess(case, x)
    near = np.zeros(len(over), bool)
    kept = np.zeros(case.table.angle.shape[1], bool)
    tried, number = len(over), 0
    stage = replace(_COARSE, steps=steps) if fresh else _FINE
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
