"""Tuning from end to end: starts, descent, polish, certificate.

tuned = tune(ensemble(0.7, 110.0, 0.9, 1e-3), Goal(max_peak=1.6))
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from jaxact.errors import UserError
from jaxact.tuning.certificate import Certificate, Check, Effort, certify, over_all, sentence
from jaxact.tuning.goal import Goal, check
from jaxact.tuning.joint import brute
from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.ensemble import Ensemble
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.joint.rescue import SLOWER, rescue
from jaxact.tuning.joint.response import timed as timed_of
from jaxact.tuning.optimise import Descended, Descent, descend
from jaxact.tuning.phases import Phase, silent
from jaxact.tuning.polish import Polished, better, polish

STARTS = 8
# A smooth violation up to this is the smoothing's own.
_SMOOTH = 0.01
# Starts that ended this near are one optimum [-].
_SAME, _WORTH = 0.03, 0.03


@dataclass(frozen=True)
class Tuned:
    """Gains, what they were tuned for, and what is known of them.

    members, goal: what was asked
    kp, kd: gains [N/m], [N s/m]
    value: figure of the objective, in its unit; for an ensemble the risk's
    value_before: of the start, NaN where it was unstable
    before: gains (kp, kd) of the start, None where none was given
    feasible: every constraint can be met
    improved: the gains are better than the start's
    certificate: of the gains returned
    verdict: one sentence
    closest: where the constraints cannot be met, the checks of the nearest point
    paths: of all starts, the given one last
    evaluations: loops evaluated, smooth and exact
    iterations: steps of descent and polish
    seconds: of wall clock, compilation included
    """

    members: Ensemble
    goal: Goal
    kp: float
    kd: float
    value: float
    value_before: float
    before: tuple[float, float] | None
    feasible: bool
    improved: bool
    certificate: Certificate
    verdict: str
    closest: tuple[Check, ...]
    paths: Descended
    evaluations: int
    iterations: int
    seconds: float

    @property
    def certified(self) -> bool:
        """Whether everything that was asked for holds, exactly, for every member."""
        return self.certificate.met


def tune(
    members: Ensemble,
    goal: Goal,
    *,
    start: tuple[float, float] | None = None,
    starts: int = STARTS,
    how: Descent | None = None,
    verify: bool = False,
    phase: Phase = silent,
) -> Tuned:
    """The best gains for one joint or one ensemble.

    members: one, or many that share the gains
    goal: objective and constraints
    start: (kp, kd) to be no worse than [N/m], [N s/m]; may be unstable
    starts: number of default starts, 0 for the given one alone
    how: of the descent
    verify: compare with brute force
    phase: told what is being done

    Raises UserError for a goal or a start that makes no sense.
    """
    given = None if start is None else [start]
    return tune_all(
        [Case(members, goal)], given, starts=starts, how=how, verify=verify, phase=phase
    )[0]


def tune_all(
    cases: Sequence[Case],
    given: Sequence[tuple[float, float]] | None = None,
    *,
    starts: int = STARTS,
    how: Descent | None = None,
    verify: bool = False,
    phase: Phase = silent,
) -> list[Tuned]:
    """The best gains of several cases, side by side in one compiled descent.

    cases: with as many members each, and goals that differ in their bounds only
    given: a start for each
    starts, how, verify, phase: as for `tune`
    """
    begun = time.perf_counter()
    how = how or Descent()
    _check(cases, given, starts)
    timed = timed_of(cases[0].goal, [case.members for case in cases])
    bounds = np.array([joint.log_bounds(case.goal) for case in cases])
    own = (
        None
        if given is None
        else np.clip(np.log(np.asarray(given, float)), bounds[:, 0], bounds[:, 1])
    )
    rescued, rescues = (None, 0) if own is None else _rescued(cases, own, bounds)
    first = np.stack([joint.starts(case, starts) for case in cases])
    if rescued is not None:
        first = np.concatenate([first, rescued[:, None]], axis=1)
    smooth = joint.JointSurrogate(joint.family(cases[0].goal), timed)
    slower = np.asarray(SLOWER, np.float32)
    phase(f"descending from {first.shape[1]} starts")
    paths = descend(smooth, joint.table(cases), np.asarray(first, np.float32), slower, how)
    paths = jax.tree.map(np.asarray, paths)
    phase("polishing")
    found, polishing = _polished(cases, paths, bounds, timed)
    lost = ~found.feasible
    if lost.any():
        phase("looking for the closest gains")
    closest = _closest(cases, paths, bounds, timed, found) if lost.any() else found
    steps = how.steps + how.polish + polishing + rescues
    number = first.shape[1] * (how.steps + how.polish) + polishing + rescues
    phase("certifying")
    results = []
    for i, case in enumerate(cases):
        x = (closest if lost[i] else found).x[i]
        start = None if given is None else (float(given[i][0]), float(given[i][1]))
        own_paths = jax.tree.map(lambda a, i=i: a[i], paths)
        tried = number * len(case.members)
        results.append(
            result_of(case, x, start, bool(lost[i]), own_paths, timed, steps, tried, begun, verify)
        )
    return results


def _check(cases: Sequence[Case], given: Sequence[tuple[float, float]] | None, starts: int) -> None:
    for case in cases:
        check(case.goal)
        bounded = case.goal.objective == "disk-margin" or np.isfinite(case.goal.max_kp)
        unlimited = not case.goal.active and not bounded
        if unlimited or not np.all(joint.time_scale(case) > 0.0):
            raise UserError(
                "nothing limits the gains; give an actuator, a delay, a control rate, a constraint "
                "or `max_kp`"
            )
    if starts < 0 or (starts == 0 and given is None):
        raise UserError(f"{starts} starts: give at least one, or gains to start from")
    for kp, kd in given or ():
        if not (0 < kp < np.inf and 0 < kd < np.inf):
            raise UserError(f"start kp {kp:g}, kd {kd:g}: both must be positive and finite")


def _rescued(cases: Sequence[Case], x: np.ndarray, bounds: np.ndarray) -> tuple[np.ndarray, int]:
    """The given starts, brought to where every member is stable."""

    def distance(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the worst member of every start: how far from its boundary, and the gradient."""
        found = joint.exact(cases, x)
        value = np.where(found.stable, np.abs(found.log["log_gain_to_boundary"]),
                         found.log["log_gain_to_boundary"])  # fmt: skip
        worst = np.argmin(value, axis=1)[:, None]
        slope = found.gain_slope["log_gain_to_boundary"]
        chosen_slope = np.take_along_axis(slope, worst[..., None], axis=1)[:, 0]
        return np.take_along_axis(value, worst, axis=1)[:, 0], chosen_slope

    there, steps = rescue(distance, x, SLOWER, bounds[:, 0], bounds[:, 1])
    return there, int(steps.max(initial=0))


