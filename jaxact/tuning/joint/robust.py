"""Gains for everything in a box of uncertainty: samples, corners, and the worst interior point.

The worst interior point is found by ascent on the uncertain parameters. If it is worse than the
members it becomes one, and the gains are polished again: a lucky sample cannot pass.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from jaxact.tuning import uncertainty
from jaxact.tuning.certificate import beyond, sentence
from jaxact.tuning.goal import Goal
from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.ensemble import Ensemble, chosen, joined
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.joint.response import timed as timed_of
from jaxact.tuning.joint.search import STARTS, Tuned, result_of, tune
from jaxact.tuning.optimise import Descent
from jaxact.tuning.phases import Phase, silent
from jaxact.tuning.polish import MET, polish
from jaxact.tuning.uncertainty import Box

# How often the worst interior point may join the members.
_EXCHANGES = 6


def tune_box(
    box: Box,
    goal: Goal,
    *,
    number: int = 32,
    seed: int = 0,
    start: tuple[float, float] | None = None,
    starts: int = STARTS,
    how: Descent | None = None,
    verify: bool = False,
    phase: Phase = silent,
) -> Tuned:
    """Gains for everything in a box of uncertainty.

    box: around the nominal plant
    number: of samples; where the worst member counts the corners are members too, and the worst
        interior point joins them until none is worse
    others: as for `tune`
    """
    begun = time.perf_counter()
    members = box.sample(number, seed)
    corners = box.corners()
    worst_counts = goal.tail == 0.0
    if worst_counts:
        members = joined(members, corners)
    tuned = tune(members, goal, start=start, starts=starts, how=how, verify=verify, phase=phase)
    evaluations, interior = tuned.evaluations, None
    for round_number in range(_EXCHANGES + 1):
        phase("looking for the worst point of the box")
        excess, worse = _interior(box, goal, tuned, seed)
        interior = excess
        if not worst_counts or excess <= MET or not tuned.feasible or round_number == _EXCHANGES:
            break
        names = tuple(f"interior {round_number}.{i}" for i in range(len(worse)))
        members = joined(members, replace(worse, names=names))
        tuned = _again(members, goal, tuned, start)
        evaluations += tuned.evaluations
    counted = replace(
        tuned.certificate,
        corners=len(corners) if worst_counts else 0,
        interior=interior if worst_counts else None,
        notes=() if worst_counts else (_outside(box, goal, tuned, interior),),
    )
    return replace(
        tuned, certificate=counted, evaluations=evaluations,
        verdict=sentence(counted, goal) if tuned.feasible and tuned.improved else tuned.verdict,
        seconds=time.perf_counter() - begun,
    )  # fmt: skip


def _interior(box: Box, goal: Goal, tuned: Tuned, seed: int) -> tuple[float, Ensemble]:
    """Largest excess in the box at the tuned gains, and the members that exceed the bounds."""
    x = np.log([tuned.kp, tuned.kd])

    def rise(members: Ensemble) -> tuple[np.ndarray, np.ndarray]:
        """By how much each member exceeds the bound it exceeds most, and that slope in the box."""
        found = joint.exact([Case(members, goal)], x[None])
        over = np.stack([sign * (found.log[f][0] - np.log(b)) for _, f, sign, b in goal.rows])
        slope = np.stack([sign * found.slope[f][0, :, 2:] for _, f, sign, b in goal.rows])
        over = np.where(found.stable, over, np.nan)
        row = np.argmax(np.where(np.isnan(over), np.inf, over), axis=0)
        column = np.arange(len(row))
        return over[row, column], slope[row, column]

    if not goal.rows:
        return -np.inf, box.place(np.empty((0, len(box.names))))
    points = box.place(uncertainty.worst_inside(box, rise, seed))
    value, _ = rise(points)
    value = np.where(np.isnan(value), np.inf, value)
    order = np.argsort(-value)
    worse = [int(i) for i in order[:4] if value[i] > MET]
    return float(value.max()), chosen(points, np.array(worse[:3], dtype=int))


def _again(members: Ensemble, goal: Goal, tuned: Tuned, start: tuple[float, float] | None) -> Tuned:
    """The same, polished once more from where it was, for more members."""
    begun = time.perf_counter()
    case = Case(members, goal)
    timed = timed_of(goal, [members])
    low, high = joint.log_bounds(goal)
    x = np.log([[tuned.kp, tuned.kd]])
    found = polish(joint.problem([case], timed), x, low[None], high[None])
    if not found.feasible[0]:
        return tune(members, goal, start=start)
    result = result_of(case, found.x[0], start, False, tuned.paths, timed,
                     tuned.iterations + found.evaluations, found.evaluations * len(members),
                     begun, False)  # fmt: skip
    return replace(
        result, certificate=replace(result.certificate, agreeing=tuned.certificate.agreeing)
    )


def _outside(box: Box, goal: Goal, tuned: Tuned, interior: float) -> str:
    """What the worst corner and interior point are like, where they are not what counts."""
    corners = box.corners()
    found = joint.exact([Case(corners, goal)], np.log([[tuned.kp, tuned.kd]]))
    if not found.stable.all():
        return f"unstable at {corners.name(int(np.argmin(found.stable[0])))}"
    return f"the worst point of the box {beyond(interior)}"
