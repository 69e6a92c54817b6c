"""From where a joint's gains are searched for to the best of them: rescue, ends, polish."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np

from jaxact.parameters import KP
from jaxact.tuning.joint import brute
from jaxact.tuning.joint import problem as joint
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.joint.rescue import SLOWER, rescue
from jaxact.tuning.newton import newton
from jaxact.tuning.optimise import Descended
from jaxact.tuning.polish import Polished, better, polish

# A smooth violation up to this is the smoothing's own.
_SMOOTH = 0.01
# Starts that ended this near are one optimum [-].
_SAME, _WORTH = 0.03, 0.03
# Up to so many problems are settled one by one first, and how near to the best they then are [-].
_FEW, _NEAR = 4, 1e-3


def rescued(cases: Sequence[Case], x: np.ndarray, bounds: np.ndarray) -> tuple[np.ndarray, int]:
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


def _candidates(case: int, paths: Descended) -> list[np.ndarray]:
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


def polished(
    cases: Sequence[Case], paths: Descended, bounds: np.ndarray, timed: Any
) -> tuple[Polished, int]:
    """The best of all candidates of each case, polished side by side."""
    owner, points = [], []
    for i in range(len(cases)):
        for x in _candidates(i, paths):
            owner.append(i)
            points.append(x)
    own, x, (low, high) = [cases[i] for i in owner], np.array(points), bounds[owner].swapaxes(0, 1)
    tried, radius = 0, {}
    if len(own) <= _FEW and cases[0].goal.metric == KP:
        ends = [_settled(*each) for each in zip(own, x, low, high, strict=True)]
        tried = max(end.evaluations for end in ends)
        if all(end.feasible[0] for end in ends):
            x, radius = np.concatenate([end.x for end in ends]), {"radius": _NEAR}
    found = polish(joint.problem(own, timed), x, low, high, **radius)
    return _best_of(found, np.array(owner), len(cases)), tried + found.evaluations


def _settled(case: Case, x: np.ndarray, low: np.ndarray, high: np.ndarray) -> Polished:
    """Newton's steps for one case, which take fewer evaluations than linear programmes."""
    return newton(joint.problem([case]), partial(joint.curvature, case), x, low, high)


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


def closest(
    cases: Sequence[Case], paths: Descended, bounds: np.ndarray, timed: Any, found: Polished
) -> Polished:
    """The points where the worst violation is smallest; the objective does not count."""
    problem = joint.problem(cases, timed, aim=False)
    nearest = polish(problem, found.x, bounds[:, 0], bounds[:, 1])
    over_plane = np.array([
        found.x[i] if met else brute.nearest(case).x
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
