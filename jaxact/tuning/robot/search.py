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
from dataclasses import replace

import numpy as np

from jaxact.errors import UserError
from jaxact.tuning.certificate import Effort
from jaxact.tuning.goal import Goal, check
from jaxact.tuning.groups import Groups
from jaxact.tuning.optimise import Descended, Descent
from jaxact.tuning.phases import Phase, silent
from jaxact.tuning.polish import MET
from jaxact.tuning.robot import brute
from jaxact.tuning.robot.descent import (  # fmt: skip
    approached,
    best_of,
    bounds,
    descended,
    hardest,
    stabilised,
    usual,
)
from jaxact.tuning.robot.exchange import Reached, exchanged
from jaxact.tuning.robot.loops import Situation, open_loops
from jaxact.tuning.robot.peaks import tabulate
from jaxact.tuning.robot.rows import Found, RobotCase, more, polished
from jaxact.tuning.robot.starts import Screened, apart, screened
from jaxact.tuning.robot.tuned import Gains, RobotTuned, Spent, judged, no_path
from jaxact.tuning.robot.uncertainty import NOMINAL, corners, joined, sample
from jaxact.tuning.rollouts import tracking as robot_tracking
from jaxact.tuning.rollouts.tracking import Wish

STARTS, STEPS = 8, 80
OBJECTIVES = ("stiffness", "disk-margin")
# What of a goal a robot can be asked for.
BOUNDS = ("max_peak", "min_disk_margin", "min_kp", "max_kp")