def candidates(case: int, paths: Descended) -> list[np.ndarray]:
    """Where to polish: the best end, and others that are as good but elsewhere."""
    value, violation = paths.value[case], paths.violation[case]
    met = violation <= _SMOOTH
    score = np.where(met, value, -1e3 - violation) if met.any() else -violation
    score = np.where(np.isfinite(score), score, -np.inf)
    kept: list[np.ndarray] = []
    for index in np.argsort(-score):
        x = np.asarray(paths.gains[case, index], float)
        near = any(np.max(np.abs(x - other)) < _SAME for other in kept)
        if np.isfinite(score[index]) and score[index] >= score.max() - _WORTH and not near:
            kept.append(x)
    return kept[:3] or [np.asarray(paths.gains[case, 0], float)]


def _polished(
    cases: Sequence[Case], paths: Descended, bounds: np.ndarray, timed: Any
) -> tuple[Polished, int]:
    """The best of all candidates of each case, polished side by side."""
    owner, points = [], []
    for i in range(len(cases)):
        for x in candidates(i, paths):
            owner.append(i)
            points.append(x)
    problem = joint.problem([cases[i] for i in owner], timed)
    found = polish(problem, np.array(points), bounds[owner, 0], bounds[owner, 1])
    return _best_of(found, np.array(owner), len(cases)), found.evaluations


def _best_of(found: Polished, owner: np.ndarray, number: int) -> Polished:
    pick = []
    for i in range(number):
        best, *rest = np.flatnonzero(owner == i)
        for other in rest:
            if better(found.value[other], found.violation[other],
                      found.value[best], found.violation[best]):  # fmt: skip
                best = other
        pick.append(best)
    return Polished(found.x[pick], found.value[pick], found.violation[pick], found.evaluations)


