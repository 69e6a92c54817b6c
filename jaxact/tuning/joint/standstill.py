"""Gains for tracking that leave the joint where it is: hardly any, which no slope leads away from.

Where kp vanishes, so does the slope of the error by ln kp. A search that ends there may have missed
gains that track, or there are none within the bounds that do better than standing still.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from jaxact.tuning.goal import Goal
from jaxact.tuning.joint.brute import plane
from jaxact.tuning.joint.problem import Case, problem
from jaxact.tuning.polish import MET, Polished, polish

# An error this near to that of a joint that stands still is that one.
_NEAR = 1e-3
# Gains of a grid along each axis, and how many of those that keep the bounds are simulated.
_GRID, _POINTS = 24, 64

NOTE = "no gains are known that keep the bounds and track better than standing still does"
"""What is said where nothing better was found."""


def stands_still(goal: Goal, error: float) -> bool:
    """Whether an rms error along the setpoints [m] is no less than that of a joint at rest."""
    away = np.asarray(goal.reference) - goal.reference[0]
    return bool(error >= (1.0 - _NEAR) * np.sqrt(np.mean(away * away)))


def moved(
    cases: Sequence[Case], found: Polished, bounds: np.ndarray, timed: Any
) -> tuple[Polished, int]:
    """The same, but the best of a grid, polished, for cases that are best standing still.

    Args:
        cases: for tracking.
        found: log-gains of every case.
        bounds: lowest and highest log-gains, shape (cases, 2, 2).
        timed: what is simulated.

    Returns:
        The best points, and how many were tried for a case.
    """
    x, value, violation = found.x.copy(), found.value.copy(), found.violation.copy()
    tried = 0
    for i in np.flatnonzero(found.feasible).tolist():
        if not stands_still(cases[i].goal, float(np.exp(-value[i]))):
            continue
        points, number = _within(cases[i], bounds[i])
        tried = max(tried, number)
        if not len(points):
            continue
        values = problem([cases[i]] * _POINTS, timed)(np.resize(points, (_POINTS, 2))).worst_value
        if not values.max() > value[i]:
            continue
        first = points[np.argmax(values) % len(points)]
        better = polish(problem([cases[i]], timed), first[None], *bounds[i][:, None])
        x[i], value[i], violation[i] = better.x[0], better.value[0], better.violation[0]
        tried += better.evaluations
    return Polished(x, value, violation, found.evaluations), tried


def _within(case: Case, bounds: np.ndarray) -> tuple[np.ndarray, int]:
    """Log-gains of a grid that keep the bounds, shape (k, 2), from stiff ones to soft ones.

    And how many there are in the grid.
    """
    axes = [np.linspace(*ends, _GRID)[::-1] for ends in zip(*plane(case), strict=True)]
    grid = np.clip(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2), *bounds)
    margins = replace(case.goal, objective="stiffness", reference=())
    rows = problem([replace(case, goal=margins)] * len(grid))(grid)
    kept = np.flatnonzero(rows.usable & (rows.violation <= MET))
    every = max(1, -(-len(kept) // _POINTS))
    return grid[kept[::every]], len(grid)
