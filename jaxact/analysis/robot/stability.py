"""Which roots of a robot's loop over a control period grow, and where one begins to."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
import scipy.linalg

# A root this little outside the unit circle is on it: a robot's matrices come from differences.
MARGINAL = 1e-9
# Roots this near to 1 are those of rigid-body motions: double ones, which rounding parts.
NEUTRAL = 1.5e-7
# And those that move so little in a period.
DRIFT = 1e-5
# Halvings of an interval that are worth as much as rounding, and how far a root is from the circle
# that is on it but for rounding.
_HALVINGS, _ON_CIRCLE = 44, 1e-13
# Squarings of a matrix after which most of its roots may be gone, from how many states on that is
# looked at, and how large a power may be whose roots are known as well as the matrix's own.
_SQUARINGS, _MANY, _LARGE = (7, 10), 24, 64.0
# Unit of rounding.
_UNIT = 0.5 * float(np.finfo(float).eps)

# Which of some roots count, of shape (n,).
Counted = Callable[[np.ndarray], np.ndarray]


def all_roots(roots: np.ndarray) -> np.ndarray:
    """All of them count."""
    return np.ones(len(roots), bool)


def moving(roots: np.ndarray) -> np.ndarray:
    """All but those next to 1 count: what is static no delay changes, and none moves."""
    return ~drifting(roots)


def excess(M: np.ndarray, counted: Counted = all_roots) -> float:
    """How far the largest root of a matrix that counts is outside the unit circle, beyond rounding.

    What is not a number is far outside; -1 if no root counts.
    """
    if counted is all_roots and (sizes := _sizes(M)) is not None:
        return farthest(sizes)
    found = np.linalg.eigvals(M)
    return farthest(found[counted(found)])


def farthest(roots: np.ndarray) -> float:
    """How far the largest of some roots is outside the unit circle, as `excess`."""
    outside = np.abs(roots) - (1.0 + MARGINAL)
    return float(np.max(np.where(np.isnan(outside), np.inf, outside), initial=-1.0))


def _sizes(M: np.ndarray) -> np.ndarray | None:
    """Magnitudes of the largest roots of a matrix, shape (k,); None where it has to tell itself.

    In a power M^j the motions of actuators and delays are gone: what is left is a small matrix, of
    which roots take a part of the time. Rounding moves a root of P^2 by at most its condition times
    n u |P|^2 and one of M by a j-th of that: if all P are small, no more than computing it of M.
    """
    if len(M) <= _MANY:
        return None
    power = M
    for squaring in range(_SQUARINGS[-1] + 1):
        looked_at = squaring in _SQUARINGS
        if looked_at or not _size(power) <= _LARGE:
            if not np.isfinite(_size(power)):
                return None
            power = _balanced(power)  # in other units it may be small
            if _size(power) > _LARGE:
                return None
        if looked_at and len(core := _condensed(power)) < len(power):
            return np.abs(np.linalg.eigvals(core)) ** (0.5**squaring)
        power = power @ power
    return None


def _condensed(P: np.ndarray) -> np.ndarray:
    """A matrix of less than half the size with the same roots, but for those that are 0 and for
    rounding; P itself where there is none.

    Of Q R, with Q of a few columns and R of a few rows, R Q has the same roots.
    """
    # Of the transpose, which is how LAPACK reads rows.
    triangle, order, reflectors, _, _ = scipy.linalg.lapack.dgeqp3(P.T)
    size = np.abs(np.diag(triangle))
    rank = max(1, int(np.sum(size > _UNIT * size[0])))
    if 2 * rank >= len(P):
        return P
    Q, _, _ = scipy.linalg.lapack.dorgqr(triangle[:, :rank], reflectors[:rank])
    R = np.empty((rank, len(P)))
    R[:, order - 1] = np.triu(triangle[:rank])
    return R @ Q


def _balanced(M: np.ndarray) -> np.ndarray:
    """The matrix in units in which its rows and columns are of like size."""
    return scipy.linalg.lapack.dgebal(M.T, scale=1)[0].T


def _size(M: np.ndarray) -> float:
    """The largest sum of magnitudes of a row."""
    return float(scipy.linalg.lapack.dlange("1", M.T))


def drifting(roots: np.ndarray) -> np.ndarray:
    """Which roots neither turn nor grow by a hundred-thousandth of a period: no shaking does."""
    return np.abs(roots - 1.0) < DRIFT


def beyond(roots: np.ndarray) -> np.ndarray:
    """Which roots are outside the unit circle, to the last digit; what is not a number is."""
    return ~(np.abs(roots) <= 1.0 + MARGINAL)


def neutral(roots: np.ndarray) -> np.ndarray:
    """Which roots are those of rigid-body motions, at 1 but for rounding."""
    return np.abs(roots - 1.0) < NEUTRAL


def switch(growth: Callable[[float], float], low: float, high: float) -> float:
    """Where a loop changes from stable to unstable, or back, within an interval, to rounding.

    Args:
        growth: see `excess`; of different signs at both ends.
    """
    from scipy.optimize import brentq  # slow to import

    @functools.cache
    def finite(at: float) -> float:
        found = min(growth(at), 1.0)
        return found if abs(found) > _ON_CIRCLE else 0.0

    if (finite(low) > 0.0) == (finite(high) > 0.0):
        return high
    close = (high - low) * 2.0**-_HALVINGS
    return float(brentq(finite, low, high, xtol=close, rtol=4.0 * np.finfo(float).eps))
