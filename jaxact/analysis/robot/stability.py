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
# Halvings of an interval that are worth as much as rounding.
_HALVINGS = 44
# Squarings of a matrix at most, how large a power is scaled anew, and how small one is gone.
_SQUARINGS, _LARGE, _SMALL = 24, 64.0, 0.1
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
    size = np.abs(found := np.linalg.eigvals(M)) - (1.0 + MARGINAL)
    size = np.where(np.isnan(size), np.inf, size)
    return float(np.max(size[counted(found)], initial=-1.0))


def decays(M: np.ndarray) -> bool:
    """Whether powers of a matrix become small, which shows that all its roots are inside the unit
    circle for a part of the cost of computing them; where they do not, nothing is said.

    Rounding carries a root of P^2, P = M^j, by at most its condition times n u |P|^2; the condition
    of one on the unit circle is no larger than the powers are. What a root may have moved by so far
    is counted in shares of j periods, and must be less than what the powers have decayed by.
    """
    power = _balanced(M)
    size = _size(power)
    largest, moved, share = 1.0, 0.0, 1.0
    for _ in range(_SQUARINGS):
        if size > _LARGE:  # in other units it may be small
            power = _balanced(power)
            size = _size(power)
        largest, share = max(largest, size), 0.5 * share
        moved += share * largest * size**2 * len(M) * _UNIT
        if not moved < share:
            return False
        power = power @ power
        size = _size(power)
        if size < _SMALL and -share * np.log(max(size, _UNIT)) > moved:
            return True
    return False


def _balanced(M: np.ndarray) -> np.ndarray:
    """The matrix in units in which its rows and columns are of like size."""
    return scipy.linalg.lapack.dgebal(M, scale=1)[0]


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
        return min(growth(at), 1.0)

    if (finite(low) > 0.0) == (finite(high) > 0.0):
        return high
    close = (high - low) * 2.0**-_HALVINGS
    return float(brentq(finite, low, high, xtol=close, rtol=4.0 * np.finfo(float).eps))
