"""The front of stiffness against robustness: the same goal for many sensitivity peaks at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jaxact.errors import UserError
from jaxact.tuning.goal import Goal
from jaxact.tuning.joint.ensemble import Ensemble
from jaxact.tuning.joint.problem import Case
from jaxact.tuning.joint.search import STARTS, Tuned, tune_all
from jaxact.tuning.optimise import Descent

LOWEST, HIGHEST = 1.15, 3.0
MOST = 200


def peaks(number: int, lowest: float = LOWEST, highest: float = HIGHEST) -> np.ndarray:
    """Peaks Ms and Mt along a front [-], shape (number,): even in the modulus margin, 1/M.

    lowest, highest: its ends

    Raises UserError for fewer than two.
    """
    if not 2 <= number <= MOST:
        raise UserError(f"`pareto` {number}: give between 2 and {MOST} points")
    return 1.0 / np.linspace(1.0 / lowest, 1.0 / highest, number)


def front(
    members: Ensemble,
    goal: Goal,
    number: int,
    *,
    starts: int = STARTS,
    how: Descent | None = None,
) -> list[Tuned]:
    """The best gains for every peak of `peaks`, all in one compiled descent.

    members, goal, starts, how: as for `jaxact.tuning.joint.search.tune`; the goal's own peak
        does not count
    number: of points
    """
    cases = [Case(members, replace(goal, max_peak=float(peak))) for peak in peaks(number)]
    return tune_all(cases, starts=starts, how=how)
