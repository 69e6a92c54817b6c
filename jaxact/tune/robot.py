"""Gains for a whole robot, from end to end: situations and actuators, descent, polish, certificate.

    stand = situation(specification, "stand")
    tuned = tune([stand], Goal(max_peak=2.0), group(["hip", "knee"], stand.names))

The constraints are those of a joint, on the largest singular values of S and T and on the
multi-loop disk margin, of every situation with every actuator. Stiffness is the geometric mean of
the joints'.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from jaxact.errors import UserError
from jaxact.tune import robot_brute, robot_certificate, robot_tracking
from jaxact.tune.certificate import Certificate, Check, sentence
from jaxact.tune.goal import Goal, check
from jaxact.tune.groups import Groups
from jaxact.tune.optimize import Descended, Descent
from jaxact.tune.polish import MET
from jaxact.tune.robot_certificate import Exact, exact
from jaxact.tune.robot_exchange import exchanged
from jaxact.tune.robot_figures import Table, tabulate
from jaxact.tune.robot_loops import OpenLoops, Situation, open_loops
from jaxact.tune.robot_rows import RobotCase, polished
from jaxact.tune.robot_search import (
    approached,
    best_of,
    bounds,
    descended,
    hardest,
    stabilised,
    starts_around,
    usual,
)  # fmt: skip
from jaxact.tune.robot_tracking import Wish
from jaxact.tune.robot_uncertainty import NOMINAL, corners, joined, sample
from jaxact.tune.run import wins

STARTS, STEPS = 8, 80
OBJECTIVES = ("stiffness", "disk-margin")
# What of a goal a robot can be asked for.
BOUNDS = ("max_peak", "min_disk_margin", "min_kp", "max_kp")


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
    before: tuple[np.ndarray, np.ndarray] | None
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


def tune(
    situations: Sequence[Situation],
    goal: Goal,
    groups: Groups,
    *,
    number: int = 8,
    seed: int = 0,
    start: tuple[np.ndarray, np.ndarray] | None = None,
    starts: int = STARTS,
    steps: int = STEPS,
    verify: bool = False,
    wish: Wish | None = None,
) -> RobotTuned:
    """The best gains of a robot's groups of joints.

    situations: of one robot, with the same joints and the same box of what is uncertain; its
        corners and worst interior points are members too
    goal: objective and constraints, of every situation with every member
    groups: of the joints
    number: of samples of the box
    seed: of the samples
    start: (kp, kd) of the joints to be no worse than, shape (joints,) each; may be unstable
    starts, steps: of the descent
    verify: compare with brute force
    wish: to weigh simulated tracking in the objective, None for margins alone

    Raises UserError for a goal, situations or a start that make no sense.
    """
    begun = time.perf_counter()
    _check(situations, goal, groups, start)
    if wish is not None:
        robot_tracking.check(wish, len(groups))
        wish = wish if wish.weight > 0.0 else None
    if wish is not None and verify:
        raise UserError("--verify: knows of no --tracking-weight")
    if verify and len(groups) > robot_brute.MOST_GROUPS:
        raise UserError(
            f"--verify: tries {2 * len(groups)} gains against each other, which takes too long; "
            f"group the joints, {robot_brute.MOST_GROUPS} groups at most"
        )
    spans = situations[0].spans
    members = joined(sample(spans, number, seed), corners(spans)) if spans else NOMINAL
    loops = open_loops(situations, members)
    own = None if start is None else groups.log_gains(*start)
    x = usual(situations, groups) if own is None else own
    low, high = bounds(goal, groups, x)
    case = RobotCase(tabulate(loops), groups, goal, low, high)
    x, tried = stabilised(case, situations, np.clip(x, low, high))
    if not case.stable(x):
        nothing = _no_path(x)
        return _result(situations, case, x, start, nothing, None, tried, 0, begun)
    near = approached(case, x)
    first = starts_around(case, near.x, starts, seed)
    how = Descent(steps=steps, polish=0)
    small = hardest(case, near.x)
    paths = descended(small, first, how)
    found = best_of(case, near, paths)
    tried += near.evaluations + found.evaluations
    tried += first.shape[0] * steps * len(small.table.loops)
    case, found, interior, known = exchanged(case, situations, found, seed)
    aside = found.x
    if wish is not None and found.violation <= MET:
        fractions = [loops.fraction[loops.situation == s] for s in range(len(situations))]
        term = robot_tracking.tracking(situations, fractions, groups, wish)
        case = replace(case, tracking=term)
        traded = polished(case, found.x, fresh=False)
        case, traded, interior, known = exchanged(case, situations, traded, seed)
        if traded.violation <= MET:
            tried, found = tried + found.evaluations, traded
        else:
            tried, known = tried + traded.evaluations, None
    gap = None
    if verify and found.violation <= MET:
        brute = robot_brute.brute_force(case, found.x)
        tried += brute.evaluations
        gap = float(np.expm1(max(brute.value - found.value, 0.0)))
        if brute.value > found.value + 1e-3:
            found, known = brute, None
    return _result(
        situations, case, found.x, start, paths, interior, tried + found.evaluations,
        steps + near.steps + found.steps, begun, gap=gap, infeasible=found.violation > MET,
        known=known, aside=aside,
    )  # fmt: skip


def _check(
    situations: Sequence[Situation],
    goal: Goal,
    groups: Groups,
    start: tuple[np.ndarray, np.ndarray] | None,
) -> None:
    check(goal)
    if goal.objective not in OBJECTIVES:
        raise UserError(f"objective '{goal.objective}': of a robot stiffness or disk-margin")
    for name in goal.active:
        if name not in BOUNDS:
            raise UserError(f"--{name.replace('_', '-')}: is for a single joint")
    if goal.risk != "worst":
        raise UserError("--risk: of a robot every loop counts, worst")
    if goal.objective == "stiffness" and not goal.active:
        raise UserError("nothing limits the gains; give --max-peak or --min-disk-margin")
    for one in situations:
        joints = tuple(name for name, _ in one.names)
        if one.spans != situations[0].spans:
            raise UserError(f"'{one.name}': what is uncertain is not as for the others")
        if joints != groups.joints:
            raise UserError(
                f"the joints of '{one.name}' are not those of '{situations[0].name}': "
                f"{', '.join(joints)}"
            )
    if start is not None and not all(np.all((k > 0) & np.isfinite(k)) for k in start):
        raise UserError("gains to start from must be positive and finite")


def _no_path(x: np.ndarray) -> Descended:
    """The path of a search that had nowhere to begin."""
    none = np.full((1, 1), np.nan)
    there = np.full((1, 1, 1), np.inf)
    return Descended(x[None, None], none, none + np.inf, x[None, None, None], there, there)  # type: ignore[arg-type]


def _result(
    situations: Sequence[Situation],
    case: RobotCase,
    x: np.ndarray,
    start: tuple[np.ndarray, np.ndarray] | None,
    paths: Descended,
    interior: float | None,
    evaluations: int,
    iterations: int,
    begun: float,
    *,
    gap: float | None = None,
    infeasible: bool = True,
    known: Exact | None = None,
    aside: np.ndarray | None = None,
) -> RobotTuned:
    """Judge log-gains against everything asked, and against the start.

    known: exact figures at x, where they are known already
    aside: log-gains that the margins alone led to
    """
    goal, groups, loops = case.goal, case.groups, case.table.loops
    wanted = tuple(sorted({*goal.wanted, "sensitivity_peak", "complementary_peak"}))
    ends = sum("corner" in name for name in loops.names)

    def judged(
        gains: tuple[np.ndarray, np.ndarray], known: Exact | None = None
    ) -> tuple[Exact, Certificate, float]:
        if known is None or set(known.log) < set(wanted):
            known = exact(loops, *gains, wanted)
        judged = robot_certificate.certificate(loops, known, goal, gains, ends, interior)
        return known, judged, _value(goal, gains, known)

    gains = _inside(groups.gains(x), goal)
    found, certificate, value = judged(gains, known)
    closest = certificate.checks if infeasible else ()
    improved, before, value_before = True, None, float("nan")
    if start is not None:
        before, own, value_before = judged(start)
        scores = (_score(case, *pair) for pair in ((gains, value), (start, value_before)))
        after_score, before_score = scores
        if not wins(goal, after_score, certificate, before_score, own):
            gains, found, certificate, value, improved = start, before, own, value_before, False
    ends_value = np.where(paths.violation <= 0.01, paths.value, -np.inf)
    top = ends_value.max()
    agreeing = float(np.mean(ends_value >= top - 0.01)) if np.isfinite(top) else 0.0
    certificate = replace(certificate, agreeing=agreeing, gap=gap)
    words = sentence(certificate, goal, closest)
    if not improved:
        words = f"the start cannot be improved upon; {words}"
    return RobotTuned(
        tuple(situations), goal, groups, case.table, gains[0], gains[1], value,
        value_before, start, not infeasible, improved, certificate, found, before, words,
        tuple(closest), paths, evaluations, iterations, time.perf_counter() - begun,
        _tracked(case, gains, aside, start),
    )  # fmt: skip


def _score(case: RobotCase, gains: tuple[np.ndarray, np.ndarray], value: float) -> float:
    """The objective with its term, in which gains are compared; NaN where a loop is unstable."""
    if case.tracking is None or np.isnan(value):
        return value
    rms, _ = case.tracking.log_rms(case.groups.log_gains(*gains))
    return float(value * np.exp(-case.tracking.weight * rms))


def _tracked(
    case: RobotCase,
    gains: tuple[np.ndarray, np.ndarray],
    aside: np.ndarray | None,
    start: tuple[np.ndarray, np.ndarray] | None,
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


def _inside(gains: tuple[np.ndarray, np.ndarray], goal: Goal) -> tuple[np.ndarray, np.ndarray]:
    """The gains, kp within its bounds to the last digit."""
    return np.clip(gains[0], goal.min_kp, goal.max_kp), gains[1]


def _value(goal: Goal, gains: tuple[np.ndarray, np.ndarray], found: Exact) -> float:
    """The objective, in its unit; NaN where a loop is unstable."""
    if not found.stable.all():
        return float("nan")
    if goal.figure == "kp":
        return float(np.exp(np.mean(np.log(gains[0]))))
    return float(np.exp(found.log[goal.figure].min()))