def _closest(
    cases: Sequence[Case], paths: Descended, bounds: np.ndarray, timed: Any, found: Polished
) -> Polished:
    """The points where the worst violation is smallest; the objective does not count."""
    problem = joint.problem(cases, timed, aim=False)
    nearest = polish(problem, found.x, bounds[:, 0], bounds[:, 1])
    over_plane = np.array([
        found.x[i] if met else brute.nearest(case, timed).x
        for i, (case, met) in enumerate(zip(cases, found.feasible, strict=True))
    ])  # fmt: skip
    others = [over_plane, *_least_violating(paths)]
    for start in others:
        again = polish(problem, start, bounds[:, 0], bounds[:, 1])
        closer = again.violation < nearest.violation
        nearest = Polished(
            np.where(closer[:, None], again.x, nearest.x), nearest.value,
            np.where(closer, again.violation, nearest.violation), nearest.evaluations,
        )  # fmt: skip
    return nearest


def _least_violating(paths: Descended) -> list[np.ndarray]:
    """The three ends of every case that violate its constraints least, shape (cases, 2) each."""
    places = np.argsort(paths.violation, axis=1)[:, :3].T
    return [
        np.take_along_axis(paths.gains, place[:, None, None], axis=1)[:, 0].astype(float)
        for place in places
    ]


def objective_value(case: Case, x: np.ndarray, timed: Any) -> float:
    """The figure of the objective at log-gains x, in its unit; for an ensemble the risk's."""
    goal = case.goal
    if goal.figure == "kp":
        return float(np.exp(x[0]))
    found = joint.exact([case], x[None], timed)
    if not found.stable.all():
        return float("nan")
    bad = -goal.sense * found.log[goal.figure][0]
    return float(np.exp(-goal.sense * over_all(bad, goal)))


def result_of(
    case: Case,
    x: np.ndarray,
    start: tuple[float, float] | None,
    infeasible: bool,
    paths: Descended,
    timed: Any,
    iterations: int,
    evaluations: int,
    begun: float,
    verify: bool,
) -> Tuned:
    """Judge gains of one case, exactly, against everything asked and against the start.

    x: log-gains, shape (2,)
    start: (kp, kd) to be no worse than, None for none
    infeasible: whether the constraints cannot all be met; x is then the closest point
    paths: of the starts of this case
    timed: of the goal, None for one that needs no simulation
    iterations, evaluations: so far
    begun: time of the beginning [s]
    verify: compare with brute force
    """
    goal = case.goal
    certificate = certify(case, x)
    closest = certificate.checks if infeasible else ()
    improved = True
    value, value_before = objective_value(case, x, timed), float("nan")
    if start is not None:
        own = np.log(np.array(start))
        before = certify(case, own)
        value_before = objective_value(case, own, timed) if before.stable else float("nan")
        if not wins(goal, value, certificate, value_before, before):
            x, value, certificate, improved = own, value_before, before, False
            closest = certificate.checks if infeasible else ()
    ends = np.where(paths.violation <= _SMOOTH, paths.value, -np.inf)
    top = ends.max()
    agreeing = float(np.mean(ends >= top - 0.01)) if np.isfinite(top) else 0.0
    certificate = replace(certificate, agreeing=agreeing)
    if verify and certificate.met:
        tried = brute.brute_force(case, timed)
        ours = goal.sense * np.log(value)
        gap = float(np.expm1(max(tried.value - ours, 0.0)))
        certificate = replace(certificate, gap=gap)
        if tried.value > ours + 1e-3:
            x = tried.x
            value = objective_value(case, x, timed)
            certificate = replace(certify(case, x), agreeing=agreeing, gap=gap)
        evaluations += tried.evaluations * len(case.members)
    effort = Effort(paths.gains.shape[0], brute.GRID**2)
    words = sentence(certificate, goal, closest, effort)
    if not improved and certificate.stable:
        words = f"the start cannot be improved upon; {words}"
    kp, kd = start if start is not None and not improved else map(float, np.exp(x))
    kp = min(max(kp, goal.min_kp), goal.max_kp) if improved else kp
    return Tuned(
        case.members, goal, kp, kd, value, value_before, start,
        not infeasible, improved, certificate, words, tuple(closest), paths, evaluations,
        iterations, time.perf_counter() - begun,
    )  # fmt: skip


def wins(
    goal: Goal, value: float, certificate: Certificate, before: float, start: Certificate
) -> bool:
    """Whether the tuned gains beat the start: everything met first, then the objective."""
    if certificate.met != start.met:
        return certificate.met
    if certificate.met:
        return goal.sense * (np.log(value) - np.log(before)) > 0.0
    if certificate.stable != start.stable:
        return certificate.stable
    return _missed(certificate) < _missed(start)


def _missed(certificate: Certificate) -> float:
    missed = max((c.excess for c in certificate.checks), default=0.0)
    return max(missed, 0.0) + (0.0 if certificate.bounds_met else 1.0)
