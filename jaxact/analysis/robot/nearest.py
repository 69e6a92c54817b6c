"""The nearest crossings of the eigenvalues of S, without computing them at every frequency.

Where |s| <= sigma_max(S) = u, |1 - s| <= sigma_max(T) = t, an eigenvalue s is marginal

    under a factor on all gains above 1, g = s / (s - 1), only from g >= u / (u - 1) on,
    under one below 1 only up to g <= 1 - 1 / t,
    under a delay, where |s| = |1 - s|, only from 2 asin(1 / 2 min(u, t)) / w on,

and u <= 1 + t, t <= 1 + u of what is real.

Blocks of the frequency grid are looked at in the order of what they might have, until the best that
was found is nearer than anything that is left.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxact.analysis.robot import limits as _limits
from jaxact.analysis.robot.limits import Crossing

# Grid points of a block.
_BLOCK = 16
# How much more than on its points the largest singular values may be between them.
_BETWEEN = 1.1
# Steps of the secant method, and the share of an interval within which it ends.
_STEPS, _NEAR = 60, 1e-14

Respond = Callable[[np.ndarray], np.ndarray]


@dataclass
class Loci:
    """Eigenvalues of S over a grid, computed block by block when they are asked for.

    Attributes:
        angle: w T [rad] from 0 to pi, shape (k,).
        S: there, real at both ends, shape (k, m, m).
        most, complementary: upper bounds of sigma_max of S and of I - S, shape (k,) each.
    """

    angle: np.ndarray
    S: np.ndarray
    most: np.ndarray
    complementary: np.ndarray

    def __post_init__(self) -> None:
        self._followed: dict[int, np.ndarray] = {}
        self._turning: dict[int, bool] = {}
        self.starts = range(0, len(self.angle) - 1, _BLOCK)

    def more_gain(self) -> list[Crossing]:
        """Crossings with a real factor above 1, the nearest one and some of the others."""
        with np.errstate(divide="ignore"):
            most = np.minimum(_BETWEEN * self.most, 1.0 + _BETWEEN * self.complementary)
            distance = -np.log1p(-1.0 / np.maximum(most, 1.0))
        return self._nearest(distance, functools.partial(self._factors, up=True), _distance)

    def less_gain(self) -> list[Crossing]:
        """Crossings with a factor below 1, as `more_gain`."""
        with np.errstate(divide="ignore"):
            most = np.minimum(_BETWEEN * self.complementary, 1.0 + _BETWEEN * self.most)
            distance = -np.log1p(-1.0 / np.maximum(most, 1.0))
        return self._nearest(distance, functools.partial(self._factors, up=False), _distance)

    def more_delay(self) -> list[Crossing]:
        """Crossings with the unit circle of an eigenvalue of the loop, the nearest and others."""
        most = _BETWEEN * np.minimum(self.complementary, self.most)
        sine = 1.0 / (2.0 * np.maximum(most, 0.5))
        with np.errstate(divide="ignore"):
            delay = np.where(sine < 1.0, 2.0 * np.arcsin(np.minimum(sine, 1.0)), math.inf)
            delay = np.where(self.angle > 0.0, delay / self.angle, math.inf)
        return self._nearest(delay, self._delays, delay_guess)

    def _nearest(
        self,
        least: np.ndarray,
        found: Callable[[int], list[Crossing]],
        measure: Callable[[Crossing], float],
    ) -> list[Crossing]:
        """Crossings of the blocks that may have one nearer than the nearest found, in order.

        Args:
            least: what a crossing at each grid point is at least, shape (k,).
            found: the crossings of a block.
            measure: how far one is.
        """
        blocks = {start: float(least[self._block(start)].min()) for start in self.starts}
        crossings: list[Crossing] = []
        best = math.inf
        for start in sorted(blocks, key=lambda start: blocks[start]):
            if blocks[start] >= best or not math.isfinite(blocks[start]):
                break
            crossings += found(start)
            best = min([best, *(measure(item) for item in crossings)])
        return sorted(crossings, key=measure)

    def _block(self, start: int) -> slice:
        """Points of a block, the first of the next one included."""
        return slice(start, start + _BLOCK + 1)

    def _values(self, start: int) -> np.ndarray:
        if start not in self._followed:
            self._followed[start] = followed(self.S[self._block(start)])
        return self._followed[start]

    def _factors(self, start: int, *, up: bool) -> list[Crossing]:
        block = self._block(start)
        if start not in self._followed and self._turns(start):
            return []
        angle, values = self.angle[block], self._values(start)
        found = _limits.crossings(angle, values, lambda s: s.imag)
        for row in np.flatnonzero((angle == 0.0) | (angle == self.angle[-1])):
            at = float(angle[row])
            for s in values[row]:
                if abs(s.imag) <= _limits.ROUNDING * abs(s):
                    real = complex(s.real)
                    found.append(Crossing(at, at, real, real, at, real))
        factors = [(_limits.factor(item), item) for item in found]
        most = _limits.FURTHEST
        return [item for g, item in factors if 1.0 / most < g < most and (g > 1.0) == up]

    def _turns(self, start: int) -> bool:
        """Whether no eigenvalue of a block is real: S - S* is definite, of one sign."""
        if start not in self._turning:
            S = self.S[self._block(start)]
            values = np.linalg.eigvalsh(-0.5j * (S - S.conj().transpose(0, 2, 1)))
            self._turning[start] = bool((values > 0.0).all() or (values < 0.0).all())
        return self._turning[start]

    def _delays(self, start: int) -> list[Crossing]:
        angle, values = self.angle[self._block(start)], self._values(start)
        found = _limits.crossings(angle, values, lambda s: s.real - 0.5)
        return [item for item in found if item.angle > 0.0]


def _distance(crossing: Crossing) -> float:
    return abs(math.log(_limits.factor(crossing)))


def delay_guess(crossing: Crossing) -> float:
    """The delay that makes a crossing with the unit circle marginal, by its phase [periods]."""
    return _limits.turn(crossing) / crossing.angle


def followed(S: np.ndarray) -> np.ndarray:
    """Eigenvalues of S over a part of the axis, each in a column of its own; shape (k, m)."""
    return _limits.sorted_along(np.linalg.eigvals(S))


def refined(respond: Respond, crossing: Crossing) -> Crossing:
    """The same with a real eigenvalue of S, to rounding; by the Illinois method.

    Args:
        respond: w T [rad], shape (k,), -> S, shape (k, m, m).
    """
    low, high, below, above = crossing.low, crossing.high, crossing.below, crossing.above
    if low == high:
        return crossing
    left, right, side = below.imag, above.imag, 0
    for _ in range(_STEPS):
        share = left / (left - right)
        middle = low + share * (high - low)
        values = np.linalg.eigvals(respond(np.array([middle]))[0])
        guess = below + (above - below) * (middle - low) / (high - low)
        value = complex(values[np.argmin(np.abs(values - guess))])
        if value.imag * left > 0.0:
            low, below, left = middle, value, value.imag
            right, side = (0.5 * right if side == -1 else right), -1
        else:
            high, above, right = middle, value, value.imag
            left, side = (0.5 * left if side == 1 else left), 1
        if abs(value.imag) <= _NEAR * abs(value) or high - low <= _NEAR * high:
            return Crossing(low, high, below, above, middle, value)
    return Crossing(low, high, below, above, 0.5 * (low + high), 0.5 * (below + above))
