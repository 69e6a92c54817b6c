"""How much of the error that a fit leaves goes with the motion, and what that says of its numbers.

The intervals of a fit allow for noise, however it hangs together, not for a model that lacks
something: friction that is larger at rest, play, a load that depends on the position. Such an error
d is no noise: it is a function of the motion, as the slopes J are. What of it looks like J is gone
into the numbers and cannot be seen; what looks like J some rows earlier or later is still there,

    R^2 = |U^T r|^2 / |r|^2,      U: orthonormal basis of the slopes at several shifts

Noise has an R^2 as well, the larger the more its spectrum is that of the motion. As much as the
error has when it is moved along the log by a long way, at random, is chance; where R^2 is beyond 95
of 100 of those, the rest of it is the model's own,

    rho^2 = (R^2 - mean) / (1 - mean)

An error of that size within the span of J moves a number by at most rho |r| (A^-1)_ii^(1/2), with
A = J^T J: rho n^(1/2) standard deviations of n independent residuals, by Cauchy and Schwarz. What
has gone into the numbers is taken to be two thirds of what is left, in 19 of 20 logs, and the
worst within that: so far, hardly farther, numbers are off in simulated logs of which something was
left out (experiments/identification/misfit.py). It does not depend on the noise: squares add up.

Source: Schreiber, Schmitz, "Surrogate time series", Physica D 142 (2000), for moved series;
Kennedy, O'Hagan, "Bayesian calibration of computer models", Journal of the Royal Statistical
Society B 63 (2001), for numbers of a model that lacks something.
"""

from __future__ import annotations

import math

import numpy as np

from jaxact.identification.fitting import Fit

# Rows by which slopes are shifted.
_SHIFTS = tuple(range(-24, 25, 6))
# Moved errors, by at least so large a share of a log; and of how many the error must be beyond.
_MOVED, _FARTHEST, _BEYOND = 60, 0.05, 0.95
# Combinations of slopes that are so small a share of the largest are none.
_DEPENDENT = 1e-8
_GONE_INTO_THE_NUMBERS = 2.0 / 3.0


def share(fit: Fit) -> float:
    """Part of the error that goes with the motion, beyond chance: rho in [0, 1].

    Args:
        fit: solved.
    """
    own = [at for at, unknown in enumerate(fit.problem.unknowns) if not unknown.nuisance]
    power = fit.square_sum
    if not own or power <= 0.0:
        return 0.0
    cuts = np.cumsum(fit.problem.lengths)[:-1]
    columns = len(own) * len(_SHIFTS)
    gram, along = np.zeros((columns, columns)), np.zeros((columns, _MOVED + 1))
    generator = np.random.default_rng(0)
    size = np.linalg.norm(fit.slopes[:, own], axis=0)
    size = np.where(size > 0.0, size, 1.0)
    for slopes, rest in zip(
        np.split(fit.slopes[:, own] / size, cuts), np.split(fit.residuals, cuts), strict=True
    ):
        shifted = np.concatenate([np.roll(slopes, by, axis=0) for by in _SHIFTS], axis=1)
        gram += shifted.T @ shifted
        near = math.ceil(_FARTHEST * len(rest))
        moved = generator.integers(near, len(rest) - near, _MOVED)
        along += shifted.T @ np.stack([np.roll(rest, by) for by in (0, *moved)], axis=1)
    values, vectors = np.linalg.eigh(gram)
    kept = values > _DEPENDENT * values[-1]
    found = np.sum(np.square(vectors[:, kept].T @ along) / values[kept][:, None], axis=0) / power
    chance = float(np.mean(found[1:]))
    if found[0] <= np.quantile(found[1:], _BEYOND) or chance >= 1.0:
        return 0.0
    return math.sqrt(max(float(found[0]) - chance, 0.0) / (1.0 - chance))


def bias(fit: Fit, rho: float) -> float:
    """By how much a number is off in 19 of 20 logs, in deviations of independent residuals.

    Args:
        fit: solved.
        rho: its `share`.
    """
    return _GONE_INTO_THE_NUMBERS * rho * math.sqrt(len(fit.residuals))
