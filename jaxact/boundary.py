"""Stability boundaries in the plane of the gains (D-partition).

Continuous, on s = jw, with x = w/wn:

    kp = m w^2 ((1 - x^2) cos(w td) - 2 zeta x sin(w td))
    kd = m w   ((1 - x^2) sin(w td) + 2 zeta x cos(w td)),    and the line kp = 0.

Sampled, on z = exp(j w T): the two real unknowns of 1 + kp Gp(z) + kd Gv(z) = 0, and the lines of
z = 1 (kp = 0) and z = -1.

On these curves some root is marginal. Only parts with no unstable root on one of their sides are
the boundary of the stable region; the rest is where a further pair becomes unstable. Which is
which is decided by counting the roots on both sides. NumPy at the edge, float64.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxact.frequency import JointLoop
from jaxact.lobes import (
    BoundaryCurve,
    Count,
    Gains,
    Line,
    Range,
    bisect,
    classify,
    curves_inside,
    frequency_grid,
    spread,
)
from jaxact.pulse import plant_response, pulse_transfer
from jaxact.roots import count_unstable_roots
from jaxact.sampled import SampledLoop, one_period_matrix

__all__ = [
    "AxisLimits",
    "BoundaryCurve",
    "FirstLobe",
    "continuous_boundary",
    "continuous_limits",
    "first_lobe",
    "sampled_boundary",
    "sampled_limits",
]

_CHUNK = 128
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


@dataclass(frozen=True)
class _Marginal:
    """The marginal gains of one plant.

    gains: (kp, kd) of a marginal root at w [rad/s]
    modulus: |kp + j w kd| of it [N/m], as a function of w; None if all frequencies are of interest
    nyquist: pi/T [rad/s], inf for the continuous loop
    at_nyquist: Gp(-1), Gv(-1), 0 for the continuous loop
    lag: longest delay in the phase [s], for the density of the grid
    count: number of unstable roots at (kp, kd)
    """

    gains: Gains
    modulus: Callable[[np.ndarray], np.ndarray] | None
    nyquist: float
    at_nyquist: tuple[float, float]
    lag: float
    count: Count


def continuous_boundary(
    mass: float,
    natural_frequency: float,
    damping_ratio: float,
    delay: float,
    *,
    kp_range: Range,
    kd_range: Range,
) -> list[BoundaryCurve]:
    """All marginal gains of the continuous loop inside a window of the (kp, kd) plane.

    mass: m [kg], > 0
    natural_frequency: wn of the force servo [rad/s], > 0, inf = ideal
    damping_ratio: zeta [-], > 0, ignored if ideal
    delay: total delay td [s], >= 0
    kp_range, kd_range: (low, high) of the window [N/m], [N s/m]; an axis with low > 0 is sampled
        evenly in its logarithm, otherwise evenly

    Raises ValueError for an empty window or values out of their domain.
    """
    _check_window(kp_range, kd_range)
    marginal = _continuous(mass, natural_frequency, damping_ratio, delay)
    return _curves(marginal, mass, kp_range, kd_range)


def sampled_boundary(
    mass: float,
    natural_frequency: float,
    damping_ratio: float,
    delay: float,
    control_period: float,
    *,
    velocity: str = "sampled",
    velocity_filter: float = math.inf,
    measurement_delay: float = 0.0,
    output_delay: float = 0.0,
    kp_range: Range,
    kd_range: Range,
    integrator: str = "exact",
    substeps: int = 1,
) -> list[BoundaryCurve]:
    """All marginal gains of the sampled loop inside a window of the (kp, kd) plane.

    mass, natural_frequency, damping_ratio, kp_range, kd_range: as in `continuous_boundary`
    delay, measurement_delay, output_delay: [s], >= 0; only their sum matters
    control_period: T [s], > 0
    velocity: "sampled", or "differenced" for positions differenced through a first-order filter
    velocity_filter: its cutoff [rad/s], > 0, inf = none
    integrator: "exact", or "euler" for MuJoCo's semi-implicit Euler with `substeps` a period

    Raises ValueError for an empty window or values out of their domain.
    """
    _check_window(kp_range, kd_range)
    total = delay + measurement_delay + output_delay
    kinds = {"velocity": velocity, "integrator": integrator, "substeps": substeps}
    plant = (mass, natural_frequency, damping_ratio, total, control_period, velocity_filter)
    return _curves(_sampled(*plant, kinds), mass, kp_range, kd_range)


def continuous_limits(
    mass: float,
    natural_frequency: float,
    damping_ratio: float,
    delay: float,
    *,
    kp: float,
    kd: float,
) -> AxisLimits:
    """How far kp alone and kd alone may move from (kp, kd) in the continuous loop.

    mass, natural_frequency, damping_ratio, delay: as in `continuous_boundary`
    kp, kd: the gains to start from [N/m], [N s/m], > 0

    Raises ValueError for values out of their domain.
    """
    return _limits(_continuous(mass, natural_frequency, damping_ratio, delay), mass, kp, kd)


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
    return _limits(_sampled(*plant, kinds), mass, kp, kd)


def first_lobe(
    mass: float, natural_frequency: float, damping_ratio: float, delay: float
) -> FirstLobe:
    """Tip and end of the first lobe of the continuous boundary.

    mass, natural_frequency, damping_ratio, delay: as in `continuous_boundary`

    On the lobe arg D + w td runs from 0 to pi/2. Raises ValueError for values out of their domain.
    """
    marginal = _continuous(mass, natural_frequency, damping_ratio, delay)
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


def _continuous(mass: float, wn: float, damping_ratio: float, delay: float) -> _Marginal:
    zeta = 1.0 if math.isinf(wn) else damping_ratio
    _check_plant(mass, wn, zeta, delay)

    def servo(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = w / wn
        return (1.0 - x) * (1.0 + x), 2.0 * zeta * x

    def gains(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        real, imaginary = servo(w)
        cosine, sine = np.cos(w * delay), np.sin(w * delay)
        kp = mass * w * w * (real * cosine - imaginary * sine)
        return kp, mass * w * (real * sine + imaginary * cosine)

    def modulus(w: np.ndarray) -> np.ndarray:
        return mass * w * w * np.hypot(*servo(w))

    def count(kp: np.ndarray, kd: np.ndarray) -> np.ndarray:
        return _count_continuous(kp, kd, (mass, wn, zeta, delay))

    return _Marginal(gains, modulus, math.inf, (0.0, 0.0), delay, count)


def _sampled(
    mass: float,
    wn: float,
    damping_ratio: float,
    delay: float,
    control_period: float,
    velocity_filter: float,
    kinds: dict,
) -> _Marginal:
    zeta = 1.0 if math.isinf(wn) else damping_ratio
    _check_plant(mass, wn, zeta, delay)
    if not (0 < control_period < math.inf and velocity_filter > 0):
        raise ValueError("control_period and velocity_filter must be positive")
    numbers = (mass, wn, zeta, delay, control_period, velocity_filter)
    with jax.enable_x64(True):
        zero = jnp.asarray(0.0)
        plant = SampledLoop(zero, zero, *(jnp.asarray(float(a)) for a in numbers), **kinds)
        transfer = jax.tree.map(np.asarray, _transfer(plant))
        steps = int(transfer.steps)
        # The matrix is affine in the gains.
        base, along_kp, along_kd = (
            np.asarray(_period_matrix(replace(plant, kp=zero + kp, kd=zero + kd), steps))
            for kp, kd in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))
        )

    def plant_at(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        u = np.exp(-1j * theta)
        s = 2j * np.sin(0.5 * theta) * np.exp(-0.5j * theta)
        return plant_response(transfer, u, s, np.exp(-1j * theta * (steps + 1)))

    def gains(w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        position, rate = plant_at(w * control_period)
        with np.errstate(divide="ignore", invalid="ignore"):
            determinant = position.real * rate.imag - position.imag * rate.real
            return -rate.imag / determinant, position.imag / determinant

    def count(kp: np.ndarray, kd: np.ndarray) -> np.ndarray:
        kp, kd = kp[:, None, None], kd[:, None, None]
        closed = base + kp * (along_kp - base) + kd * (along_kd - base)
        return np.sum(np.abs(np.linalg.eigvals(closed)) > 1.0, axis=1)

    position, rate = plant_at(np.array([math.pi]))
    at_nyquist = (float(position.real[0]), float(rate.real[0]))
    nyquist = math.pi / control_period
    return _Marginal(gains, None, nyquist, at_nyquist, delay + 4.0 * control_period, count)


_transfer = jax.jit(pulse_transfer)
_period_matrix = jax.jit(one_period_matrix, static_argnums=1)
_counter = jax.jit(count_unstable_roots)


def _check_plant(mass: float, wn: float, zeta: float, delay: float) -> None:
    if not (mass > 0 and wn > 0 and zeta > 0):
        raise ValueError("mass, natural_frequency and damping_ratio must be positive")
    if not 0 <= delay < math.inf:
        raise ValueError("the delay must be finite and not negative")


def _check_window(kp_range: Range, kd_range: Range) -> None:
    for name, (low, high) in (("kp_range", kp_range), ("kd_range", kd_range)):
        if not -math.inf < low < high < math.inf:
            raise ValueError(f"{name} must be (low, high) with low < high, both finite")


def _curves(
    marginal: _Marginal, mass: float, kp_range: Range, kd_range: Range
) -> list[BoundaryCurve]:
    grid = _window_grid(marginal, mass, kp_range, kd_range)
    curves = curves_inside(marginal.gains, grid, kp_range, kd_range) if len(grid) else []
    lines = _zero_stiffness_line(kp_range, kd_range)
    if math.isfinite(marginal.nyquist):
        lines += _alternating_line(marginal, kp_range, kd_range)
    return classify(curves, marginal.gains, lines, marginal.count, kp_range, kd_range)


def _window_grid(marginal: _Marginal, mass: float, kp_range: Range, kd_range: Range) -> np.ndarray:
    """Frequencies that can lie in the window, dense in their logarithm and in the phase."""
    largest = [max(abs(a), abs(b)) for a, b in (kp_range, kd_range)]
    smallest = [min(abs(a), abs(b)) if a * b > 0 else 0.0 for a, b in (kp_range, kd_range)]
    unit = math.sqrt(largest[0] / mass)
    if marginal.modulus is None:
        low = 1e-3 * math.sqrt(max(smallest[0], 1e-9 * largest[0]) / mass)
        low = min(low, 1e-3 * marginal.nyquist)
        return frequency_grid(low, marginal.nyquist * (1.0 - 1e-9), marginal.lag)
    w = np.geomspace(1e-9 * unit, 1e9 * unit, 20_001)
    size = marginal.modulus(w)
    possible = size <= 1.1 * np.hypot(largest[0], w * largest[1])
    possible &= size >= 0.9 * np.hypot(smallest[0], w * smallest[1])
    if not possible.any():
        return np.zeros(0)
    return frequency_grid(w[possible][0], w[possible][-1], marginal.lag)


def _zero_stiffness_line(kp_range: Range, kd_range: Range) -> list[Line]:
    """The line kp = 0 (a root at the origin), if the window contains it."""
    if not kp_range[0] <= 0.0 <= kp_range[1]:
        return []
    kd = spread(kd_range)
    return [(np.zeros_like(kd), kd, 0.0)]


def _alternating_line(marginal: _Marginal, kp_range: Range, kd_range: Range) -> list[Line]:
    """The line 1 + kp Gp(-1) + kd Gv(-1) = 0 of a root at z = -1, inside the window."""
    kp, kd = spread(kp_range), spread(kd_range)
    kp_on_line = np.array([_solve_line(marginal, kd=value) for value in kd])
    kd_on_line = np.array([_solve_line(marginal, kp=value) for value in kp])
    kp, kd = np.concatenate([kp, kp_on_line]), np.concatenate([kd_on_line, kd])
    keep = (kp >= kp_range[0]) & (kp <= kp_range[1]) & (kd >= kd_range[0]) & (kd <= kd_range[1])
    kp, kd = kp[keep], kd[keep]
    if len(kp) < 2:
        return []
    # Along the line, whichever way it leans.
    rising = _solve_line(marginal, kp=kp_range[1]) > _solve_line(marginal, kp=kp_range[0])
    order = np.lexsort((kd if rising else -kd, kp))
    return [(kp[order], kd[order], marginal.nyquist)]


def _solve_line(marginal: _Marginal, *, kp: float | None = None, kd: float | None = None) -> float:
    """The other gain on 1 + kp Gp(-1) + kd Gv(-1) = 0; NaN where the line is parallel."""
    position, rate = marginal.at_nyquist
    if math.isinf(marginal.nyquist):
        return math.nan
    given, wanted = (kp * position, rate) if kd is None else (kd * rate, position)
    # Both responses are real there; what is only rounding of the other is nothing.
    scale = max(abs(position) * marginal.nyquist, abs(rate))
    weight = abs(wanted) * (marginal.nyquist if kd is not None else 1.0)
    if weight <= 1e-12 * scale:
        return math.nan
    return -(1.0 + given) / wanted


def _limits(marginal: _Marginal, mass: float, kp: float, kd: float) -> AxisLimits:
    if not (0 < kp < math.inf and 0 < kd < math.inf):
        raise ValueError("kp and kd must be positive and finite")
    if marginal.count(np.array([kp]), np.array([kd]))[0] > 0:
        return AxisLimits(math.nan, math.nan, math.nan, math.nan)
    grid = _window_grid(marginal, mass, (0.0, _FARTHEST * kp), (0.0, _FARTHEST * kd))
    all_kp, all_kd = marginal.gains(grid)
    kp_at, _ = marginal.gains(_crossings(lambda w: marginal.gains(w)[1], grid, all_kd, kd))
    _, kd_at = marginal.gains(_crossings(lambda w: marginal.gains(w)[0], grid, all_kp, kp))
    on_line = _solve_line(marginal, kd=kd), _solve_line(marginal, kp=kp)
    kp_at = np.concatenate([kp_at, [0.0, on_line[0]]])
    kd_at = np.concatenate([kd_at, [0.0 if _rigid(marginal, grid) else math.nan, on_line[1]]])
    return AxisLimits(*_neighbours(kp_at, kp), *_neighbours(kd_at, kd))


def _rigid(marginal: _Marginal, grid: np.ndarray) -> bool:
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


def _count_continuous(
    kp: np.ndarray, kd: np.ndarray, plant: tuple[float, float, float, float]
) -> np.ndarray:
    """Unstable roots of the continuous loop, in chunks of one compiled shape."""
    counts = []
    with jax.enable_x64(True):
        for start in range(0, len(kp), _CHUNK):
            part = slice(start, start + _CHUNK)
            number = len(kp[part])
            padded = [np.resize(a[part], _CHUNK) for a in (kp, kd)]
            fields = [*(jnp.asarray(a) for a in padded), *(jnp.full(_CHUNK, a) for a in plant)]
            counts.append(np.asarray(_counter(JointLoop(*fields)))[:number])
    return np.concatenate(counts)
