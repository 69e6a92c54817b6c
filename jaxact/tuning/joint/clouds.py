"""The end of a search for gains by random points: where the objective jumps, no slope leads on.

A settling time jumps where an overshoot leaves its band: the best gains lie beside such an edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxact.tuning.joint.problem import Case, problem
from jaxact.tuning.polish import MET, Polished

# How wide the clouds are, one after the other [ln], and the points of each.
_WIDTHS, _POINTS = (0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002), 64


def in_clouds(
    cases: Sequence[Case], found: Polished, bounds: np.ndarray, timed: Any
) -> tuple[Polished, int]:
    """The best of clouds of points that grow narrow around what meets all constraints.

    Args:
        found: log-gains of every case.
        bounds: lowest and highest log-gains, shape (cases, 2, 2).
        timed: what is simulated.

    Returns:
        The best points, and how many were tried for a case.
    """
    generator = np.random.default_rng(0)
    x, value, violation = found.x.copy(), found.value.copy(), found.violation.copy()
    for i in np.flatnonzero(found.feasible).tolist():
        rows_of = problem([cases[i]] * _POINTS, timed)
        for width in _WIDTHS:
            points = x[i] + width * generator.uniform(-1.0, 1.0, (_POINTS, x.shape[1]))
            points = np.clip(points, *bounds[i])
            rows = rows_of(points)
            worst = np.where(rows.violation <= MET, rows.worst_value, -np.inf)
            best = int(np.argmax(worst))
            if worst[best] > value[i]:
                x[i], value[i], violation[i] = points[best], worst[best], rows.violation[best]
    return Polished(x, value, violation, found.evaluations), len(_WIDTHS) * _POINTS
