"""How well the unknowns are known: residuals of real logs are not independent.

With slopes J and residuals r of a fit, the scores s_t = J_t r_t, and A = J^T J,

    naive       cov = s^2 A^-1                           right for independent residuals only
    one log     cov = sum_k w_k Gamma_k                  of A^-1 s_t; w: quadratic-spectral kernel
    many logs   cov = A^-1 (sum_l S_l S_l^T) A^-1        S_l: the sum of the scores of one log
    noise alone cov = A^-1 J^T G J A^-1                  G_tu = gamma(t - u) of the residuals

The bandwidth of the kernel is chosen by the series' own autocorrelation, after an autoregression
has whitened them. Where few rows tell of an unknown, such as those at which a joint breaks loose,
that estimate rests on few numbers and is often far too small; the last one, for which residuals
hang together in the same way all along a log, rests on all rows. The larger deviation counts.

Source: Andrews, "Heteroskedasticity and autocorrelation consistent covariance matrix estimation",
Econometrica 59 (1991); Andrews, Monahan, Econometrica 60 (1992); Cameron, Miller, "A practitioner's
guide to cluster-robust inference", Journal of Human Resources 50 (2015).
"""

from __future__ import annotations

import math

import numpy as np
from scipy import fft, signal, stats

from jaxact.identification.fitting import Fit

FEWEST_CLUSTERS = 6
"""Of so many logs and more, each is a draw of its own."""
# The whitening filter must stay a filter: a pole of 1 would make the estimate infinite.
_LARGEST_POLE = 0.97
# Of the filter's coefficients 1 minus their sum is at least this over the number of rows.
_LEAST_REST = 10.0
# Largest order of the whitening filter per factor of ten of the rows.
_ORDERS = 10


def naive(fit: Fit) -> np.ndarray:
    """Covariance under independent residuals, shape (unknowns, unknowns)."""
    spare = max(len(fit.residuals) - len(fit.point), 1)
    return fit.square_sum / spare * _inverse(fit)


def robust(fit: Fit) -> np.ndarray:
    """Covariance under residuals that hang together, shape (unknowns, unknowns)."""
    each = np.split(influences(fit), np.cumsum(fit.problem.lengths)[:-1])
    rows, unknowns = fit.slopes.shape
    if len(each) >= FEWEST_CLUSTERS:
        sums = np.stack([part.sum(axis=0) for part in each])
        return sums.T @ sums * len(each) / (len(each) - 1)
    kernel = np.asarray(sum(long_run(part) for part in each))
    own = np.diag(kernel)
    least = np.diag(_of_noise(fit)) / np.where(own > 0.0, own, 1.0)
    larger = np.sqrt(np.maximum(least, 1.0))
    return kernel * np.outer(larger, larger) * rows / max(rows - unknowns, 1)


def _of_noise(fit: Fit) -> np.ndarray:
    """Covariance under noise that does not depend on the motion, shape (unknowns, unknowns)."""
    lengths = fit.problem.lengths
    cuts = np.cumsum(lengths)[:-1]
    total = np.zeros((fit.slopes.shape[1],) * 2)
    for weights, rest in zip(
        np.split(fit.slopes @ _inverse(fit), cuts), np.split(fit.residuals, cuts), strict=True
    ):
        (coefficients,) = _autoregressions(rest[:, None])
        white = np.append(1.0, -coefficients)
        power = float(np.mean(np.square(signal.lfilter(white, [1.0], rest))))
        # G = L L^T with L the inverse of the whitening filter: the weights pass it backwards.
        moved = signal.lfilter([1.0], white, weights[::-1], axis=0)
        total += power * moved.T @ moved
    return total


def influences(fit: Fit) -> np.ndarray:
    """By how much each row moves the solution, to first order, shape (rows, unknowns).

    ``A^-1 s_t``: each column is the series whose long-run variance is that of one unknown, and
    hangs together in its own way, unlike scores, of which each unknown's estimate mixes several.
    """
    return (fit.slopes * fit.residuals[:, None]) @ _inverse(fit)


def critical(fit: Fit, wider: float) -> float:
    """Half-width of a 95 % interval in standard deviations.

    Args:
        fit: solved.
        wider: standard deviation of the unknown over that of independent residuals: rows that hang
            together count as fewer independent ones.
    """
    logs, (rows, unknowns) = len(fit.problem.lengths), fit.slopes.shape
    alone = rows / max(wider, 1.0) ** 2 - unknowns
    freedom = logs - 1.0 if logs >= FEWEST_CLUSTERS else max(alone, 2.0)
    return float(stats.t.ppf(0.975, freedom))


