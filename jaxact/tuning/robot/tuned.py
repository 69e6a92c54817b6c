"""What is known of a robot's gains: the result of a tuning, judged against everything asked."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxact.tuning.certificate import Certificate, Check, Effort, sentence
from jaxact.tuning.goal import Goal
from jaxact.tuning.groups import Groups
from jaxact.tuning.joint.search import wins
from jaxact.tuning.optimise import Descended
from jaxact.tuning.polish import MET
from jaxact.tuning.robot.exact import Exact, certificate, exact
from jaxact.tuning.robot.exchange import Reached
from jaxact.tuning.robot.loops import OpenLoops, Situation
from jaxact.tuning.robot.peaks import Table
from jaxact.tuning.robot.rows import RobotCase

Gains = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Tracked:
    """Simulated tracking errors, rms over ticks, joints, members and situations [rad or m].

    weight: of the term in the objective
    mode: of its derivatives
    rms: of the gains
    aside: of the gains that the margins alone lead to
    before: of the start; NaN where it is unstable, None where none was given
    """

    weight: float
    mode: str
    rms: float
    aside: float
    before: float | None


@dataclass(frozen=True)
class RobotTuned:
    """Gains of a robot, what they were tuned for, and what is known of them.

    situations, goal, groups: what was asked
    table: of all loops that were looked at
    kp, kd: gains of the joints [N/m or N m/rad], per second; shape (joints,)
    value: of the objective, in its unit
    value_before: of the start, NaN where it was unstable
    before: gains (kp, kd) of the start, None where none was given
    feasible: every constraint can be met
    improved: the gains are better than the start's
    certificate: of the gains returned; its members are loops
    exact, exact_before: figures of all loops, with the gains and with the start's
    verdict: one sentence
    closest: where the constraints cannot be met, the checks of the nearest point
    paths: of all starts
    evaluations: loops evaluated, smooth and exact
    iterations: steps of descent and polish
    seconds: of wall clock, compilation included
    tracked: errors in simulation, None where they were not asked for
    """

    situations: tuple[Situation, ...]
    goal: Goal
    groups: Groups
    table: Table
    kp: np.ndarray
    kd: np.ndarray
    value: float
    value_before: float
    before: Gains | None
    feasible: bool
    improved: bool
    certificate: Certificate
    exact: Exact
    exact_before: Exact | None
    verdict: str
    closest: tuple[Check, ...]
    paths: Descended
    evaluations: int
    iterations: int
    seconds: float
    tracked: Tracked | None

    @property
    def loops(self) -> OpenLoops:
        """All loops that were looked at."""
        return self.table.loops

    @property
    def certified(self) -> bool:
        """Whether everything that was asked for holds, exactly, for every loop."""
        return self.certificate.met


def no_path(x: np.ndarray) -> Descended:
    """The path of a search that has none, at log-gains x."""
    none = np.full((1, 1), np.nan)
    there = np.full((1, 1, 1), np.inf)
    return Descended(x[None, None], none, none + np.inf, x[None, None, None], there, there)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Spent:
    """What a search has cost.

    evaluations: loops evaluated, smooth and exact
    iterations: steps of descent and polish
    begun: time of the beginning [s]
    effort: of the search for the best gains, None where it only went on from some
    """

    evaluations: int
    iterations: int
    begun: float
    effort: Effort | None = None


def judged(
    situations: Sequence[Situation],
    reached: Reached,
    paths: Descended,
    spent: Spent,
    *,
    start: Gains | None = None,
    gap: float | None = None,
    aside: np.ndarray | None = None,
) -> RobotTuned:
    """Judge what a search has reached against everything asked, and against the start.

    paths: of the starts of the descent, `no_path` where there was none
    start: gains of the joints to be no worse than
    gap: to brute force, None where that was not asked for
    aside: log-gains that the margins alone led to
    """
    case, infeasible = reached.case, reached.found.violation > MET
    goal, groups = case.goal, case.groups
    gains = _inside(groups.gains(reached.found.x), goal)
    found, certificate, value = _figures(reached, gains, reached.known)
    closest = certificate.checks if infeasible else ()
    improved, before, value_before = True, None, float("nan")
    if start is not None:
        before, own, value_before = _figures(reached, start)
        scores = (_score(case, *pair) for pair in ((gains, value), (start, value_before)))
        after_score, before_score = scores
        if not wins(goal, after_score, certificate, before_score, own):
            gains, found, certificate, value, improved = start, before, own, value_before, False
            closest = certificate.checks if infeasible else ()
    certificate = replace(certificate, agreeing=_agreeing(paths), gap=gap)
    words = sentence(certificate, goal, closest, spent.effort)
    if not improved and certificate.stable:
        words = f"the start cannot be improved upon; {words}"
    return RobotTuned(
        tuple(situations), goal, groups, case.table, gains[0], gains[1], value,
        value_before, start, not infeasible, improved, certificate, found, before, words,
        tuple(closest), paths, spent.evaluations, spent.iterations,
        time.perf_counter() - spent.begun, _tracked(case, gains, aside, start),
    )  # fmt: skip


def _figures(
    reached: Reached, gains: Gains, known: Exact | None = None
) -> tuple[Exact, Certificate, float]:
    """Exact figures of all loops with gains of the joints, judged, and the objective.

    known: the figures, where they are known already
    """
    goal, loops = reached.case.goal, reached.case.table.loops
    wanted = tuple(sorted({*goal.wanted, "sensitivity_peak", "complementary_peak"}))
    if known is None or set(known.log) < set(wanted):
        known = exact(loops, *gains, wanted)
    corners = sum("corner" in name for name in loops.names)
    own = certificate(loops, known, goal, gains, corners, reached.interior)
    return known, own, _value(goal, gains, known)


def _agreeing(paths: Descended) -> float:
    """Share of the starts that ended within 1 % of the best."""
    ends = np.where(paths.violation <= 0.01, paths.value, -np.inf)
    top = ends.max()
    return float(np.mean(ends >= top - 0.01)) if np.isfinite(top) else 0.0


def _score(case: RobotCase, gains: Gains, value: float) -> float:
    """The objective with its term, in which gains are compared; NaN where a loop is unstable."""
    if case.tracking is None or np.isnan(value):
        return value
    rms, _ = case.tracking.log_rms(case.groups.log_gains(*gains))
    return float(value * np.exp(-case.tracking.weight * rms))


def _tracked(
    case: RobotCase,
    gains: Gains,
    aside: np.ndarray | None,
    start: Gains | None,
) -> Tracked | None:
    """The simulated errors, where they were asked for."""
    term = case.tracking
    if term is None or aside is None:
        return None

    def rms(x: np.ndarray) -> float:
        return float(np.exp(term.log_rms(x)[0])) if case.stable(x) else float("nan")

    before = None if start is None else rms(case.groups.log_gains(*start))
    after = rms(case.groups.log_gains(*gains))
    return Tracked(term.weight, term.mode, after, rms(aside), before)


def _inside(gains: Gains, goal: Goal) -> Gains:
    """The gains, kp within its bounds to the last digit."""
    return np.clip(gains[0], goal.min_kp, goal.max_kp), gains[1]


def _value(goal: Goal, gains: Gains, found: Exact) -> float:
    """The objective, in its unit; NaN where a loop is unstable."""
    if not found.stable.all():
        return float("nan")
    if goal.figure == "kp":
        return float(np.exp(np.mean(np.log(gains[0]))))
    return float(np.exp(found.log[goal.figure].min()))
