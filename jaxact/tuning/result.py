"""Tuned gains, judged against everything asked and against the start."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxact.parameters import KP
from jaxact.reportable import Reportable
from jaxact.tuning.certificate import (
    Certificate,
    Check,
    Effort,
    Metrics,
    certify,
    over_all,
    sentence,
)
from jaxact.tuning.goal import OBJECTIVES, Goal
from jaxact.tuning.optimise import Descended
from jaxact.units import turned

if TYPE_CHECKING:
    from jaxact.loops.control_loop import ControlLoop
    from jaxact.tuning.joint.ensemble import Ensemble
    from jaxact.tuning.robot.loops import Situation
    from jaxact.tuning.robot.open_loops import OpenLoops
    from jaxact.tuning.robot.rows import RobotCase
    from jaxact.tuning.rollouts.tracking import Tracked

Gains = tuple[Any, Any]
"""kp and kd: numbers of a joint, arrays of shape (joints,) of a robot."""

UNSAMPLED = (
    "sampled controllers have other margins, mostly smaller: give a control rate to tune for them"
)
# A smooth violation up to this is the smoothing's own.
_SMOOTH = 0.01


@dataclass(frozen=True)
class OfRobot:
    """What a result has of a robot.

    Attributes:
        situations: the robot in every posture.
        case: its loops, and how its joints share their gains.
        tracked: errors in simulation, None where they were not asked for.
    """

    situations: tuple[Situation, ...]
    case: RobotCase
    tracked: Tracked | None = None


@dataclass(frozen=True, repr=False)
class Tuned(Reportable):
    """Tuned gains of a joint, an ensemble or a robot, and what is known of them.

    `certified` tells whether all that was asked for holds, `verdict` says it.

    Attributes:
        goal: what was asked.
        members: every plant, or every loop of a robot, that was looked at.
        kp: stiffness [N/m, of hinges N m/rad]; of a robot shape (joints,).
        kd: damping [N s/m, of hinges N m s/rad]; of a robot shape (joints,).
        value: metric of the objective, in its unit; of an ensemble the risk's, of a robot the worst
            loop's, of its stiffness the geometric mean; NaN where a member is unstable.
        value_before: the same of the start; NaN where none was given.
        before: gains (kp, kd) of the start, None where none was given.
        feasible: every constraint can be met.
        improved: the gains are better than the start's.
        certificate: what is guaranteed: every constraint, with its worst member.
        metrics, metrics_before: exact ones of all members, with the gains and with the start's.
        verdict: what came of it, in one sentence.
        closest: where the constraints cannot be met, the checks of the nearest point.
        paths: of all starts, the given one last.
        evaluations: loops evaluated, smooth and exact.
        iterations: steps of descent and polish.
        seconds: of wall clock, compilation included.
        robot: what there is of a robot, None of a joint.
        loop: the loop with the gains in it, of a robot in the first of its postures; None where no
            loop was given.
        front: results along the front of stiffness against robustness, () where none was asked for.
        interrupted: of a search that was interrupted (Ctrl-C), whose gains are the best certified
            ones until then, during what, and what was left out; "" of any other.
    """

    goal: Goal
    members: Ensemble | OpenLoops
    kp: Any
    kd: Any
    value: float
    value_before: float
    before: Gains | None
    feasible: bool
    improved: bool
    certificate: Certificate
    metrics: Metrics
    metrics_before: Metrics | None
    verdict: str
    closest: tuple[Check, ...]
    paths: Descended
    evaluations: int
    iterations: int
    seconds: float
    robot: OfRobot | None = None
    loop: ControlLoop | None = None
    front: tuple[Tuned, ...] = ()
    interrupted: str = ""

    def stopped(self, words: str) -> Tuned:
        """The same, interrupted; the words say during what, or what was left out."""
        return replace(self, interrupted="; ".join(filter(None, [self.interrupted, words])))

    @property
    def certified(self) -> bool:
        """Whether all that was asked for holds for every member, computed exactly.

        Members are samples and corners of the uncertainty's ranges, and the worst points between
        them that a search finds: it is thorough, and no proof for what lies between.
        """
        return self.certificate.met

    @property
    def units(self) -> tuple[str, str, str]:
        """Units of kp, of kd and of the objective's value."""
        rotary = {False}
        if self.robot is not None:
            rotary = {bool(hinge) for one in self.robot.situations for hinge in one.rotary}
        elif self.loop is not None:
            rotary = {self.loop.kind.unit == "rad"}
        kp = "N/m or N m/rad" if len(rotary) > 1 else "N m/rad" if True in rotary else "N/m"
        kd = "N s/m or N m s/rad" if len(rotary) > 1 else "N m s/rad" if True in rotary else "N s/m"
        of_goal = OBJECTIVES[self.goal.objective][2]
        of_goal = turned(of_goal) if rotary == {True} else of_goal
        return kp, kd, kp if self.goal.metric == KP else of_goal

    @property
    def continuous(self) -> bool:
        """Whether the loops are in continuous time, which no controller is."""
        return _continuous(self.members)

    def __repr__(self) -> str:
        """The loop with its gains, the verdict, and every constraint."""
        head = f"kp {self.kp}, kd {self.kd}" if self.loop is None else repr(self.loop)
        units = {"noise_gain": f" {self.units[0]}", "delay_margin": " s"}
        lines = [head, ("" if self.certified else "NOT ") + f"certified: {self.verdict}"]
        lines += [
            f"  {one.metric} {one.value:.6g}{units.get(one.metric, '')}"
            f" (asked: {one.bound:g}), {one.member}"
            for one in self.certificate.checks
        ]
        lines += [UNSAMPLED] if self.continuous else []
        lines += [f"  front of {len(self.front)} points"] if self.front else []
        lines += [self.interrupted] if self.interrupted else []
        return "\n".join(lines)


