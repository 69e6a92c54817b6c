"""How far single gains may go: limits along one axis of the gain plane, and the first lobe."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxact.analysis.boundary.curves import bisect
from jaxact.analysis.boundary.marginal_gains import (
    Marginal,
    continuous_marginal,
    kd_on_line,
    kp_on_line,
    sampled_marginal,
    window_grid,
)

_FARTHEST = 1e6


@dataclass(frozen=True)
class AxisLimits:
    """How far one gain alone may move before the loop turns unstable; NaN if it is unstable.

    kp_min, kp_max: with kd fixed [N/m]
    kd_min, kd_max: with kp fixed [N s/m]
    """

    kp_min: float
    kp_max: float
    kd_min: float
    kd_max: float


@dataclass(frozen=True)
class FirstLobe:
    """The lobe of the continuous boundary that starts at zero gain; inf where it never closes.

    kp_max: its tip, the stiffest marginal gain [N/m], with kd [N s/m] and frequency [rad/s] there
    kd_max: where it meets kp = 0 [N s/m], with its frequency [rad/s]
    """

    kp_max: float
    kd_at_kp_max: float
    frequency_at_kp_max: float
    kd_max: float
    frequency_at_kd_max: float


def continuous_limits(
    mass: float,
    natural_frequency: float,
    damping_ratio: float,
    delay: float,
    *,
    velocity_filter: float = math.inf,
    kp: float,
    kd: float,
) -> AxisLimits:
    """How far kp alone and kd alone may move from (kp, kd) in the continuous loop.

    mass, natural_frequency, damping_ratio, delay, velocity_filter: as in `continuous_boundary`
    kp, kd: the gains to start from [N/m], [N s/m], > 0

    Raises ValueError for values out of their domain.
    """
    plant = (mass, natural_frequency, damping_ratio, delay, velocity_filter)
    return _limits(continuous_marginal(*plant), mass, kp, kd)


def sampled_limits(
    mass: float,
    natural_frequency: float,
    damping_ratio: float,
    delay: float,
    control_period: float,
    *,
    velocity: str = "sampled",
    velocity_filter: float = math.inf,
    kp: float,
    kd: float,
) -> AxisLimits:
    """How far kp alone and kd alone may move from (kp, kd) in the sampled loop.

    As `continuous_limits`, with the delay as the sum of all three and the rest as in
    `sampled_boundary`.
    """
    kinds = {"velocity": velocity}
    plant = (mass, natural_frequency, damping_ratio, delay, control_period, velocity_filter)
    return _limits(sampled_marginal(*plant, kinds), mass, kp, kd)


def first_lobe(
    mass: float, natural_frequency: float, damping_ratio: float, delay: float
) -> FirstLobe:
    """Tip and end of the first lobe of the continuous boundary.

    mass, natural_frequency, damping_ratio, delay: as in `continuous_boundary`

    On the lobe arg D + w td runs from 0 to pi/2. Raises ValueError for values out of their domain.
    """
    marginal = continuous_marginal(mass, natural_frequency, damping_ratio, delay)
    far = min(math.pi / (2.0 * delay) if delay > 0 else math.inf, natural_frequency)
    if math.isinf(far):
        return FirstLobe(math.inf, math.inf, math.inf, math.inf, math.inf)

    def stiffness(w: np.ndarray) -> np.ndarray:
        return marginal.gains(w)[0]

    def slope(w: np.ndarray) -> np.ndarray:
        # d kp / d ln w by a complex step: exact to rounding.
        return np.imag(stiffness(w * np.exp(1e-30j))) / 1e-30

    grid = np.linspace(0.0, far * (1.0 + 1e-9), 2001)[1:]
    end = np.flatnonzero(stiffness(grid) <= 0.0)[0]
    low = grid[end - 1 : end] if end > 0 else np.array([1e-3 * far])
    w_end = bisect(lambda w: stiffness(w) > 0, np.array([True]), low, grid[end : end + 1])[0]
    inside = grid[: end + 1]
    top = max(int(np.argmax(stiffness(inside))), 1)
    low, high = inside[top - 1 : top], inside[min(top + 1, end)][None]
    w_top = bisect(lambda w: slope(w) > 0, np.array([True]), low, high)[0]
    (kp_max,), (kd_at_kp_max,) = marginal.gains(w_top)
    kd_max = marginal.gains(w_end)[1][0]
    return FirstLobe(*map(float, (kp_max, kd_at_kp_max, w_top[0], kd_max, w_end[0])))


def _limits(marginal: Marginal, mass: float, kp: float, kd: float) -> AxisLimits:
    if not (0 < kp < math.inf and 0 < kd < math.inf):
        raise ValueError("kp and kd must be positive and finite")
    if marginal.count(np.array([kp]), np.array([kd]))[0] > 0:
        return AxisLimits(math.nan, math.nan, math.nan, math.nan)
    grid = window_grid(marginal, mass, (0.0, _FARTHEST * kp), (0.0, _FARTHEST * kd))
    all_kp, all_kd = marginal.gains(grid)
    kp_at, _ = marginal.gains(_crossings(lambda w: marginal.gains(w)[1], grid, all_kd, kd))
    _, kd_at = marginal.gains(_crossings(lambda w: marginal.gains(w)[0], grid, all_kp, kp))
    on_line = kp_on_line(marginal, kd), kd_on_line(marginal, kp)
    kp_at = np.concatenate([kp_at, [marginal.at_rest, on_line[0]]])
    kd_at = np.concatenate([kd_at, [0.0 if _rigid(marginal, grid) else math.nan, on_line[1]]])
    return AxisLimits(*_neighbours(kp_at, kp), *_neighbours(kd_at, kd))


def _rigid(marginal: Marginal, grid: np.ndarray) -> bool:
    """Whether kd = 0 is itself marginal at every frequency: the ideal servo without delay."""
    kp, kd = marginal.gains(grid)
    return bool(np.all(kd == 0.0))


def _crossings(
    gain: Callable[[np.ndarray], np.ndarray], grid: np.ndarray, values: np.ndarray, level: float
) -> np.ndarray:
    """Frequencies where the gain passes the level continuously."""
    above = values > level
    cells = np.flatnonzero((above[1:] != above[:-1]) & np.isfinite(values[1:] - values[:-1]))
    w = bisect(lambda x: gain(x) > level, above[cells], grid[cells], grid[cells + 1])[0]
    found = gain(w)
    # A pole of the curve changes sign too, but does not pass the level.
    return w[np.abs(found - level) < 1e-3 * abs(level)]


def _neighbours(values: np.ndarray, here: float) -> tuple[float, float]:
    """The largest value below and the smallest above; -inf and inf if there is none."""
    below, above = values[values < here], values[values > here]
    return max(below, default=-math.inf), min(above, default=math.inf)
