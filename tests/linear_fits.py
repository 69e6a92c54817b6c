"""Fits of linear least squares, with what intervals look at of a problem and of its solution."""

from dataclasses import dataclass, field

import numpy as np


@dataclass(frozen=True)
class Linear:
    """What of a problem the intervals look at."""

    unknowns: tuple
    lengths: tuple


@dataclass(frozen=True)
class Solved:
    """A solved one."""

    problem: Linear
    point: np.ndarray
    residuals: np.ndarray
    slopes: np.ndarray
    at_bounds: tuple = field(default=())

    @property
    def square_sum(self):
        return float(self.residuals @ self.residuals)