@dataclass(frozen=True)
class Outcome:
    """Where a search has led.

    Attributes:
        gains: kp and kd.
        met: every constraint is.
        metrics: exact ones of all members there, None where they are not known.
        paths: of the starts of the descent.
        evaluations: loops evaluated, smooth and exact.
        iterations: steps of descent and polish.
        begun: time of the beginning [s].
        effort: of the search for the best gains, None where it only went on from some.
        interior: largest excess in the box that was found, None where there was none.
        gap: to brute force, None where that was not asked for.
        notes: for the certificate.
        interrupted: how the search was interrupted, "" where it was not.
    """

    gains: Gains
    met: bool
    metrics: Metrics | None
    paths: Descended
    evaluations: int
    iterations: int
    begun: float
    effort: Effort | None = None
    interior: float | None = None
    gap: float | None = None
    notes: tuple[str, ...] = ()
    interrupted: str = ""


def judged(
    goal: Goal,
    members: Ensemble | OpenLoops,
    outcome: Outcome,
    look: Callable[[Gains], Metrics],
    *,
    start: Gains | None = None,
    inside: Callable[[Gains], float | None] = lambda gains: None,
    score: Callable[[Gains, float], float] = lambda gains, value: value,
    robot: OfRobot | None = None,
) -> Tuned:
    """Judge what a search has led to against everything asked, and against the start.

    Args:
        goal: what was asked.
        members: every plant, or every loop of a robot.
        outcome: of the search.
        look: from gains to exact metrics of all members.
        start: gains to be no worse than, None for none.
        inside: from gains to the largest excess in the box that is found with them.
        score: from gains and their value to the number in which they are compared.
        robot: what the result has of a robot.
    """

    gains = _inside(outcome.gains, goal)
    found = outcome.metrics if outcome.metrics is not None else look(gains)
    certificate = certify(goal, members, found, gains[0], outcome.interior)
    value = objective_value(goal, gains[0], found)
    improved, before, value_before = True, None, math.nan
    if start is not None:
        before = look(start)
        own = certify(goal, members, before, start[0])
        value_before = objective_value(goal, start[0], before)
        if own.met:
            own = replace(own, interior=inside(start))
        if not _wins(goal, score(gains, value), certificate, score(start, value_before), own):
            gains, found, certificate, value, improved = start, before, own, value_before, False
    closest = () if outcome.met else certificate.checks
    certificate = replace(
        certificate, agreeing=_agreeing(outcome.paths), gap=outcome.gap, notes=outcome.notes
    )
    words = sentence(certificate, goal, closest, outcome.effort, continuous=_continuous(members))
    if not improved and certificate.stable:
        why = "nothing better than the start was found until then"
        words = f"{why if outcome.interrupted else 'the start cannot be improved upon'}; {words}"
    tuned = Tuned(
        goal, members, gains[0], gains[1], value, value_before, start, outcome.met, improved,
        certificate, found, before, words, closest, outcome.paths, outcome.evaluations,
        outcome.iterations, time.perf_counter() - outcome.begun, robot,
    )  # fmt: skip
    return tuned.stopped(outcome.interrupted) if outcome.interrupted else tuned


def _continuous(members: Ensemble | OpenLoops) -> bool:
    """Whether the loops are in continuous time; a robot's never are."""
    sampling = getattr(members, "sampling", None)
    return sampling is not None and sampling.control_period is None


def _inside(gains: Gains, goal: Goal) -> Gains:
    """The gains, kp within its bounds to the last digit."""
    kp = np.clip(gains[0], goal.min_kp, goal.max_kp)
    return (kp, gains[1]) if np.ndim(kp) else (float(kp), float(gains[1]))


def objective_value(goal: Goal, kp: Any, found: Metrics) -> float:
    """The objective, in its unit; NaN where a member is unstable."""
    if not found.stable.all():
        return math.nan
    if goal.metric == KP:
        return float(np.exp(np.mean(np.log(kp)))) if np.size(kp) > 1 else float(np.ravel(kp)[0])
    return float(np.exp(-goal.sense * over_all(-goal.sense * found.log[goal.metric], goal)))


def _agreeing(paths: Descended) -> float:
    """Share of the starts that ended within 1 % of the best."""
    ends = np.where(paths.violation <= _SMOOTH, paths.value, -np.inf)
    top = ends.max()
    return float(np.mean(ends >= top - 0.01)) if np.isfinite(top) else 0.0


def _wins(
    goal: Goal, value: float, certificate: Certificate, before: float, start: Certificate
) -> bool:
    """Whether the tuned gains beat the start: what is met first, then the objective."""
    if certificate.met != start.met:
        return certificate.met
    if certificate.met:
        return goal.sense * (np.log(value) - np.log(before)) > 0.0
    # A start that is softer or stiffer than allowed is no answer, however stable.
    if certificate.bounds_met != start.bounds_met:
        return certificate.bounds_met
    if certificate.stable != start.stable:
        return certificate.stable
    return _missed(certificate) < _missed(start)


def _missed(certificate: Certificate) -> float:
    return max((c.excess for c in certificate.checks), default=0.0)
