"""What is known of each unknown: its interval, and which combinations are known where it is not."""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from jaxact.identification import misfit, uncertainty
from jaxact.identification.fitting import Fit, solve
from jaxact.parameters import DELAY, WN, ZETA

# A number is identified where its interval is narrower than this share of it, in either direction.
_LARGEST_SHARE = 0.4
# Slopes of unknowns that are this much alike cannot be told apart; those of the second number only
# where their intervals are wide as well.
_COLLINEAR, _NEARLY_COLLINEAR = 0.002, 0.05
_IN_A_COMBINATION = 0.2
# Of a model that leaves so much of the signal's square nothing is known.
_LOST = 0.5
_STEPS_OF_PROFILE = 14
# Terms of friction that a joint may not have.
_MAY_BE_NONE = ("loaded", "stribeck")
# A drawn profile goes beyond the interval by this factor.
_BEYOND_THE_INTERVAL = 1.6

GOES_WITH_THE_MOTION = ", as much of the error goes with the motion"
"""Why an interval is wide whose model lacks something, behind that it is."""


@dataclass(frozen=True)
class Estimate:
    """One number with its 95 % interval.

    Attributes:
        name, unit: of the unknown.
        value: estimated.
        low, high: the interval's ends, in the same unit; infinite where a bound was reached.
        wider: standard deviation over that of independent residuals [-].
        identified: whether the logs say enough of it.
        reason: why not, "" where they do.
        at_bound: whether it lies at a bound of its range.
        bias: what the interval's half-width allows for an error that goes with the motion, in
            standard deviations of independent residuals [-]; squares add up.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    wider: float
    identified: bool
    reason: str = ""
    at_bound: bool = False
    bias: float = 0.0


@dataclass(frozen=True)
class Knowledge:
    """What a fit says of its unknowns.

    Attributes:
        estimates: of the unknowns that are of interest.
        names: of all unknowns, in the order of the matrices.
        covariance: of the coordinates of the search, shape (unknowns, unknowns).
        correlation: of the same, shape (unknowns, unknowns).
        condition: condition number of the slopes, each scaled to length 1.
        combinations: unknowns that cannot be told apart, set by set.
        lag: ``delay + 2 zeta / wn`` and its standard deviation [s]; None where the model has none.
        misfit: part of the error that goes with the motion and that the intervals allow for, see
            `jaxact.identification.misfit` [-].
    """

    estimates: tuple[Estimate, ...]
    names: tuple[str, ...]
    covariance: np.ndarray
    correlation: np.ndarray
    condition: float
    combinations: tuple[tuple[str, ...], ...]
    lag: tuple[float, float] | None
    misfit: float = 0.0

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of this name."""
        return next(estimate for estimate in self.estimates if estimate.name == name)

    @property
    def identified(self) -> bool:
        """Whether every unknown is."""
        return all(estimate.identified for estimate in self.estimates)


def of_fit(
    fit: Fit, *, bootstrap: bool = False, profile: bool = True, rho: float = 0.0
) -> Knowledge:
    """Intervals, correlations and combinations of a fit.

    Args:
        fit: solved.
        bootstrap: resample blocks instead of the kernel's estimate.
        profile: the delay's interval, and those at bounds, by profile likelihood.
        rho: part of the error that goes with the motion, by `misfit.share`.
    """
    naive = uncertainty.naive(fit)
    covariance = uncertainty.bootstrap(fit) if bootstrap else uncertainty.robust(fit)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    plain = np.sqrt(np.maximum(np.diag(naive), 0.0))
    wider = deviation / np.where(plain > 0.0, plain, 1.0)
    bias = misfit.bias(fit, rho)
    ends: dict[int, tuple[float, float]] = {}
    for index, unknown in enumerate(fit.problem.unknowns):
        if unknown.nuisance:
            continue
        reach = half_width(fit, float(wider[index]), bias) * float(plain[index])
        point = float(fit.point[index])
        both = sorted((unknown.value(point - reach), unknown.value(point + reach)))
        low, high = max(both[0], unknown.low), min(both[1], unknown.high)
        if unknown.name == DELAY and profile:
            ratio = float(wider[index]) if wider[index] > 0.0 else float(np.median(wider))
            low, high = ends_of_delay(fit, half_width(fit, ratio, bias))
        ends[index] = low, high
    wide = {fit.problem.names[index] for index, both in ends.items() if is_wide(fit, index, *both)}
    sets, condition = combinations(fit, wide)
    none = {
        fit.problem.names[index]
        for index, (low, _) in ends.items()
        if fit.problem.names[index] in _MAY_BE_NONE and low <= 0.0
    }
    estimates = [
        _estimate(fit, index, *both, (float(wider[index]), bias), sets, wide, none)
        for index, both in ends.items()
    ]
    # As a deviation of which the bias is two: numbers that only their sum is known of keep it.
    covariance = covariance + (bias / uncertainty.critical(fit, 1.0)) ** 2 * naive
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    size = np.where(deviation > 0.0, deviation, 1.0)
    return Knowledge(
        estimates=tuple(estimates),
        names=fit.problem.names,
        covariance=covariance,
        correlation=covariance / np.outer(size, size),
        condition=condition,
        combinations=sets,
        lag=_lag(fit, covariance),
        misfit=rho,
    )


