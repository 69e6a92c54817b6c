"""Intervals of fits whose residuals hang together cover the truth as often as they say."""

import numpy as np
import pytest
from linear_fits import Linear, Solved
from scipy.signal import lfilter

from jaxact.identification import uncertainty
from jaxact.identification.problem import Unknown

ROWS = 1500
SEEDS = 200


def _coloured(generator, rows, pole):
    noise = generator.normal(size=rows)
    for at in range(1, rows):
        noise[at] += pole * noise[at - 1]
    return noise


def _regression(seed, pole, logs=1, event=0):
    """Least squares of known truth with coloured noise and coloured regressors.

    The second one is of a few rows only where `event` is their number.
    """
    generator = np.random.default_rng(seed)
    each = [
        np.stack([np.ones(ROWS // logs), _coloured(generator, ROWS // logs, 0.9)], axis=1)
        for _ in range(logs)
    ]
    slopes = np.concatenate(each)
    if event:
        slopes[:, 1] = (np.abs(np.arange(ROWS) - ROWS // 2) < event / 2) * 1.0
    noise = np.concatenate([_coloured(generator, ROWS // logs, pole) for _ in range(logs)])
    truth = np.array([0.3, -1.2])
    point = np.linalg.lstsq(slopes, slopes @ truth + noise, rcond=None)[0]
    unknowns = tuple(Unknown(name, "1", -9.0, 9.0, (0.0,)) for name in ("a", "b"))
    problem = Linear(unknowns, (ROWS // logs,) * logs)
    rest = slopes @ (point - truth) - noise
    return Solved(problem, point, rest, slopes), truth


@pytest.mark.parametrize(("pole", "logs"), [(0.0, 1), (0.8, 1), (0.9, 1), (0.8, 8)])
def test_ninety_five_percent_intervals_cover_the_truth(pole, logs):
    inside, naive = np.zeros(2), np.zeros(2)
    for seed in range(SEEDS):
        fit, truth = _regression(seed, pole, logs)
        covariance = uncertainty.robust(fit)
        deviation, plain = (np.sqrt(np.diag(c)) for c in (covariance, uncertainty.naive(fit)))
        critical = np.array([uncertainty.critical(fit, ratio) for ratio in deviation / plain])
        half = critical * deviation
        inside += np.abs(fit.point - truth) <= half
        plain = 1.96 * np.sqrt(np.diag(uncertainty.naive(fit)))
        naive += np.abs(fit.point - truth) <= plain
    assert np.all(inside / SEEDS >= 0.90) and np.all(inside / SEEDS <= 0.99)
    if pole >= 0.8:
        assert naive.min() / SEEDS < 0.75  # what independent residuals would have said


def test_an_unknown_that_few_rows_tell_of_has_no_narrower_interval_than_its_noise():
    # The kernel's estimate alone covers in half of the logs: it squares a sum of few residuals.
    inside = 0
    for seed in range(SEEDS):
        fit, truth = _regression(seed, 0.8, event=40)
        deviation = float(np.sqrt(uncertainty.robust(fit)[1, 1]))
        half = uncertainty.critical(fit, 2.0) * deviation
        inside += abs(float(fit.point[1] - truth[1])) <= half
    assert 0.90 <= inside / SEEDS <= 0.99


def test_resampled_blocks_agree_with_the_kernel():
    fit, _ = _regression(4, 0.8)
    both = [np.sqrt(np.diag(c)) for c in (uncertainty.robust(fit), uncertainty.bootstrap(fit))]
    np.testing.assert_allclose(both[1], both[0], rtol=0.35)


def test_independent_residuals_have_the_naive_intervals():
    fit, _ = _regression(5, 0.0)
    both = [np.sqrt(np.diag(c)) for c in (uncertainty.robust(fit), uncertainty.naive(fit))]
    np.testing.assert_allclose(both[0], both[1], rtol=0.25)


def test_a_smooth_series_has_the_long_run_variance_of_its_filter():
    # Sampled finely, so that the filter's coefficients almost add up to 1: sum of n values of
    # e / (1 - p z)^2 has the variance n / (1 - p)^4.
    pole, rows = 0.97, 20_000
    white = np.random.default_rng(6).normal(size=(rows, 12))
    series = lfilter([1.0], [1.0, -2.0 * pole, pole**2], white, axis=0)
    found = np.diag(uncertainty.long_run(series)) * (1.0 - pole) ** 4 / rows
    np.testing.assert_allclose(np.sqrt(found), 1.0, atol=0.35)
    assert np.mean(np.sqrt(found)) == pytest.approx(1.0, abs=0.1)
