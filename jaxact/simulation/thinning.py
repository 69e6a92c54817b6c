"""Which rows of long signals a picture needs."""

from __future__ import annotations

import numpy as np


def thinned(first: np.ndarray, second: np.ndarray, number: int) -> np.ndarray:
    """Rows to keep of two signals: the extremes of both in intervals of equal length.

    Args:
        first, second: shape (rows,).
        number: at most so many.

    Returns:
        Their numbers, rising; all rows where these are few enough.
    """
    rows = len(first)
    if rows <= number:
        return np.arange(rows)
    edges = np.linspace(0, rows, max(number // 4, 1) + 1).astype(int)
    ends = [
        low + pick(signal[low:high])
        for low, high in zip(edges[:-1], edges[1:], strict=True)
        if high > low
        for signal in (first, second)
        for pick in (np.argmin, np.argmax)
    ]
    return np.unique(ends)