def half_width(fit: Fit, wider: float, bias: float) -> float:
    """Half of a 95 % interval in standard deviations of independent residuals.

    Args:
        fit: solved.
        wider: standard deviation over that of independent residuals.
        bias: by `misfit.bias`.
    """
    return math.hypot(uncertainty.critical(fit, wider) * wider, bias)


def beyond(longest: float) -> str:
    """Why a delay is not known that ended at the longest that was tried [s]."""
    return f"may be longer than the {1e3 * longest:.3g} ms that were tried"


def is_wide(fit: Fit, index: int, low: float, high: float) -> bool:
    """Whether an interval is too wide for its unknown to be identified.

    Args:
        fit: solved.
        index: of the unknown.
        low, high: the interval's ends, in the unknown's unit.
    """
    unknown = fit.problem.unknowns[index]
    value = unknown.value(float(fit.point[index]))
    width = high - low
    if unknown.name == DELAY:
        return width > max(fit.problem.period or 0.0, _LARGEST_SHARE * value)
    if unknown.positive:
        return high > (1.0 + 2.0 * _LARGEST_SHARE) * value or low < 0.4 * value
    if unknown.name.endswith("_asymmetry"):
        return width > _LARGEST_SHARE  # it is a share itself, of which zero says much
    size = max(abs(value), 0.02 * max(abs(unknown.low), abs(unknown.high)))
    return width > 2.0 * _LARGEST_SHARE * size and unknown.name not in ("offset", "zero")


def _estimate(
    fit: Fit, index: int, low: float, high: float, wider: tuple[float, float],
    sets: tuple[tuple[str, ...], ...], wide: Set[str], none: Set[str],
) -> Estimate:  # fmt: skip
    unknown = fit.problem.unknowns[index]
    value = unknown.value(float(fit.point[index]))
    together = [names for names in sets if unknown.name in names]
    at_bound = unknown.name in fit.at_bounds and (
        unknown.name not in (DELAY, *_MAY_BE_NONE) or value > 0.5 * unknown.high
    )
    reason = ""
    if fit.square_sum > _LOST * len(fit.residuals):
        reason = "the model does not follow the log"
    elif together:
        others = " and ".join(name for name in together[0] if name != unknown.name)
        reason = f"cannot be told from {others}" if others else "changes nothing that logs show"
    elif at_bound:
        reason = beyond(unknown.high) if unknown.name == DELAY else "lies at a bound of its range"
    elif unknown.name == WN and value > math.pi / (fit.problem.period or math.inf):
        # What happens between rows may be anything that was fitted badly.
        reason = "is faster than the rows of the log can show"
    elif unknown.name in wide:
        reason = "its interval is wide" + (GOES_WITH_THE_MOTION if wider[1] > 0.0 else "")
    elif unknown.name in none:
        reason = "may be zero"
    elif unknown.name == "stribeck_speed" and "stribeck" in none:
        reason = "says nothing where stribeck may be zero"
    ratio, bias = wider
    return Estimate(
        unknown.name, unknown.unit, value, low, high, ratio, not reason, reason, at_bound, bias
    )


