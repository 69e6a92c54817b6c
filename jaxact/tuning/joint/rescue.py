"""Bringing an unstable start back: Newton steps on the signed distance to the stability boundary.

The distance is the logarithm of a common factor on the gains (or of a slow-down, where no factor
helps), negative outside. Its slope says which way the boundary lies for the worst member.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# How far inside a start is brought (near the boundary peaks are too sharp to descend from), what is
# far enough, and how far one step may go [-].
_INSIDE, _ENOUGH, _STRIDE = 0.5, 0.35, 1.5
_STEPS = 40

# Log-gains that slow a joint down by two: (kp / 4, kd / 2). It always becomes stable in the end.
SLOWER = np.log(np.array([0.25, 0.5]))

Distance = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""x (p, d) -> the worst member's signed distance (p,) and its slope (p, d)."""


def rescue(
    distance: Distance, x: np.ndarray, slower: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Stable points near unstable ones; stable starts stay where they are.

    Args:
        x: log-gains, shape (p, d).
        slower: added where the slope leads nowhere, shape (d,).
        low, high: bounds of the log-gains, shape (p, d).

    Returns:
        The points, and the number of steps each took. A point that stays unstable within its bounds
        is returned as it is.
    """
    steps = np.zeros(len(x), dtype=int)
    nearest = np.full(len(x), -np.inf)
    unstable = np.ones(len(x), dtype=bool)
    for round_number in range(_STEPS):
        value, slope = distance(x)
        unstable = unstable if round_number else ~(value > 0.0)
        lost = unstable & ~(value > _ENOUGH)
        if not lost.any():
            break
        square = np.sum(slope * slope, axis=1)
        useful = np.isfinite(value) & np.isfinite(square) & (square > 1e-12)
        useful &= value > nearest + 1e-6
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = slope * ((_INSIDE - value) / square)[:, None]
        length = np.sqrt(np.sum(newton * newton, axis=1, keepdims=True))
        with np.errstate(invalid="ignore"):
            newton = newton * np.minimum(1.0, _STRIDE / np.maximum(length, 1e-12))
        step = np.where(useful[:, None], newton, slower)
        nearest = np.where(lost, np.where(useful, value, -np.inf), nearest)
        x = np.where(lost[:, None], np.clip(x + step, low, high), x)
        steps += lost
    return x, steps