def _inverse(fit: Fit) -> np.ndarray:
    """(J^T J)^-1 by the singular values of the scaled slopes."""
    size = np.linalg.norm(fit.slopes, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    _, singular, right = np.linalg.svd(fit.slopes / size, full_matrices=False)
    floor = np.finfo(float).eps * len(fit.slopes) * singular[0]
    scaled = right.T / np.maximum(singular, floor)
    return scaled @ scaled.T / np.outer(size, size)


def long_run(scores: np.ndarray) -> np.ndarray:
    """Sum of all autocovariances of the scores of one log, times its rows.

    Args:
        scores: shape (rows, unknowns).

    Returns:
        shape (unknowns, unknowns).
    """
    rows = len(scores)
    size = np.linalg.norm(scores, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    scaled = scores / size
    whitened, filters = _whitened(scaled)
    bandwidth = _bandwidth(whitened)
    used = int(min(rows, math.ceil(30 * bandwidth) + 1))
    # sum_k w_k Gamma_k by the transforms of the scores and of the weights, of both signs of k.
    length = fft.next_fast_len(rows + used, real=True)
    spectrum = fft.rfft(whitened, length, axis=0)
    kernel = np.zeros(length)
    kernel[:used] = _kernel(np.arange(used) / bandwidth)
    kernel[length - used + 1 :] = kernel[1:used][::-1]
    weights = fft.rfft(kernel).real * np.where(np.arange(len(spectrum)) == 0, 1.0, 2.0) / length
    if length % 2 == 0:
        weights[-1] *= 0.5
    total = (spectrum.conj().T @ (weights[:, None] * spectrum)).real
    unfilter = np.diag(1.0 / (1.0 - filters))
    total = unfilter @ total @ unfilter
    return 0.5 * (total + total.T) * np.outer(size, size)


def _whitened(series: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Each series through an autoregression of its own, and the sum of its coefficients."""
    white, sums = series.copy(), np.zeros(series.shape[1])
    for column, coefficients in enumerate(_autoregressions(series)):
        # A smooth series has a sum close to 1; a filter that remembers the whole log is none.
        sums[column] = min(float(coefficients.sum()), 1.0 - _LEAST_REST / len(series))
        white[:, column] = signal.lfilter(np.append(1.0, -coefficients), [1.0], series[:, column])
    return white, sums


def _autoregressions(series: np.ndarray) -> list[np.ndarray]:
    """Coefficients of an autoregression of each column.

    The order is chosen by Akaike's criterion, the coefficients by the Levinson-Durbin recursion.

    Source: den Haan, Levin, "A practitioner's guide to robust covariance matrix estimation",
    Handbook of Statistics 15 (1997).
    """
    rows = len(series)
    most = max(min(int(_ORDERS * math.log10(rows)), rows // 10), 1)
    length = fft.next_fast_len(rows + most + 1, real=True)
    power = np.abs(fft.rfft(series, length, axis=0)) ** 2
    covariances = fft.irfft(power, length, axis=0)[: most + 1]
    return [_autoregression(covariances[:, column], rows) for column in range(series.shape[1])]


def _autoregression(covariances: np.ndarray, rows: int) -> np.ndarray:
    """Coefficients of the autoregression that Akaike's criterion chooses, shape (order,)."""
    best, found = math.inf, np.zeros(0)
    coefficients, left = np.zeros(0), float(covariances[0])
    for order in range(len(covariances)):
        if order:
            ahead = covariances[order] - coefficients @ covariances[order - 1 : 0 : -1]
            reflected = ahead / left if left > 0.0 else 0.0
            coefficients = np.append(coefficients - reflected * coefficients[::-1], reflected)
            left *= 1.0 - reflected**2
        criterion = rows * math.log(max(left, 1e-300)) + 2.0 * order
        if criterion < best:
            best, found = criterion, coefficients
    return found


def _bandwidth(scores: np.ndarray) -> float:
    """Andrews' bandwidth for the quadratic-spectral kernel, by first-order models."""
    rows = len(scores)
    before, after = scores[:-1], scores[1:]
    power = np.sum(before * before, axis=0)
    poles = np.sum(before * after, axis=0) / np.where(power > 0.0, power, 1.0)
    poles = np.clip(poles, -_LARGEST_POLE, _LARGEST_POLE)
    noise = np.mean((after - poles * before) ** 2, axis=0) ** 2
    above = np.sum(4.0 * poles**2 * noise / (1.0 - poles) ** 8)
    below = np.sum(noise / (1.0 - poles) ** 4)
    alpha = above / below if below > 0.0 else 0.0
    return max(1.3221 * (alpha * rows) ** 0.2, 1.0)


def _kernel(x: np.ndarray) -> np.ndarray:
    """The quadratic-spectral kernel."""
    z = 6.0 * np.pi * np.where(x == 0.0, 1.0, x) / 5.0
    value = 25.0 / (12.0 * np.pi**2 * np.where(x == 0.0, 1.0, x) ** 2) * (np.sin(z) / z - np.cos(z))
    return np.where(x == 0.0, 1.0, value)


def bootstrap(fit: Fit, *, number: int = 500, seed: int = 0) -> np.ndarray:
    """Covariance by resampling blocks of rows, each with the first-order change of the solution.

    Args:
        fit: solved.
        number: of resamplings.
        seed: of the choice of blocks.

    Returns:
        shape (unknowns, unknowns).

    Source: Kuensch, "The jackknife and the bootstrap for general stationary observations", Annals
    of Statistics 17 (1989).
    """
    generator = np.random.default_rng(seed)
    each = np.split(influences(fit), np.cumsum(fit.problem.lengths)[:-1])
    changes = np.zeros((number, len(fit.point)))
    for part in each:
        rows = len(part)
        block = max(int(round(rows ** (1.0 / 3.0) * _bandwidth(part) ** 0.5)), 1)
        sums = np.cumsum(np.vstack([np.zeros(part.shape[1]), part - part.mean(axis=0)]), axis=0)
        first = generator.integers(0, rows - block + 1, (number, math.ceil(rows / block)))
        changes += (sums[first + block] - sums[first]).sum(axis=1)
    return np.cov(changes.T).reshape((len(fit.point),) * 2)