def tune(
    situations: Sequence[Situation],
    goal: Goal,
    groups: Groups,
    *,
    number: int = 8,
    seed: int = 0,
    start: Gains | None = None,
    starts: int = STARTS,
    steps: int = STEPS,
    verify: bool = False,
    wish: Wish | None = None,
    phase: Phase = silent,
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
    phase: told what is being done

    Raises UserError for a goal, situations or a start that make no sense.
    """
    begun = time.perf_counter()
    _check(situations, goal, groups, start)
    wish = _checked(wish, groups, verify=verify)
    phase("screening gains over orders of magnitude")
    case, x, known = _begun(situations, goal, groups, start, number, seed)
    if not case.stable(x):
        nowhere = Reached(case, Found(x, -np.inf, np.inf, 0, 0), None, None)
        spent = Spent(known.tried, 0, begun, Effort(0, known.tried))
        return judged(situations, nowhere, no_path(x), spent, start=start)
    paths, found = _searched(case, x, known, starts, steps, phase)
    phase("certifying")
    reached = exchanged(case, situations, found, seed)
    aside, gap = reached.found.x, None
    if wish is not None and reached.found.violation <= MET:
        phase("weighing simulated tracking")
        reached = _traded(reached, situations, wish, seed)
    if verify and reached.found.violation <= MET:
        phase("comparing with brute force")
        reached, gap = _verified(reached)
    found = reached.found
    effort = Effort(starts, known.tried)
    spent = Spent(known.tried + found.evaluations, steps + found.steps, begun, effort)
    return judged(situations, reached, paths, spent, start=start, gap=gap, aside=aside)


def _begun(
    situations: Sequence[Situation],
    goal: Goal,
    groups: Groups,
    start: Gains | None,
    number: int,
    seed: int,
) -> tuple[RobotCase, np.ndarray, Screened]:
    """All loops of the box, log-gains near the start, and those with which all loops are stable."""
    spans = situations[0].spans
    members = joined(sample(spans, number, seed), corners(spans)) if spans else NOMINAL
    plain = usual(situations, groups)
    x = plain if start is None else groups.log_gains(*start)
    low, high = bounds(goal, groups, x, plain)
    case = RobotCase(tabulate(open_loops(situations, members)), groups, goal, low, high)
    x = np.clip(x, low, high)
    inertia = np.min([one.inertias for one in situations], axis=0)
    known = screened(case, x, inertia, max(one.lag for one in situations), seed)
    stable = np.array([case.stable(x) for x in known.x], bool)
    known = replace(known, x=known.x[stable], value=known.value[stable],
                    violation=known.violation[stable])  # fmt: skip
    there, tried = (x, 0) if case.stable(x) else stabilised(case, situations, x)
    if not case.stable(there):
        there = known.x[0] if len(known.x) else there
    return case, there, replace(known, tried=known.tried + tried)


def _searched(
    case: RobotCase, x: np.ndarray, known: Screened, starts: int, steps: int, phase: Phase
) -> tuple[Descended, Found]:
    """The paths of a descent from many gains, and the best of their ends, polished."""
    near = approached(case, x)
    others = apart(known, starts)[: starts - 1]
    first = np.concatenate([near.x[None], others])
    first = first[np.arange(starts) % len(first)]
    small = hardest(case, near.x)
    phase(f"descending from {starts} starts")
    paths = descended(small, first, Descent(steps=steps, polish=0))
    found = best_of(case, near, paths, others, phase)
    tried = near.evaluations + first.shape[0] * steps * len(small.table.loops)
    return paths, more(found, tried, near.steps)


def _traded(reached: Reached, situations: Sequence[Situation], wish: Wish, seed: int) -> Reached:
    """The same with simulated tracking in the objective; as it was where that leads nowhere."""
    loops = reached.case.table.loops
    fractions = [loops.fraction[loops.situation == s] for s in range(len(situations))]
    term = robot_tracking.tracking(situations, fractions, reached.case.groups, wish)
    case = replace(reached.case, tracking=term)
    before = reached.found
    traded = more(polished(case, before.x, fresh=False), before.evaluations, before.steps)
    after = exchanged(case, situations, traded, seed)
    if after.found.violation <= MET:
        return after
    spent = {"evaluations": after.found.evaluations, "steps": after.found.steps}
    return Reached(after.case, replace(before, **spent), after.interior, None)


def _verified(reached: Reached) -> tuple[Reached, float]:
    """The best of a grid where that is better, and by how much it is."""
    found = reached.found
    best = brute.brute_force(reached.case, found.x)
    gap = float(np.expm1(max(best.value - found.value, 0.0)))
    if best.value > found.value + 1e-3:
        return replace(reached, found=more(best, found.evaluations), known=None), gap
    return replace(reached, found=more(found, best.evaluations)), gap


def _instead(name: str, goal: Goal) -> str:
    """What to ask of a robot instead of a bound of a single joint."""
    if name == "min_gain_margin":
        factor = goal.min_gain_margin
        # (2 + a) / (2 - a) of a balanced disk margin a
        disk = 2.0 * (factor - 1.0) / (factor + 1.0)
        return (
            f"`min_disk_margin` {disk:.4g} leaves a factor of {factor:g} on the gains of every "
            "joint by its own"
        )
    if name == "min_delay_margin":
        return (
            f"`uncertainty` output_delay=0..{goal.min_delay_margin:g} makes all bounds hold with "
            "so much more delay"
        )
    return "`max_kp` and `max_peak` keep the noise down, and `validate` simulates it"


def _checked(wish: Wish | None, groups: Groups, *, verify: bool) -> Wish | None:
    """What is wished, None for nothing."""
    if wish is not None:
        robot_tracking.check(wish, len(groups))
        wish = wish if wish.weight > 0.0 else None
    if wish is not None and verify:
        raise UserError("`verify`: cannot be combined with `tracking_weight`")
    if verify and len(groups) > brute.MOST_GROUPS:
        raise UserError(
            f"`verify`: tries {2 * len(groups)} gains against each other, which takes too long; "
            f"group the joints, {brute.MOST_GROUPS} groups at most"
        )
    return wish


def _check(
    situations: Sequence[Situation],
    goal: Goal,
    groups: Groups,
    start: Gains | None,
) -> None:
    check(goal)
    if goal.objective not in OBJECTIVES:
        raise UserError(f"objective '{goal.objective}': of a robot stiffness or disk-margin")
    for name in goal.active:
        if name not in BOUNDS:
            raise UserError(f"`{name}`: is for a single joint; of a robot {_instead(name, goal)}")
    if goal.risk != "worst":
        raise UserError(
            f"`risk` {goal.risk}: of a robot every loop counts, worst; leave out what need not "
            "hold by a narrower `uncertainty`"
        )
    if goal.objective == "stiffness" and not goal.active:
        raise UserError("nothing limits the gains; give `max_peak` or `min_disk_margin`")
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
