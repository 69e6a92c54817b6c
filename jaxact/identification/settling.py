"""Beginning again nearby where a search has ended at a kink.

A joint that sticks, or just does not, makes a crease in the sum of squares: on either side of it
the slopes point across, and a search that follows them stops there, though the sum falls along the
crease. At a minimum within a smooth piece the residuals are orthogonal to their slopes,

    |Q^T r|^2 / s^2 = 0,      Q: orthonormal basis of the slopes J,  s^2 = |r|^2 / (rows - unknowns)

the fall of the sum that the slopes still promise, in units of the residuals' variance. What would
take a step beyond the unknowns' ranges is no promise: along a direction whose whole range changes
the residuals by u, their component a promises a^2 where a < u, and (2 a - u) u beyond. Else one
that no residual depends on, whose slopes are rounding errors, would promise anything. A delay at a
control tick is left out: the sum has a kink there on either side of which it rises, and the search
has looked at both (`fitting`).
"""

from __future__ import annotations

import numpy as np

from jaxact.identification import uncertainty
from jaxact.identification.fitting import Fit, at_a_tick, bounds, solve
from jaxact.parameters import DELAY

# A search has arrived where it is left with this share of a robust variance to fall.
_ARRIVED = 0.1
_MOST_STARTS = 8


def settled(fit: Fit, *, loss: str = "linear") -> Fit:
    """The fit, or a better one from starts that the logs hardly tell from it.

    Args:
        fit: solved.
        loss: of its least squares.
    """
    best, generator = fit, np.random.default_rng(0)
    for _ in range(_MOST_STARTS):
        covariance = uncertainty.robust(best)
        if promised(best, covariance) <= _ARRIVED:
            break
        near = generator.multivariate_normal(best.point, covariance, check_valid="ignore")
        found = solve(
            fit.problem, loss=loss, start=fit.problem.values(near), enough=best.square_sum
        )
        best = min(best, found, key=lambda one: one.square_sum)
    return best


def promised(fit: Fit, covariance: np.ndarray) -> float:
    """Fall of the sum of squares that the slopes promise, in robust variances.

    Args:
        fit: solved; of unknowns at a bound, and of a delay at a tick, nothing is promised.
        covariance: of its unknowns, shape (unknowns, unknowns).
    """
    ended = {*fit.at_bounds, *([DELAY] if at_a_tick(fit) else [])}
    free = [at for at, name in enumerate(fit.problem.names) if name not in ended]
    low, high = bounds(fit.problem)
    # Sizes are what a step as long as the ranges changes the residuals by.
    basis, sizes, _ = np.linalg.svd(fit.slopes[:, free] * (high - low)[free], full_matrices=False)
    along = np.abs(basis.T @ fit.residuals)
    fall = float(np.sum(np.where(along < sizes, along**2, (2.0 * along - sizes) * sizes)))
    plain = np.diag(uncertainty.naive(fit))
    wider = float(np.median(np.diag(covariance)[plain > 0.0] / plain[plain > 0.0]))
    spare = max(len(fit.residuals) - len(fit.point), 1)
    return fall / max(fit.square_sum / spare * wider, 1e-300)