def combinations(fit: Fit, wide: Set[str]) -> tuple[tuple[tuple[str, ...], ...], float]:
    """Sets of unknowns whose slopes are nearly dependent, and the condition number.

    Args:
        fit: solved.
        wide: names of the unknowns whose intervals are wide.

    By the singular vectors of the slopes, each scaled to length 1: a small singular value is a
    direction in which the residuals hardly change.

    Source: Belsley, Kuh, Welsch, "Regression diagnostics", chapter 3.
    """
    size = np.linalg.norm(fit.slopes, axis=0)
    moving = size > 1e-12 * max(float(size.max()), 1e-300)
    names = np.array(fit.problem.names)
    nuisance = np.array([u.nuisance for u in fit.problem.unknowns])
    still = tuple((str(name),) for name in names[~moving & ~nuisance])
    scaled = fit.slopes[:, moving] / size[moving]
    if not scaled.size:
        return still, math.inf
    _, singular, right = np.linalg.svd(scaled, full_matrices=False)
    condition = float(singular[0] / max(float(singular[-1]), 1e-300))
    sets = []
    for value, direction in zip(singular, right, strict=True):
        inside = (np.abs(direction) > _IN_A_COMBINATION) & ~nuisance[moving]
        chosen = tuple(names[moving][inside].tolist())
        bound = _NEARLY_COLLINEAR if wide & set(chosen) else _COLLINEAR
        if value < bound and len(chosen) > 1:
            sets.append(chosen)
    return (*still, *sets), condition


def ends_of_delay(fit: Fit, half: float) -> tuple[float, float]:
    """The delay's interval: where the others' best fit grows by what is exceeded in 5 of 100 logs.

    Args:
        fit: solved.
        half: of the interval, in standard deviations of independent residuals: so large a one
            raises the sum of squares by its square, in units of the residuals' variance.
    """
    index = fit.problem.names.index(DELAY)
    unknown = fit.problem.unknowns[index]
    period = fit.problem.period or unknown.high
    best = float(fit.point[index])
    spare = max(len(fit.residuals) - len(fit.point), 1)
    bound = half**2
    allowed = fit.square_sum * (1.0 + bound / spare)
    known = {
        u.name: value for u, value in zip(fit.problem.unknowns, fit.values.values(), strict=True)
    }

    def excess(delay: float) -> float:
        if abs(delay - best) < 1e-15:
            return fit.square_sum - allowed
        others = solve(fit.problem, fixed={unknown.name: delay}, start=known)
        return others.square_sum - allowed

    def end(bound: float, sign: float) -> float:
        inside, step = best, 0.02 * period
        for _ in range(_STEPS_OF_PROFILE):
            outside = best + sign * step
            if sign * (outside - bound) >= 0.0:
                outside = bound
            if outside == inside:
                return bound
            if excess(outside) > 0.0:
                return float(brentq(excess, inside, outside, xtol=1e-3 * period, rtol=1e-6))
            if outside == bound:
                return bound
            inside, step = outside, 2.5 * step
        return bound

    return end(unknown.low, -1.0), end(unknown.high, 1.0)


@dataclass(frozen=True)
class Profile:
    """Profile likelihood of one unknown: how well the others make up for a value of it.

    Attributes:
        estimate: of the unknown.
        values: of it, shape (values,), in its unit.
        rises: of the sum of squares there over the rise at the ends of a 95 % interval [-].
    """

    estimate: Estimate
    values: np.ndarray
    rises: np.ndarray


def profile(fit: Fit, estimate: Estimate, *, number: int = 7) -> Profile:
    """The profile likelihood of one unknown around its interval.

    Args:
        fit: solved.
        estimate: of the unknown.
        number: of values.
    """
    unknown = next(u for u in fit.problem.unknowns if u.name == estimate.name)
    ends = [
        estimate.value + _BEYOND_THE_INTERVAL * (end - estimate.value)
        for end in (estimate.low, estimate.high)
    ]
    low, high = max(ends[0], unknown.low), min(ends[1], unknown.high)
    values = np.unique(np.append(np.linspace(low, high, number), estimate.value))
    spare = max(len(fit.residuals) - len(fit.point), 1)
    bound = half_width(fit, max(estimate.wider, 1e-6), estimate.bias)
    rise = fit.square_sum * bound**2 / spare
    others = [
        solve(fit.problem, fixed={estimate.name: float(value)}, start=fit.values).square_sum
        for value in values
    ]
    return Profile(estimate, values, (np.array(others) - fit.square_sum) / rise)


def _lag(fit: Fit, covariance: np.ndarray) -> tuple[float, float] | None:
    """``delay + 2 zeta / wn`` and its standard deviation, to first order."""
    names = [u.model_name for u in fit.problem.unknowns]
    if WN not in names and DELAY not in names:
        return None
    values = fit.problem.model_values(fit.point)
    late = 2.0 * values[ZETA] / values[WN]
    slope = np.zeros(len(names))
    for index, name in enumerate(names):
        slope[index] = {DELAY: 1.0, WN: -late, ZETA: late}.get(name, 0.0)
    return values[DELAY] + late, float(np.sqrt(max(slope @ covariance @ slope, 0.0)))
